"""The picture of `host sync gyro --plot`: both gyros where they tell most, what is left, and each event's own shift."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..clock.gyro import Shift
from ..usd.drawing import Dots, Line, Shape, Words
from ..usd.plot import decimal, nice_step
from .sync_plot import BLUE, GREY, LEFT, PANEL, RED, RIGHT, SPACE, TOP, panel

WIDTH, HEIGHT = 1200, 760
AROUND_US = 60e3
"""Shown about the event that tells most."""
PLACES = 600
EVERY = 6
"""Of the places, for the gyro that is laid over the other."""


def picture(found: Shift, first: str, second: str) -> list[Shape]:
    return list(shapes(found, first, second))


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
    x = across(at_us)
    limits = float(min(own.min(), other.min())), float(max(own.max(), other.max()))
    yield from panel(
        0, f"about the board's axis, deg/s: {first}, and {second} laid over it (red)", x, own, BLUE, limits
    )
    yield from dots(panel(0, "", x[::EVERY], other[::EVERY], RED, limits), 3.5)
    yield from panel(1, "what is left, deg/s", x, own - other, BLUE)
    bottom = TOP + 2 * (PANEL + SPACE) - SPACE
    yield from axis(at_us[0], at_us[-1], bottom, best.at_us, 1e-3, f"ms about {best.at_us * 1e-6:.3f} s")
    times = np.array([each.at_us for each in events])
    weight = np.array([each.weight for each in events])
    away = np.array([each.shift_us for each in events])
    telling = weight > 0.1 / len(events)
    times, away = times[telling], away[telling]
    own_shift = list(panel(2, "each event's own shift, less the line through all, us", across(times), away, BLUE))
    yield from (each for each in own_shift if not isinstance(each, Dots))
    yield from dots(own_shift, 6)
    yield from axis(times.min(), times.max(), TOP + 3 * (PANEL + SPACE) - SPACE, 0.0, 1e-6, "s of the first clock")


def dots(drawn: Iterable[Shape], size: float) -> Iterator[Shape]:
    """Those of a panel, of that size."""
    return (replace(each, size=size) for each in drawn if isinstance(each, Dots))


def across(at: np.ndarray) -> np.ndarray:
    span = max(float(np.ptp(at)), 1e-9)
    return np.asarray(LEFT + (at - at.min()) * ((WIDTH - LEFT - RIGHT) / span))


def axis(low: float, high: float, bottom: float, zero: float, scale: float, says: str) -> Iterator[Shape]:
    """Times below a panel."""
    begin, end = (low - zero) * scale, (high - zero) * scale
    step = nice_step(max(end - begin, 1e-9) / 10)
    for k in range(int(np.ceil(begin / step)), int(np.floor(end / step)) + 1):
        place = LEFT + (k * step - begin) * (WIDTH - LEFT - RIGHT) / max(end - begin, 1e-9)
        yield Line([(place, bottom), (place, bottom + 4)], GREY)
        yield Words(place, bottom + 17, decimal(k * step, step), 11, "middle", GREY)
    yield Words(WIDTH - RIGHT, bottom + 32, says, 11, "end", GREY)
