"""What the times and the status rows of a log say about it: rates, holes, drops, and the clock.

In firmware before August 2026 the STM32's microseconds are 85/84 of real ones: what comes every 10 ms seems to come
every 9.882 ms. A log betrays it where something in it has a rate that is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from .log import STATUS_EVENT, Log, Rows

NOMINAL_HZ = (1000, 500, 1000 / 3, 250, 200, 125, 120, 100, 60, 50, 40, 30, 25, 20, 10)
SLOW = 84 / 85
NEAR = 0.15
"""A median interval so near (relatively) to a nominal one may be it."""
LOWEST, HIGHEST = 0.98, 1.008
"""Periods looked for, of the nominal one: both clocks, and sources that are somewhat off."""
SAMPLES = 4096
COHERENT = 0.8
"""Of 1: so well have the times to fit a period."""
REGULAR, WITHIN = 0.8, 0.3
"""A type is regular when so many of its intervals lie so near to the median."""
HOLE_INTERVALS = 2.5
"""A gap so many times the median is a hole."""


@dataclass(frozen=True, slots=True)
class Hole:
    """Rows of a regular type that are not there."""

    type: str
    epoch: int
    from_us: int
    to_us: int
    rows: int
    """How many are missing, by the usual interval."""


@dataclass(frozen=True, slots=True)
class Drop:
    """Rows that the logger had no room for, between two status rows."""

    epoch: int
    """Of the second."""
    from_us: int
    to_us: int
    rows: int


@dataclass(frozen=True, slots=True)
class Period:
    """A type whose rows come with a period, and a nominal rate that it may be meant to have."""

    type: str
    interval_us: float
    error_us: float
    """Standard error of the interval."""
    nominal_hz: float
    ratio: float
    """Interval to nominal interval: 0.98824 (84/85) is the slow clock, 1 a right one."""
    coherence: float

    @property
    def is_slow(self) -> bool:
        """Nearer to 84/85 than to 1."""
        return abs(self.ratio - SLOW) < abs(self.ratio - 1)

    @property
    def is_clear(self) -> bool:
        """And not somewhere in between."""
        return min(abs(self.ratio - SLOW), abs(self.ratio - 1)) < (1 - SLOW) / 3


@dataclass(frozen=True, slots=True)
class Counters:
    """Of the last status row that can be trusted, since the log was opened."""

    requested: int
    accepted: int
    dropped: int
    stall_us: int
    syncs: int
    errors: int


@dataclass(frozen=True, slots=True)
class Findings:
    holes: tuple[Hole, ...]
    drops: tuple[Drop, ...]
    periods: tuple[Period, ...]
    counters: Counters | None
    disorder: dict[str, int]
    """By type: rows that are older than the row of their type before."""


def examine(log: Log) -> Findings:
    """All that can be found without knowing what the robot did."""
    holes: list[Hole] = []
    periods: list[Period] = []
    disorder: dict[str, int] = {}
    for name, rows in log.rows.items():
        if name == STATUS_EVENT:
            continue
        for number, part in enumerate(rows.epochs):
            stamps = rows.stamp_us[part.start : part.stop].astype(np.int64)
            steps = np.diff(stamps)
            if late := int((steps < 0).sum()):
                disorder[name] = disorder.get(name, 0) + late
            holes += find_holes(name, number, stamps, steps)
        if (period := find_period(name, rows)) is not None:
            periods.append(period)
    counters, drops = read_status_rows(log.rows.get(STATUS_EVENT))
    return Findings(tuple(holes), drops, tuple(periods), counters, disorder)


def find_holes(name: str, epoch: int, stamps: Any, steps: Any) -> list[Hole]:
    if len(steps) < 10:
        return []
    if not is_regular(steps):
        return []
    usual = float(np.median(steps))
    return [
        Hole(name, epoch, int(stamps[at]), int(stamps[at + 1]), round(float(steps[at]) / usual) - 1)
        for at in np.flatnonzero(steps > HOLE_INTERVALS * usual)
    ]


def is_regular(steps: Any) -> bool:
    """Do rows with these intervals come with a period?"""
    usual = float(np.median(steps))
    return usual > 0 and bool((np.abs(steps - usual) < WITHIN * usual).mean() >= REGULAR)


def find_period(name: str, rows: Rows) -> Period | None:
    """Of the longest epoch's first rows; rows that are missing do not matter."""
    longest = max(rows.epochs, key=len, default=range(0))
    stamps = rows.stamp_us[longest.start : longest.stop][:SAMPLES].astype(np.float64)
    if len(stamps) < 50:
        return None
    stamps -= stamps[0]
    usual = float(np.median(np.diff(stamps)))
    found = [
        best_fit(name, stamps, hz) for hz in NOMINAL_HZ if abs(usual * hz / 1e6 - 1) < NEAR and stamps[-1] * hz > 50e6
    ]
    best = max(found, key=lambda period: period.coherence, default=None)
    return best if best is not None and best.coherence >= COHERENT else None


def best_fit(name: str, stamps: Any, hz: float) -> Period:
    """The period at which the times, taken as angles, point the same way most."""
    span = stamps[-1]
    nominal = 1e6 / hz
    coarse = np.arange(1 / (HIGHEST * nominal), 1 / (LOWEST * nominal), 0.25 / span)
    middle = coarse[int(np.argmax([coherence(stamps, rate) for rate in coarse]))]
    fine = np.linspace(middle - 0.3 / span, middle + 0.3 / span, 61)
    quality = [coherence(stamps, rate) for rate in fine]
    at = int(np.argmax(quality))
    # Now that each time's number is known, a line through them.
    turns = stamps * fine[at]
    phase = float(np.angle(np.exp(2j * np.pi * turns).mean())) / (2 * math.pi)
    numbers = np.rint(turns - phase)
    numbers -= numbers.mean()
    spread = float(numbers @ numbers)
    interval = float(numbers @ stamps) / spread
    left = stamps - stamps.mean() - interval * numbers
    error = math.sqrt(float(left @ left) / len(stamps) / spread)
    return Period(name, interval, error, hz, interval / nominal, quality[at])


def coherence(stamps: Any, rate: float) -> float:
    return float(abs(np.exp(2j * np.pi * rate * stamps).mean()))


def read_status_rows(rows: Rows | None) -> tuple[Counters | None, tuple[Drop, ...]]:
    if rows is None or not rows.is_verified.any():
        return None, ()
    good = rows.is_verified
    data, stamps, epochs = rows.data[good], rows.stamp_us[good], rows.epoch[good]
    last = data[-1]
    counters = Counters(
        *(int(last[name]) for name in ("requested", "accepted", "dropped", "stall_us", "syncs", "errors"))
    )
    more = np.diff(data["dropped"].astype(np.int64), prepend=0)
    drops = tuple(
        Drop(int(epochs[at]), int(stamps[max(at - 1, 0)]), int(stamps[at]), int(more[at]))
        for at in np.flatnonzero(more > 0)
    )
    return counters, drops
