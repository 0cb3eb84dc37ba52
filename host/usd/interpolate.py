"""Position and attitude between a log's rows, with how far they may be off; a refusal where a log does not say.

Nothing is extrapolated: a time is answered inside a run of rows of one epoch without a hole. Positions come from the
polynomial through the nearest 2 (linear) or 4 (cubic) rows, attitudes from slerp between the nearest 2, signs aligned.

Rows come more often than some estimators run, and then repeat the estimate before: a row that does is left out, as its
value is older than its stamp; unless the robot stands still.

The error has two parts, which are added.
- Gap. A polynomial through n rows is off by |(t - t1) ... (t - tn)| times the divided difference of order n over those
  rows and t itself. That is not known; the largest over n + 1 rows, of the runs of rows that include the n, stands for
  it, times MARGIN. Noise of the rows is in it as far as it changes from row to row. Attitudes likewise with n = 2: the
  differences are those of the turning rate.
- Stamp. The time that is asked for may be off by its own bound, each row's by another: how old an estimate can be when
  a row holds it for the first time. That times the speed (or turning rate) in this gap, at its most.
What the estimate itself is off by is in neither: no log tells. How late it is, a gyro in the same log can tell, and
then that can be set right.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .curves import Floats
from .examine import HOLE_INTERVALS
from .runs import Places, Run
from .track import Track

Method = Literal["linear", "cubic"]


class Refusal(IntEnum):
    """Why a time has no answer; NONE: it has."""

    NONE = 0
    BEFORE = 1
    """The first row."""
    AFTER = 2
    """The last row."""
    HOLE = 3
    """Rows are missing there."""
    EPOCH = 4
    """Between two resets' epochs, or in several."""
    FEW = 5
    """Rows, for the error to be known."""
    UNVERIFIED = 6
    """A row that is used."""
    INVALID = 7
    """A row that is used has no number, or no quaternion."""


@dataclass(frozen=True, slots=True)
class Poses:
    """One for each time. Where `refusal` is not 0, floats are NaN."""

    at_us: Floats
    refusal: NDArray[np.uint8]
    epoch: NDArray[np.int32]
    gap_us: Floats
    """Between the rows before and behind."""
    position_m: Floats | None
    position_error_m: Floats | None
    """Radius of the ball that the position is in."""
    attitude: Floats | None
    """x y z w."""
    attitude_error_rad: Floats | None


def interpolate(
    track: Track,
    at_us: Floats,
    method: Method = "linear",
    *,
    bound_us: Floats | float = 0.0,
    row_error_us: float | None = None,
    hole_us: float | None = None,
    epoch: int | None = None,
    unverified: bool = False,
    lag_us: float = 0.0,
) -> Poses:
    """`bound_us`: of each time. `lag_us`: the rows are so late: what was at a time has a stamp so much later.
    `row_error_us`: of the rows' stamps; None: as runs.Run finds it. `hole_us`: no answer in a gap that is longer; None:
    HOLE_INTERVALS times the median. `epoch`: in which to look; None: in whichever has the time. `unverified`: use such
    rows, too."""
    asked_us = np.asarray(at_us, np.float64)
    at_us = asked_us + lag_us
    bounds = np.broadcast_to(np.asarray(bound_us, np.float64), at_us.shape)
    sorted_rows = [in_order(track, part) for part in track.epochs]
    number, refusal = which_epoch(track, sorted_rows, at_us, epoch)
    position = None if track.position_m is None else np.full((len(at_us), 3), np.nan)
    attitude = None if track.attitude is None else np.full((len(at_us), 4), np.nan)
    position_error, attitude_error, gap_us = (np.full(len(at_us), np.nan) for _ in range(3))
    hole = hole_us if hole_us is not None else usual_us(track, sorted_rows) * HOLE_INTERVALS
    for each, rows in enumerate(sorted_rows):
        asked = np.flatnonzero((number == each) & (refusal == 0))
        if not len(asked):
            continue
        run = Run(track, rows, hole, row_error_us)
        found = run.brackets(at_us[asked], 4 if method == "cubic" and position is not None else 2)
        why = np.where(found.hole, Refusal.HOLE, np.where(found.few, Refusal.FEW, 0)).astype(np.uint8)
        if not unverified:
            why[(why == 0) & ~run.verified(found)] = Refusal.UNVERIFIED
        refusal[asked] = why
        asked, found = asked[why == 0], found.of(why == 0)
        gap_us[asked] = found.gap_us
        if position is not None:
            position[asked], position_error[asked] = run.positions(found, bounds[asked])
        if attitude is not None:
            attitude[asked], attitude_error[asked] = run.attitudes(found, bounds[asked])
    for values, error in ((position, position_error), (attitude, attitude_error)):
        if values is not None:
            refusal[(refusal == 0) & ~(np.isfinite(values).all(axis=1) & np.isfinite(error))] = Refusal.INVALID
    for array in (position, attitude, position_error, attitude_error, gap_us):
        if array is not None:
            array[refusal != 0] = np.nan
    return Poses(
        at_us=asked_us,
        refusal=refusal,
        epoch=number,
        gap_us=gap_us,
        position_m=position,
        position_error_m=None if position is None else position_error,
        attitude=attitude,
        attitude_error_rad=None if attitude is None else attitude_error,
    )


def in_order(track: Track, part: range) -> Places:
    """Rows of an epoch by their time; of several with the same time, the first."""
    stamps = track.stamp_us[part.start : part.stop]
    if (stamps[1:] > stamps[:-1]).all():
        return np.arange(part.start, part.stop)
    _, first = np.unique(stamps, return_index=True)
    return first + part.start


def usual_us(track: Track, sorted_rows: list[Places]) -> float:
    steps = [np.diff(track.stamp_us[rows].astype(np.int64)) for rows in sorted_rows]
    every = np.concatenate([np.zeros(0), *steps])
    return float(np.median(every)) if len(every) else 0.0


def which_epoch(
    track: Track, sorted_rows: list[Places], at_us: Floats, only: int | None
) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    number = np.full(len(at_us), -1, np.int32)
    count = np.zeros(len(at_us), np.intp)
    first, last = np.inf, -np.inf
    for each, rows in enumerate(sorted_rows):
        if not len(rows) or only not in (None, each):
            continue
        begin, end = float(track.stamp_us[rows[0]]), float(track.stamp_us[rows[-1]])
        inside = (begin <= at_us) & (at_us <= end)
        number[inside] = each
        count += inside
        first, last = min(first, begin), max(last, end)
    refusal = np.where(count == 1, 0, Refusal.EPOCH).astype(np.uint8)
    refusal[at_us < first] = Refusal.BEFORE
    refusal[(at_us > last) & (at_us >= first)] = Refusal.AFTER
    refusal[np.isnan(at_us)] = Refusal.INVALID
    return number, refusal
