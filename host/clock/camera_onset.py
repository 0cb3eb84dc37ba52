"""The dataset paper's check of its stamps: the first frame that has moved, less the moment when the gyro began to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ticks import Floats

QUIET_S = 0.2
RISES = 0.1
"""Of the 99th percentile of the speed: what is faster moves."""
MOVED_PX = 1.0
BEFORE_S = 0.05
AFTER_S = 0.3


@dataclass(frozen=True, slots=True)
class Onsets:
    late_s: Floats
    """Of each time that the robot began to move: the first frame whose picture has moved, as stamped."""

    @property
    def mean_s(self) -> float:
        return float(self.late_s.mean())

    @property
    def sd_s(self) -> float:
        return float(self.late_s.std(ddof=1))


def onsets(time_s: Floats, rate_rad_s: Floats, stamp_s: Floats, moved_px: Floats) -> Onsets | None:
    """`moved_px`: of each frame but the first, from the one before it; NaN where that is not known. None if the robot
    was at rest, and then moved, less than twice."""
    speed = np.sqrt(((rate_rad_s - np.median(rate_rad_s, axis=0)) ** 2).sum(axis=1))
    found = []
    for begin_s in time_s[begins(time_s, speed)]:
        frame = first_moved(stamp_s, moved_px, begin_s)
        if frame is not None:
            found.append(stamp_s[frame] - begin_s)
    return Onsets(np.array(found)) if len(found) > 1 else None


def begins(time_s: Floats, speed: Floats) -> NDArray[np.intp]:
    """Rows in which a movement begins after rest."""
    fast = np.flatnonzero(speed > RISES * np.quantile(speed, 0.99))
    if not len(fast):
        return fast
    rested = np.concatenate([[time_s[fast[0]] - time_s[0]], np.diff(time_s[fast])]) > QUIET_S
    return np.asarray(fast[rested])


def first_moved(stamp_s: Floats, moved_px: Floats, begin_s: float) -> int | None:
    """None when pictures moved before already, or do not soon."""
    near = np.flatnonzero((stamp_s[1:] > begin_s - BEFORE_S) & (stamp_s[1:] < begin_s + AFTER_S)) + 1
    for frame in near:
        if moved_px[frame - 1] > MOVED_PX:
            was_still = frame >= 2 and moved_px[frame - 2] <= MOVED_PX
            return int(frame) if was_still else None
    return None
