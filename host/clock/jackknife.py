"""How sure a least-squares fit is, from what it gives when each part of the data in turn is left out."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Spread:
    inverse: Floats
    """Of the normal matrix."""
    spread: Floats
    """Covariance of the unknowns; NaN where a part alone tells them."""
    noise: float
    """Root mean square of what is left."""

    def sigma(self, by: Floats) -> float:
        """Standard deviation of `by` times the unknowns: the larger of two. What is left tells one as if it were white;
        the parts, which know better, may by chance agree too well where there are few."""
        return float(np.sqrt(np.maximum(by @ self.spread @ by, self.noise**2 * (by @ self.inverse @ by))))


def left_out(columns: Floats, left: Floats, part: NDArray[np.intp], held: Floats | float = 0.0) -> Spread:
    """At the solution: `left` is what it leaves. `part`: of each row, in order. `held`: a prior's normal matrix."""
    starts = np.flatnonzero(np.diff(part, prepend=-1))
    products = np.array([columns[a:b].T @ columns[a:b] for a, b in edges(starts, len(part))])
    sums = np.add.reduceat(columns * left[:, None], starts)
    whole = products.sum(axis=0) + held
    noise = float(np.sqrt(np.mean(left**2)))
    try:
        # The sum over all is that of the prior; without a part, what it pulled is missing.
        without = np.linalg.solve(whole - products, -sums[:, :, None])[:, :, 0]
        inverse = np.linalg.inv(whole)
    except np.linalg.LinAlgError:
        unknown = np.full(whole.shape, np.nan)
        return Spread(unknown, unknown, noise)
    away = without - without.mean(axis=0)
    return Spread(inverse, (len(starts) - 1) / len(starts) * away.T @ away, noise)


def edges(starts: NDArray[np.intp], count: int) -> list[tuple[int, int]]:
    return list(zip(starts.tolist(), [*starts[1:].tolist(), count], strict=True))
