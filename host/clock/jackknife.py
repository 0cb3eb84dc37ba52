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


def left_out(columns: Floats, left: Floats, part: NDArray[np.intp], held: Floats | float = 0.0) -> Spread:
    """At the solution: `left` is what it leaves. `part`: of each row, in order. `held`: a prior's normal matrix."""
    starts = np.flatnonzero(np.diff(part, prepend=-1))
    products = np.array([columns[a:b].T @ columns[a:b] for a, b in edges(starts, len(part))])
    sums = np.add.reduceat(columns * left[:, None], starts)
    whole = products.sum(axis=0) + held
    try:
        # The sum over all is that of the prior; without a part, what it pulled is missing.
        without = np.linalg.solve(whole - products, -sums[:, :, None])[:, :, 0]
        inverse = np.linalg.inv(whole)
    except np.linalg.LinAlgError:
        unknown = np.full(whole.shape, np.nan)
        return Spread(unknown, unknown)
    away = without - without.mean(axis=0)
    return Spread(inverse, (len(starts) - 1) / len(starts) * away.T @ away)


def edges(starts: NDArray[np.intp], count: int) -> list[tuple[int, int]]:
    return list(zip(starts.tolist(), [*starts[1:].tolist(), count], strict=True))
