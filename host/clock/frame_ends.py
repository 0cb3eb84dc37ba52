"""When frames ended, from readings of the GAP8's clock that interrupts made late.

Frames that began at an even pace end at one, and a reading can only be late: what messages' delays are to the clocks'
offset, the readings' lateness is to the pace. A lateness that every reading has cannot be seen.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .envelope import COARSE_US, FINE_US
from .smoother import BLOCK_PAIRS, smooth
from .ticks import Floats, Ints

APART_US = 1000.0
"""By more than this and twice the latest reading off the pace, and another one has begun."""
STEPS_MAX = 1000
"""Frames that may be missing in a row."""
LATEST = math.log(100)
"""Mean latenesses that 99 % of readings stay below."""
FEW = 8
"""Frames that have a line, as on the robot; a curve wants more."""
LINE_BOUND = 14.0
"""Mean latenesses that a line of n readings is off by, times n, 99 %."""
STRAY = 9
"""Readings whose median is taken: fewer than half of them may have begun late."""
ALONE = 0.9
"""Share of a stretch's frames of which the robot says that it knows no more than from one reading."""


@dataclass(frozen=True, slots=True)
class Readings:
    """Of one robot's frames, in their order."""

    number: Ints
    """Of its place in the camera's pace, where nothing is missing."""
    mode: Ints
    """The camera's settings, as a number: another one moves the end of frame."""
    latency_us: Floats
    """How well the robot itself says that it knows how late it read its clock, 99 %; NaN: it says nothing."""


@dataclass(frozen=True, slots=True)
class Ends:
    gap8_us: Floats
    bound_us: Floats
    """How far off that may be by the readings' lateness and their ticks, 99 %, either side."""
    paced: NDArray[np.bool_]
    """Found from the pace; the others are as they were read, in the middle of their tick."""
    told: bool
    """The robot says how late readings may be, so that this is in the bound."""
    late_us: float | None
    """Mean of the readings' lateness that was found and taken off."""


def as_read(gap8_us: Ints, tick_us: float) -> Ends:
    """Where nothing is known of the lateness, and nothing of it in the bound."""
    count = len(gap8_us)
    middle_us = gap8_us.astype(np.float64) + tick_us / 2
    return Ends(middle_us, np.full(count, tick_us / 2), np.zeros(count, np.bool_), False, None)


def frame_ends(gap8_us: Ints, boot: Ints, readings: Readings, tick_us: float) -> Ends:
    """`gap8_us` unwrapped, in whole ticks of `tick_us`; `boot`: how often the GAP8 had started anew."""
    ends = as_read(gap8_us, tick_us)
    told_us = readings.latency_us[~np.isnan(readings.latency_us)]
    most_us = float(told_us.max(initial=0))
    # Who tells of no lateness has but its ticks to lose at a pace.
    if not len(told_us) or (most_us == 0 and tick_us <= COARSE_US):
        return ends
    ends.bound_us[:] += most_us
    late: list[Floats] = []
    worst_us = most_us + tick_us
    for mine in stretches(gap8_us, boot, readings, worst_us):
        told_us = readings.latency_us[mine]
        told_us = told_us[~np.isnan(told_us)]
        if not len(told_us) or (most_us > 0 and (told_us >= most_us).mean() > ALONE):
            continue
        if len(mine) >= 2 * BLOCK_PAIRS:
            end_us, bound_us, off = pace(ends.gap8_us[mine], readings.number[mine], tick_us, most_us / LATEST)
        elif tick_us > COARSE_US:
            continue  # few readings have no edge in such ticks, and no mean
        else:
            end_us, bound_us, off = line(ends.gap8_us[mine], readings.number[mine], tick_us)
        late_us = ends.gap8_us[mine] - end_us
        if late_us[~off].mean() > worst_us / 2:
            continue  # they are of no one pace: readings are not so late
        # By the robot's word a frame ended no more than that before its reading, however little the pace says.
        bound_us = np.minimum(bound_us, np.maximum(late_us, most_us - late_us) + tick_us / 2)
        late.append(late_us[~off])
        on = mine[~off]
        ends.gap8_us[on], ends.bound_us[on], ends.paced[on] = end_us[~off], bound_us[~off], True
    mean_us = float(np.concatenate(late).mean()) if late and most_us > 0 else None
    return Ends(ends.gap8_us, ends.bound_us, ends.paced, most_us > 0, mean_us)


def stretches(gap8_us: Ints, boot: Ints, readings: Readings, most_us: float) -> list[Ints]:
    """Places of frames that may be of one pace, enough for a line. `most_us`: what readings may be late."""
    step_us, steps = np.diff(gap8_us), np.diff(readings.number)
    same = (np.diff(boot) == 0) & (np.diff(readings.mode) == 0) & (steps > 0) & (steps <= STEPS_MAX)
    found = []
    for part in np.split(np.arange(len(gap8_us)), np.flatnonzero(~same) + 1):
        if len(part) < FEW:
            continue
        inside = part[:-1]
        period_us = float(np.median(step_us[inside] / steps[inside]))
        off = np.abs(step_us[inside] - period_us * steps[inside]) > APART_US + 2 * most_us
        for each in np.split(part, np.flatnonzero(off) + 1):
            found += unbent(each, gap8_us, readings.number, most_us)
    return [each for each in found if len(each) >= FEW]


def unbent(part: Ints, gap8_us: Ints, number: Ints, most_us: float) -> list[Ints]:
    """Split where the period changes by more than readings explain, less the frames of which it is not sure on which
    side they are."""
    reach = min(BLOCK_PAIRS, len(part) // 4)
    if reach < STRAY // 2:
        return [part]
    period_us = float(np.median(np.diff(gap8_us[part]) / np.diff(number[part])))
    off_us = gap8_us[part] - period_us * number[part]
    flat = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(off_us, STRAY // 2, mode="edge"), STRAY), axis=1)
    period = (flat[reach:] - flat[:-reach]) / (number[part[reach:]] - number[part[:-reach]])
    change = np.abs(period[reach:] - period[:-reach])
    most = float(change.max())
    if most <= 2 * most_us / reach:
        return [part]
    place, unsure = int(change.argmax()) + reach, math.ceil(2 * most_us / most) + 1
    sides = part[: max(place - unsure, 0)], part[place + unsure :]
    return [each for side in sides for each in unbent(side, gap8_us, number, most_us)]


def line(read_us: Floats, number: Ints, tick_us: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """As pace, of few frames: a straight line below all readings that has the least sum of distances. It touches two of
    them, and is too high by so much on average."""
    count = number - number[0]
    hull: list[int] = []
    for k in range(len(count)):
        while len(hull) > 1 and (read_us[hull[-1]] - read_us[hull[-2]]) * (count[k] - count[hull[-2]]) >= (
            read_us[k] - read_us[hull[-2]]
        ) * (count[hull[-1]] - count[hull[-2]]):
            hull.pop()
        hull.append(k)
    right = next(k for k in range(1, len(hull)) if count[hull[k]] >= count.mean())
    a, b = hull[right - 1], hull[right]
    end_us = read_us[a] + (read_us[b] - read_us[a]) / (count[b] - count[a]) * (count - count[a])
    late_us = float((read_us - end_us).sum()) / (len(count) - 2)
    end_us = end_us - 2 * late_us / len(count)
    bound_us = np.full(len(count), LINE_BOUND * late_us / len(count) + tick_us / 2)
    return end_us, bound_us, read_us - end_us > 2 * (LATEST * late_us + tick_us) + bound_us


def pace(read_us: Floats, number: Ints, tick_us: float, late_us: float) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Ends of frames, their bounds, and which of the readings are too late for chance: these frames began late."""
    count = number - number[0]
    period_us = float((read_us[-1] - read_us[0]) / count[-1])
    due_s: Floats = period_us * 1e-6 * count
    base_us = read_us[0]
    read_s = (read_us - base_us) * 1e-6
    made = smooth(read_s, (read_s - due_s) * 1e6, tick_us, coarse_mu_us=late_us)
    end_us = base_us + due_s * 1e6 + made.track.at(due_s)
    bound_us = np.interp(due_s, made.track.time_s, made.bound_us) + min(tick_us, FINE_US) / 2
    most_us = 2 * (LATEST * float(made.mu_us.max()) + tick_us) + bound_us
    return end_us, bound_us, np.abs(read_us - end_us) > most_us
