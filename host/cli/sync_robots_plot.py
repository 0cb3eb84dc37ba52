"""The picture of `host sync robots --plot`: by beacons each robot against the host, else each two by themselves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..clock.beacons import Against
from ..clock.robots import Heard, Pair, matched
from ..usd.drawing import Shape, Words
from .sync_plot import BLUE, GREEN, LEFT, RED, across, panels, scale

COLORS = (BLUE, RED, GREEN, "#b7791f", "#6d4aa3", "#0e7c86", "#8a8f98")
"""In turn."""
NAME_ACROSS = 190
NAMES_MAX = 8
POINTS = 500


def by_beacons(labels: Sequence[str], fits: Sequence[Against]) -> Iterator[Shape]:
    yield Words(LEFT, 20, "clocks against the host's, by its beacons", 16, bold=True)
    yield from names(labels)
    begin_us = min(int(each.beacons.host_us[0]) for each in fits)
    span_s = np.array([0.0, max((int(each.beacons.host_us[-1]) - begin_us) * 1e-6 for each in fits)])
    late, rates, bounds = [], [], []
    for fit, color in zip(fits, colors(len(fits)), strict=True):
        beacons = fit.beacons
        heard_us = beacons.host_us.astype(np.float64)
        offset, _ = fit.at(heard_us)
        late.append((across((heard_us - begin_us) * 1e-6, span_s), beacons.local_us - heard_us - offset, color))
        host_us = np.linspace(heard_us[0], heard_us[-1], POINTS)
        offset, bound = fit.at(host_us)
        x = across((host_us - begin_us) * 1e-6, span_s)
        middle = x[:-1] + np.diff(x) / 2
        rates.append((middle, np.diff(offset) / np.diff(host_us) * 1e6 - fit.drift_ppm, color))
        known = np.isfinite(bound)
        bounds.append((x[known], bound[known], color))
    high = max(float(np.quantile(y, 0.99)) for _, y, _ in late)
    yield from panels(0, "beacons late, us", late, (min(0.0, *(float(y.min()) for _, y, _ in late)), high))
    yield from panels(1, "rate less its mean, ppm", rates)
    top = max(float(y.max()) for _, y, _ in bounds)
    yield from panels(2, "bound of the offset to the host, ± us (99 %)", bounds, (0.0, top))
    yield from scale(2, span_s, "s of the host")


def by_broadcasts(heard: Sequence[Heard], pairs: Sequence[Pair]) -> Iterator[Shape]:
    yield Words(LEFT, 20, "clocks against each other, by broadcasts", 16, bold=True)
    yield from names([f"{heard[each.second].name} - {heard[each.first].name}" for each in pairs])
    both = [matched(heard[each.first], heard[each.second], each) for each in pairs]
    begin_us = min(float(here[0]) for here, _ in both)
    span_s = np.array([0.0, max(float(here[-1]) - begin_us for here, _ in both) * 1e-6])
    drift, left = [], []
    for (here, there), pair, color in zip(both, pairs, colors(len(pairs)), strict=True):
        x = across((here - begin_us) * 1e-6, span_s)
        away = there - here - pair.offset_us
        drift.append((x, away, color))
        left.append((x, away - pair.slope_ppm * 1e-6 * (here - pair.at_us), color))
    yield from panels(0, "offset less that in the middle, us", drift)
    limit = max(float(np.quantile(np.abs(y), 0.99)) for _, y, _ in left)
    yield from panels(1, "about the line, us", left, (-limit, limit))
    yield from scale(1, span_s, "s of the first robot")


def colors(count: int) -> list[str]:
    return [COLORS[number % len(COLORS)] for number in range(count)]


def names(labels: Sequence[str]) -> Iterator[Shape]:
    for number, (label, color) in enumerate(zip(labels, colors(len(labels)), strict=True)):
        x, y = LEFT + 460 + NAME_ACROSS * (number % 3), 16 + 14 * (number // 3)
        if number == NAMES_MAX:
            yield Words(x, y, f"and {len(labels) - NAMES_MAX} more", 12)
            return
        yield Words(x, y, label, 12, fill=color, bold=True)
