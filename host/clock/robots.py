"""Clocks of robots against each other, from broadcasts that they all heard: when each logged what."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FAR_US = 20_000.0
"""From the median offset, less the rate: what was the same by chance, or heard another time."""
SAME_US = 4_500.0
"""Less than half the time between broadcasts at 100 Hz."""
OUTLIER = 5.0
COMMON_MIN = 20
"""Broadcasts; a line through fewer says nothing."""


@dataclass(frozen=True, slots=True)
class Heard:
    """What one robot heard first when, on its own clock."""

    name: str
    time_us: Floats
    what: Sequence[Hashable]
    """The contents; equal on two robots: the same broadcast."""


@dataclass(frozen=True, slots=True)
class Pair:
    """The second robot's clock against the first's."""

    first: int
    second: int
    common: int
    """Broadcasts that the line goes through."""
    outliers: int
    slope_ppm: float
    slope_sigma_ppm: float
    at_us: float
    """First clock: the middle, where the offset is known best."""
    offset_us: float
    """Second less first, there."""
    offset_sigma_us: float
    start_us: float
    """The same, carried on to 0 of the first clock: where both were, had they begun together."""
    start_sigma_us: float
    residual_us: float
    """Standard deviation about the line."""
    span_s: float


def compare(robots: Sequence[Heard]) -> list[Pair | tuple[int, int, int]]:
    """Each two of them; (first, second, common) where they have too little in common."""
    found: list[Pair | tuple[int, int, int]] = []
    once = [first_times(each) for each in robots]
    for first, second in combinations(range(len(robots)), 2):
        both = sorted(once[first].keys() & once[second].keys(), key=once[first].__getitem__)
        here = np.array([once[first][each] for each in both])
        there = np.array([once[second][each] for each in both])
        rough = line(first, second, here, there)
        if rough is None:
            found.append((first, second, len(both)))
            continue
        # What came more than once is told apart by when it came.
        found.append(line(first, second, *matched(robots[first], robots[second], rough)) or rough)
    return found


def matched(here: Heard, there: Heard, rough: Pair) -> tuple[Floats, Floats]:
    """Times of all broadcasts that both heard: the same contents, within SAME_US of where the line has them."""
    expected = here.time_us + rough.offset_us + rough.slope_ppm * 1e-6 * (here.time_us - rough.at_us)
    nearest = np.searchsorted((there.time_us[1:] + there.time_us[:-1]) / 2, expected)
    near = np.abs(there.time_us[nearest] - expected) < SAME_US
    same = [k for k in np.flatnonzero(near).tolist() if here.what[k] == there.what[nearest[k]]]
    return here.time_us[same], there.time_us[nearest[same]]


def first_times(heard: Heard) -> dict[Hashable, float]:
    """Contents that came once only: what comes again may be another broadcast."""
    times: dict[Hashable, float] = {}
    again: set[Hashable] = set()
    for what, at_us in zip(heard.what, heard.time_us.tolist(), strict=True):
        if what in times:
            again.add(what)
        else:
            times[what] = at_us
    return {what: at_us for what, at_us in times.items() if what not in again}


def line(first: int, second: int, here: Floats, there: Floats) -> Pair | None:
    """Least squares, without what is far off; None when too little is left."""
    away = there - here
    near = np.abs(away - np.median(away)) < FAR_US if len(away) else np.zeros(0, np.bool_)
    for _ in range(3):
        if near.sum() < COMMON_MIN or np.ptp(here[near]) <= 0:
            return None
        middle = float(here[near].mean())
        since = here - middle
        slope, offset = np.polyfit(since[near], away[near], 1)
        left = away - slope * since - offset
        spread = float(np.median(np.abs(left[near]))) * 1.4826
        near = np.abs(left) < max(OUTLIER * spread, 1.0)
    count = int(near.sum())
    if count < COMMON_MIN:
        return None
    residual = float(left[near].std(ddof=2))
    offset_sigma = residual / np.sqrt(count)
    slope_sigma = offset_sigma / float(since[near].std())
    return Pair(
        first=first,
        second=second,
        common=count,
        outliers=len(here) - count,
        slope_ppm=float(slope) * 1e6,
        slope_sigma_ppm=float(slope_sigma) * 1e6,
        at_us=middle,
        offset_us=float(offset),
        offset_sigma_us=float(offset_sigma),
        start_us=float(offset - slope * middle),
        start_sigma_us=float(np.hypot(offset_sigma, slope_sigma * middle)),
        residual_us=residual,
        span_s=float(np.ptp(here[near])) * 1e-6,
    )


def closures(pairs: Sequence[Pair]) -> dict[tuple[int, int, int], float]:
    """For each three robots: first to second and second to third, less first to third; ppm. 0 if the slopes agree."""
    slopes = {(each.first, each.second): each.slope_ppm for each in pairs}
    robots = sorted({each for pair in slopes for each in pair})
    return {
        (a, b, c): slopes[a, b] + slopes[b, c] - slopes[a, c]
        for a, b, c in combinations(robots, 3)
        if {(a, b), (b, c), (a, c)} <= slopes.keys()
    }
