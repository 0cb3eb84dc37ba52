"""The picture of `host sync gyro --plot`: both gyros where they tell most, what is left, and each event's own shift."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..clock.gyro import Shift
from ..usd.drawing import Dots, Shape, Words
from .sync_plot import BLUE, LEFT, RED, across, panel, scale

AROUND_US = 60e3
"""Shown about the event that tells most."""
PLACES = 600
EVERY = 6
"""Of the places, for the gyro that is laid over the other."""


def shapes(found: Shift, first: str, second: str) -> Iterator[Shape]:
    yield Words(
        LEFT, 28, f"{second} against {first}: {found.shift_us:+.1f} ± {found.sigma_us:.1f} us,"
        f" {found.skew_ppm:+.3f} ± {found.skew_sigma_ppm:.3f} ppm", 16, bold=True,
    )  # fmt: skip
    events = found.events
    best = max(events, key=lambda each: each.weight)
    at_us = np.linspace(best.at_us - AROUND_US, best.at_us + AROUND_US, PLACES)
    own, other = found.first.at(at_us), found.gain * found.second.at(found.at(at_us)) + found.bias_dps
    known = np.isfinite(own) & np.isfinite(other)
    at_us, own, other = at_us[known], own[known], other[known]
    since_ms = (at_us - best.at_us) * 1e-3
    x = across(since_ms)
    limits = float(min(own.min(), other.min())), float(max(own.max(), other.max()))
    yield from panel(
        0, f"about the board's axis, deg/s: {first}, and {second} laid over it (red)", x, own, BLUE, limits
    )
    yield from dots(panel(0, "", x[::EVERY], other[::EVERY], RED, limits), 3.5)
    yield from panel(1, "what is left, deg/s", x, own - other, BLUE)
    yield from scale(1, since_ms, f"ms about {best.at_us * 1e-6:.3f} s")
    times = np.array([each.at_us for each in events]) * 1e-6
    weight = np.array([each.weight for each in events])
    away = np.array([each.shift_us for each in events])
    telling = weight > 0.1 / len(events)
    times, away = times[telling], away[telling]
    own_shift = list(panel(2, "each event's own shift, less the line through all, us", across(times), away, BLUE))
    yield from (each for each in own_shift if not isinstance(each, Dots))
    yield from dots(own_shift, 6)
    yield from scale(2, times, "s of the first clock")


def dots(drawn: Iterable[Shape], size: float) -> Iterator[Shape]:
    """Those of a panel, of that size."""
    return (replace(each, size=size) for each in drawn if isinstance(each, Dots))
