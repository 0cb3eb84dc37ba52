"""A robot's clock against the host's, from beacons: the host broadcasts its own time, the robot notes when it came.

A beacon is late by however long the radio and the robot take, and never early: what the offset is comes from the
earliest. Nothing in a robot's notes tells the delay that every beacon has, the host's own before it sends included. It
is in all robots alike, so it is not in the offset of one robot against another.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .envelope import Floats
from .smoother import BLOCK_PAIRS, Smoothed, smooth
from .ticks import SLOW

Ints = NDArray[np.int64]

WRAP = 1 << 32
"""Of the beacons' numbers."""
BEACONS_MIN = 2 * BLOCK_PAIRS
BLOCK_S_MAX = 40.0
"""A crystal that warms up bends within a minute."""
BEND_PPM_S = 0.04
"""How fast a crystal's rate may change: 2 ppm of warming up with a time constant of one minute."""
FEW = 40
"""So many beacons tell the mean delay, and with it the bound, to a factor of two."""
STEP_S = 0.01
"""From message to message where the smoother is at home."""
SLOW_PPM = (SLOW - 1) * 1e6
"""Drift of a slow clock against a right one."""
CRYSTAL_PPM = 2000.0
"""No right clock is further off: half of that, and half for the host's."""
RECENT_US = 180_000_000
FAR_S = 60.0
"""From any beacon: no bound is given."""
AWAY = 0.03
AWAY_US = 1e6
"""Two clocks that pass so differently between two beacons are not those of one run."""


@dataclass(frozen=True, slots=True)
class Beacons:
    """What one robot noted of one run of the host, in the order of its coming."""

    sequence: Ints
    host_us: Ints
    """The host's clock, as the beacon says."""
    local_us: Ints
    """The robot's clock when it came."""
    repeated: int
    """Left out: the same beacon again."""
    other_runs: int
    """Left out: beacons of other runs of the host, or with times that cannot be."""

    def __len__(self) -> int:
        return len(self.sequence)

    @property
    def lost(self) -> int:
        """Numbers between the first and the last that did not come."""
        step = np.diff(self.sequence) % WRAP
        return int((step[step > 0] - 1).sum())


def collect(sequence: ArrayLike, host_us: ArrayLike, local_us: ArrayLike) -> Beacons:
    """Of all that was noted between two resets of the robot's clock: the longest run in which the host's clock and
    the beacons' numbers only go on. What was repeated counts when it came first."""
    number, host, local = (np.asarray(each, np.int64) for each in (sequence, host_us, local_us))
    times = host.astype(np.float64), local.astype(np.float64)  # nonsense may be further apart than 64 bits hold
    if not len(number):
        return Beacons(number, host, local, 0, 0)
    again = np.concatenate(([False], (np.diff(number) == 0) & (np.diff(host) == 0)))
    begin = np.flatnonzero(np.concatenate(([True], ~follows(number, *times, slice(None, -1), slice(1, None)))))
    end = np.append(begin[1:], len(number))
    longest = int(np.argmax(end - begin))
    mine = np.zeros(len(number), np.bool_)
    mine[begin[longest] : end[longest]] = True
    # What goes on where it ended, or leads to where it began, is of the same run: in between was nonsense.
    last, first = end[longest] - 1, begin[longest]
    for each in range(longest + 1, len(begin)):
        if follows(number, *times, last, begin[each]):
            mine[begin[each] : end[each]] = True
            last = end[each] - 1
    for each in range(longest - 1, -1, -1):
        if follows(number, *times, end[each] - 1, first):
            mine[begin[each] : end[each]] = True
            first = begin[each]
    kept = mine & ~again
    return Beacons(number[kept], host[kept], local[kept], int((mine & again).sum()), int((~mine).sum()))


def follows(number: Ints, host: Floats, local: Floats, a: Any, b: Any) -> Any:
    """Do b's come after a's in the same run of the host, by number, by time and by how much time has passed?"""
    step, passed = host[b] - host[a], local[b] - local[a]
    onward = (number[b] - number[a]) % WRAP < WRAP // 2
    return (step >= 0) & onward & (np.abs(step - passed) <= AWAY * np.abs(passed) + AWAY_US)


@dataclass(frozen=True, slots=True)
class Against:
    """A robot's clock against the host's."""

    beacons: Beacons
    line_us: tuple[float, float]
    """Robot less host at the first beacon, and its growth in a second; the curve comes on top of that line."""
    smoothed: Smoothed
    scale: float
    """The curve's seconds to one of the host's."""

    @property
    def drift_ppm(self) -> float:
        """Of the robot's clock against the host's, from the first beacon to the last."""
        ends_us = self.beacons.host_us[[0, -1]].astype(np.float64)
        offset, _ = self.at(ends_us)
        return float((offset[1] - offset[0]) / (ends_us[1] - ends_us[0])) * 1e6

    @property
    def is_slow(self) -> bool:
        """It counts 84 where 85 have passed: the drift is nearer to that than to none."""
        return abs(self.drift_ppm - SLOW_PPM) < abs(self.drift_ppm)

    @property
    def is_clear(self) -> bool:
        """And not so far from both that it is neither."""
        return min(abs(self.drift_ppm - SLOW_PPM), abs(self.drift_ppm)) < CRYSTAL_PPM

    @property
    def delay_us(self) -> float:
        """Mean delay of the beacons over the least."""
        return float(np.median(self.smoothed.mu_us))

    def at(self, host_us: Floats) -> tuple[Floats, Floats]:
        """(robot less host, its bound of 99 %) in us; the bound is infinite where no beacon is near."""
        since = (np.asarray(host_us, np.float64) - self.beacons.host_us[0]) * 1e-6
        curve = self.smoothed.track
        offset = self.line_us[0] + self.line_us[1] * since + curve.at(since * self.scale)
        bound = np.interp(since * self.scale, curve.time_s, self.smoothed.bound_us) * (1 + FEW / len(self.beacons))
        return offset, bound + self._bend_us(since)

    def _bend_us(self, since: Floats) -> Floats:
        """What a rate that changes may do within a block, more at the ends, and where no beacons came."""
        heard = (self.beacons.host_us - self.beacons.host_us[0]) * 1e-6
        block = np.interp(since * self.scale, self.smoothed.track.time_s, self.smoothed.block_s) / self.scale
        inside = np.clip(np.minimum(since, heard[-1] - since), 0, block)
        after = np.clip(np.searchsorted(heard, since), 1, len(heard) - 1)
        away = np.minimum(np.abs(heard[after] - since), np.abs(since - heard[after - 1]))
        # Over 12 in the middle of a block, a half at its end.
        reach = np.maximum(block - inside, block / np.sqrt(12)) + away
        return np.where(away > FAR_S, np.inf, BEND_PPM_S / 2 * reach**2)


def against_host(beacons: Beacons) -> Against | None:
    """None: too few beacons."""
    if len(beacons) < BEACONS_MIN or beacons.host_us[-1] <= beacons.host_us[0]:
        return None
    since = (beacons.host_us - beacons.host_us[0]) * 1e-6
    offset = (beacons.local_us - beacons.host_us).astype(np.float64)
    part = max(len(since) // 10, 5)
    rates = (offset[-part:] - offset[:part]) / np.maximum(since[-part:] - since[:part], 1e-6)
    growth = float(np.median(rates))
    scale = STEP_S * (len(since) - 1) / float(since[-1])
    left = offset - offset[0] - growth * since
    return Against(beacons, (float(offset[0]), growth), smooth(since * scale, left, 1.0, BLOCK_S_MAX * scale), scale)


def recent(beacons: Beacons) -> Beacons:
    """Those of the last minutes: enough for what is wanted now, while beacons still come."""
    kept = beacons.host_us > beacons.host_us[-1:] - RECENT_US
    of = beacons.sequence[kept], beacons.host_us[kept], beacons.local_us[kept]
    return Beacons(*of, beacons.repeated, beacons.other_runs)


@dataclass(frozen=True, slots=True)
class Between:
    """The second robot's clock against the first's, by the beacons of one run of the host that both heard."""

    first: int
    second: int
    common: int
    """Beacons that both heard; the curves go through the others too."""
    slope_ppm: float
    slope_bound_ppm: float
    at_us: float
    """First clock: the middle of the time in which both heard beacons."""
    offset_us: float
    """Second less first, there."""
    bound_us: float
    """Of it, 99 %."""
    worst_us: float
    """The greatest bound in that time."""
    span_s: float


def between(first: int, second: int, one: Against, other: Against) -> Between | None:
    """None: they heard different runs of the host, or at different times."""
    ours, theirs = (
        set(zip(each.sequence.tolist(), each.host_us.tolist(), strict=True)) for each in (one.beacons, other.beacons)
    )
    common = len(ours & theirs)
    begin = max(int(one.beacons.host_us[0]), int(other.beacons.host_us[0]))
    end = min(int(one.beacons.host_us[-1]), int(other.beacons.host_us[-1]))
    if not common or end <= begin:
        return None
    host_us = np.linspace(begin, end, 201)
    here, here_bound = one.at(host_us)
    there, there_bound = other.at(host_us)
    away, bound = there - here, np.hypot(here_bound, there_bound)
    passed = float(host_us[-1] - host_us[0] + here[-1] - here[0])
    middle = len(host_us) // 2
    return Between(
        first=first,
        second=second,
        common=common,
        slope_ppm=float(away[-1] - away[0]) / passed * 1e6,
        slope_bound_ppm=float(np.hypot(bound[0], bound[-1])) / passed * 1e6,
        at_us=float(host_us[middle] + here[middle]),
        offset_us=float(away[middle]),
        bound_us=float(bound[middle]),
        worst_us=float(bound.max()),
        span_s=float(end - begin) * 1e-6,
    )
