"""How steady a clock is, from its offset at equal steps of time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Steadiness:
    """Allan deviation of the rate: how far the mean rates of two neighbouring spans lie apart, as 1/sqrt(2) of rms."""

    span_s: tuple[float, ...]
    deviation_ppm: tuple[float, ...]


def allan_deviation(offset_us: Floats, step_s: float) -> Steadiness:
    """The overlapped estimate at spans of 1, 2, 4 … steps, up to a quarter of the data."""
    spans, deviations = [], []
    step = 1
    while 4 * step < len(offset_us):
        second = offset_us[2 * step :] - 2 * offset_us[step:-step] + offset_us[: -2 * step]
        spans.append(step * step_s)
        deviations.append(float(np.sqrt(np.mean(second**2) / 2)) / (step * step_s))
        step *= 2
    return Steadiness(tuple(spans), tuple(deviations))
