"""Clocks that do not keep their rates: how far the shifts of single events bend away from the line through all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .gyro_signal import Floats

EVENTS_MIN = 6
CLEAR = 3.0
"""Sigmas; less is none."""


@dataclass(frozen=True, slots=True)
class Bend:
    """A parabola, what it is more than the line: us, with time in seconds from `middle_us`."""

    middle_us: float
    offset_us: float
    slope_ppm: float
    bend_us: float
    """Per s²: half of how the rate changes, ppm/s."""
    reach_s: float
    """Root mean square of the events' times."""

    def at(self, time_us: float) -> float:
        since_s = (time_us - self.middle_us) * 1e-6
        return self.offset_us + self.slope_ppm * since_s + self.bend_us * since_s**2

    @property
    def rate_ppm(self) -> float:
        """By so much the rate changes on the way from the middle to a usual event."""
        return 2 * self.bend_us * self.reach_s


STRAIGHT = Bend(0.0, 0.0, 0.0, 0.0, 0.0)


def bend_of(at_us: Floats, shift_us: Floats, weight: Floats) -> Bend:
    """STRAIGHT if nothing is clear."""
    if len(at_us) < EVENTS_MIN:
        return STRAIGHT
    middle_us = float((weight @ at_us) / weight.sum())
    since_s = (at_us - middle_us) * 1e-6
    columns = np.stack([np.ones(len(since_s)), since_s, since_s**2], axis=1)
    weighed = columns * weight[:, None]
    try:
        inverse = np.linalg.inv(columns.T @ weighed)
    except np.linalg.LinAlgError:
        return STRAIGHT
    state = inverse @ (weighed.T @ shift_us)
    left = shift_us - columns @ state
    # What the events scatter, whatever they come from; as the jackknife, event by event.
    spread = inverse @ (weighed.T * left**2) @ weighed @ inverse * (len(at_us) / (len(at_us) - 3))
    if abs(state[2]) < CLEAR * np.sqrt(spread[2, 2]):
        return STRAIGHT
    reach_s = float(np.sqrt((weight @ since_s**2) / weight.sum()))
    return Bend(middle_us, float(state[0]), float(state[1]), float(state[2]), reach_s)
