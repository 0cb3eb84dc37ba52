"""The rows of one epoch, for interpolation: which of them are around a time, what lies between, how sure that is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .curves import Floats, divided, lagrange, norm, rotation_vector, slerp
from .track import Track

Places = NDArray[np.intp]

ROW_ERROR_US = 1000.0
"""An estimate is so old at most when a row holds it for the first time: the estimator runs at 1 kHz."""
REPEATED = 0.05
"""With more rows than that repeating the one before, it runs more seldom than rows come: up to a row's interval."""
STILL_US = 25_000
"""A value that stays for longer is that of a robot that stands still: estimators run at 100 Hz at least."""
MARGIN = 1.5


@dataclass(frozen=True, slots=True)
class Brackets:
    """For each time: which rows of the run are around it."""

    at: Floats
    """Since the run's first row."""
    before: Places
    """The row before; the next is behind."""
    first: Places
    """Of the rows of the polynomial."""
    nodes: int
    begin: Places
    """First row without a hole in between."""
    end: Places
    """And the one behind the last."""
    gap_us: Floats
    hole: NDArray[np.bool_]
    few: NDArray[np.bool_]

    def of(self, keep: NDArray[np.bool_]) -> Brackets:
        return Brackets(
            self.at[keep], self.before[keep], self.first[keep], self.nodes, self.begin[keep], self.end[keep],
            self.gap_us[keep], self.hole[keep], self.few[keep],
        )  # fmt: skip


class Run:
    """The rows of one epoch, in the order of their times."""

    def __init__(self, track: Track, rows: Places, hole_us: float, row_error_us: float | None) -> None:
        steps = np.diff(track.stamp_us[rows].astype(np.int64)).astype(np.float64)
        part = np.concatenate([[0], np.cumsum(steps > hole_us)])
        new = is_new(track, rows, part)
        repeated = len(new) > 1 and 1 - new.mean() > REPEATED
        own_us = max(ROW_ERROR_US, float(np.median(steps))) if repeated else ROW_ERROR_US
        self._row_us = track.quantum_us + (own_us if row_error_us is None else row_error_us)
        rows, part = rows[new], part[new]
        stamps = track.stamp_us[rows]
        self._base = int(stamps[0])
        self._times = (stamps - stamps[0]).astype(np.float64)
        self._is_verified = track.is_verified[rows]
        self._position = None if track.position_m is None else track.position_m[rows]
        self._attitude = None if track.attitude is None else track.attitude[rows]
        self._begin = np.searchsorted(part, part, side="left")
        self._end = np.searchsorted(part, part, side="right")

    def brackets(self, at_us: Floats, nodes: int) -> Brackets:
        at = at_us - self._base
        count = len(self._times)
        before = np.clip(np.searchsorted(self._times, at, side="right") - 1, 0, max(count - 2, 0))
        # A row itself is no hole, if it is the last one before it.
        alone = (self._end[before] == before + 1) & (at == self._times[before]) & (before > self._begin[before])
        before = before - alone
        behind = np.minimum(before + 1, count - 1)
        begin, end = self._begin[before], self._end[before]
        few = (end - begin < nodes + 1) | (count < 2)
        first = np.clip(before - (nodes // 2 - 1), begin, np.maximum(end - nodes, begin))
        gap_us = self._times[behind] - self._times[before]
        return Brackets(at, before, first, nodes, begin, end, gap_us, self._begin[behind] != begin, few)

    def verified(self, found: Brackets) -> NDArray[np.bool_]:
        """Of all rows that the values come from."""
        good = np.concatenate([[0], np.cumsum(~self._is_verified)])
        last = np.minimum(np.maximum(found.first + found.nodes, found.before + 2), len(self._times))
        return np.asarray(good[last] == good[np.minimum(found.first, found.before)])

    def positions(self, found: Brackets, bound_us: Floats) -> tuple[Floats, Floats]:
        assert self._position is not None
        weights, product = lagrange(found.at, self._times[found.first[:, None] + np.arange(found.nodes)])
        picked = self._position[found.first[:, None] + np.arange(found.nodes)]
        value = (weights[:, :, None] * picked).sum(axis=1)
        gap = MARGIN * product * self._steepest(found, found.first, found.nodes)
        slope, bend = self._slope(found), MARGIN * self._steepest(found, found.before, 2)
        late_us = bound_us + self._row_us * np.abs(weights).sum(axis=1)
        return value, gap + late_us * (slope + bend * (found.gap_us + late_us))

    def _slope(self, found: Brackets) -> Floats:
        assert self._position is not None
        step = self._position[found.before + 1] - self._position[found.before]
        return norm(step) / found.gap_us

    def _steepest(self, found: Brackets, first: Places, order: int) -> Floats:
        """The largest divided difference of that order, of the two runs of rows around those `order` rows."""
        assert self._position is not None
        most = np.zeros(len(first))
        for begin in (first - 1, first):
            begin = np.clip(begin, found.begin, found.end - order - 1)
            places = begin[:, None] + np.arange(order + 1)
            most = np.maximum(most, norm(divided(self._times[places], self._position[places])))
        return most

    def attitudes(self, found: Brackets, bound_us: Floats) -> tuple[Floats, Floats]:
        assert self._attitude is not None
        start, end = self._times[found.before], self._times[found.before + 1]
        part = (found.at - start) / (end - start)
        value = slerp(self._attitude[found.before], self._attitude[found.before + 1], part)
        turning = self._turning(found.before)
        bend = np.zeros(len(found.at))
        for beside in (found.before - 1, found.before + 1):
            beside = np.clip(beside, found.begin, found.end - 2)  # at an end that is the gap itself, without a bend
            over = self._times[np.maximum(beside, found.before) + 1] - self._times[np.minimum(beside, found.before)]
            bend = np.maximum(bend, MARGIN * norm(self._turning(beside) - turning) / over)
        gap = (found.at - start) * (end - found.at) * bend
        late_us = bound_us + self._row_us
        return value, gap + late_us * (norm(turning) + bend * (found.gap_us + late_us))

    def _turning(self, row: Places) -> Floats:
        """Rate from that row to the next, rad/us, in the robot's own axes."""
        assert self._attitude is not None
        step = self._times[row + 1] - self._times[row]
        return np.asarray(rotation_vector(self._attitude[row], self._attitude[row + 1]) / step[:, None])


def is_new(track: Track, rows: Places, part: Places) -> NDArray[np.bool_]:
    """Which rows hold an estimate that the row before did not hold. The last one before a hole always counts."""
    new = np.ones(len(rows), np.bool_)
    same = part[1:] == part[:-1]
    for values in (track.position_m, track.attitude):
        if values is not None:
            same = same & (values[rows[1:]] == values[rows[:-1]]).all(axis=1)
    new[1:] = ~same
    stamps = track.stamp_us[rows].astype(np.int64)
    first = np.flatnonzero(new)
    still = np.diff(np.concatenate([stamps[first], stamps[-1:]])) > STILL_US
    new |= np.repeat(still, np.diff(np.concatenate([first, [len(rows)]])))
    new[:-1] |= part[1:] != part[:-1]
    new[-1] = True
    return new
