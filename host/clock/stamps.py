"""Every frame's time on the STM32's clock, with its bound, from all messages of a recording; or why it gets none."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from .allan import Steadiness, allan_deviation
from .frame_ends import Ends, Readings, as_read, frame_ends
from .smoother import BLOCK_PAIRS, STIFFNESS, Smoothed, smooth
from .ticks import RTC_HZ, SLOW, Epoch, Floats, Ints, Sorted, sent_tick_us, sort, tick_us

Refusal = Literal[
    "no messages",
    "before the first message",
    "after the last message",
    "between epochs",
    "too few messages",
    "no message near",
]
REFUSALS: tuple[Refusal, ...] = get_args(Refusal)
AGE_S = 10.0
"""A frame further from any message is refused."""
HELD_OVER_S = 0.25
"""One so far outside all messages of its epoch is marked, as by the robot."""
NEAR_S = 0.5
BOUND_US_MAX = 20_000.0
BEYOND = 3 * math.sqrt(2)
"""Allan deviations that the rate may be another than it was, 99 %."""
LONE_PPM = 0.5
"""How far a rate may change within a second that nothing was heard in, at the least."""
SLOW_PPM = (1 / SLOW - 1) * 1e6
"""Drift of a right clock against a slow one."""
CRYSTAL_PPM = 1000.0
"""More than a watch crystal is off: a clock that counts its ticks is right."""
FRAMES_MIN = 20
WIRE_US = 17 * 10 * 365 / 42
"""A native message on UART1, from the reading of the clock to the last stop bit."""


@dataclass(frozen=True, slots=True)
class Fitted:
    """An epoch and its curve."""

    epoch: Epoch
    boot: int
    begin_us: int
    """GAP8, unwrapped: the zero of the curve's time."""
    base_us: int
    """Offset, GAP8 less STM32, that the curve is added to."""
    sent_us: tuple[float, float]
    """GAP8 time at which the first message was sent, and the last."""
    smoothed: Smoothed
    drift_ppm: float
    """Of the GAP8's clock against the STM32's, mean."""
    is_slow: bool
    """The STM32's clock counts 84 where 85 have passed: it is nearer to that than to right."""
    wire_stm32_us: float
    """A message's time on the wire, as the STM32's clock counts ..."""
    wire_bound_us: float
    """... and how far off that is if which of the two clocks is the wrong one has been guessed wrongly."""
    steadiness: Steadiness


@dataclass(frozen=True, slots=True)
class Stamped:
    """What came of all frames. The arrays speak of those that were given a time."""

    fitted: tuple[Fitted, ...]
    sorted: Sorted
    gap8_tick_us: float
    stm32_tick_us: float
    frame: Ints
    """Numbers of the frames that have one, in order."""
    stm32_us: Floats
    """End of frame."""
    bound_us: Floats
    """99 %, either side."""
    epoch: Ints
    """Place in `fitted`."""
    held_over: NDArray[np.bool_]
    """Outside of all messages of its epoch: that the clock was not set meanwhile, nothing says."""
    refused: dict[int, Refusal]
    """By frame."""
    wire_us: float
    """Taken off each message's delay."""
    ends: Ends
    """Of all frames."""

    @property
    def stm32_per_gap8(self) -> Floats:
        """How fast the STM32's clock runs on the GAP8's, of each frame."""
        return 1 / (1 + 1e-6 * np.array([each.drift_ppm for each in self.fitted])[self.epoch])


def stamp(
    stm32: NDArray[np.uint64],
    gap8: NDArray[np.uint64],
    frame_gap8: NDArray[np.uint64],
    frame_after: Ints,
    resets: Ints | None = None,
    wire_us: float = 0.0,
    stm32_tick_us: float = 1.0,
    readings: Readings | None = None,
    arrival_us: Floats | None = None,
) -> Stamped:
    """As ticks.sort takes them. `wire_us`: how long a message is on the wire. `stm32_tick_us`: where it is known; it
    shows only if messages are not sent at even steps of it. Without `readings` frames have ended when the GAP8 read its
    clock. `arrival_us`: when each frame came to the host, on a clock that is right."""
    ticks = tick_us(gap8), max(stm32_tick_us, sent_tick_us(stm32))
    told = np.zeros(len(stm32), np.int64) if resets is None else resets
    all_ = sort(stm32, gap8, frame_gap8, frame_after, resets, max(ticks))
    right = None if arrival_us is None else against_right(all_.frame_gap8_us, all_.frame_boot, arrival_us)
    right = right or ((0.0, CRYSTAL_PPM) if ticks[0] == 1e6 / RTC_HZ else (0.0, math.inf))
    fitted = tuple(fit(all_, each, max(ticks), wire_us, right) for each in all_.epochs if is_enough(all_, each))
    read_us = all_.frame_gap8_us
    ends = frame_ends(read_us, all_.frame_boot, readings, ticks[0]) if readings else as_read(read_us, ticks[0])
    frames = ends.gap8_us
    value, bound = np.zeros(len(frames)), np.full(len(frames), np.inf)
    owner, held_over = np.full(len(frames), -1), np.zeros(len(frames), np.bool_)
    why = refusals(all_, fitted, frames)
    for number, each in enumerate(fitted):
        reach = (frames >= each.sent_us[0] - AGE_S * 1e6) & (frames <= each.sent_us[1] + AGE_S * 1e6)
        mine = np.flatnonzero((all_.frame_boot == each.boot) & reach & ~between(all_, told, each, frames))
        at_s = (frames[mine] - each.begin_us) * 1e-6
        knots = each.smoothed.track
        # Ticks are read as their middle, on both clocks; the half tick of the STM32's is what it is on average.
        value[mine] = frames[mine] - each.base_us - knots.at(at_s) - (ticks[0] - ticks[1]) / 2 + each.wire_stm32_us
        mine_bound = np.interp(at_s, knots.time_s, each.smoothed.bound_us) + ticks[1] / 2 + each.wire_bound_us
        bound[mine] = mine_bound + away_us(all_, each, frames[mine]) + ends.bound_us[mine]
        owner[mine] = number
        outside_us = np.maximum(each.sent_us[0] - frames[mine], frames[mine] - each.sent_us[1])
        held_over[mine] = outside_us > HELD_OVER_S * 1e6
    given = (owner >= 0) & (bound <= BOUND_US_MAX)
    refused = {int(frame): REFUSALS[why[frame]] for frame in np.flatnonzero(~given)}
    return Stamped(
        fitted, all_, *ticks, np.flatnonzero(given), value[given], bound[given], owner[given], held_over[given],
        refused, wire_us, ends,
    )  # fmt: skip


def is_enough(all_: Sorted, epoch: Epoch) -> bool:
    return len(epoch.messages) >= 2 * BLOCK_PAIRS


def fit(all_: Sorted, epoch: Epoch, coarse_us: float, wire_us: float, right: tuple[float, float]) -> Fitted:
    """`right`: drift of the GAP8's clock against a right one, ppm, and how far off that may be."""
    gap8, stm32 = all_.gap8_us[epoch.messages], all_.stm32_us[epoch.messages]
    begin, base = int(gap8[0]), int(gap8[0] - stm32[0])
    time_s: Floats = (gap8 - begin).astype(np.float64) * 1e-6
    offset = (gap8 - stm32 - base).astype(np.float64)
    made = smooth(time_s, offset, coarse_us)
    curve = made.track
    slope = float(np.polyfit(curve.time_s, curve.offset_us, 1)[0])  # over the GAP8's time
    drift = slope / (1 - slope * 1e-6)
    step_s = max(float(np.median(np.diff(curve.time_s))), 1e-3)
    even = step_s * np.arange(int(curve.time_s[-1] / step_s), dtype=np.float64)
    # A message that came too early, before the others of an epoch, was sent before the clock was set for the last time.
    ends = made.kept[[0, -1]]
    late = np.maximum(offset[ends] - curve.at(time_s[ends]), 0)
    first, last = (gap8[ends] - late - wire_us).tolist()
    stm32_ppm = drift - right[0]
    is_slow = abs(stm32_ppm - SLOW_PPM) < abs(stm32_ppm)
    is_sure = right[1] + abs(stm32_ppm - SLOW_PPM * is_slow) < SLOW_PPM / 2
    wire_stm32_us = wire_us * (SLOW if is_slow else 1)
    return Fitted(
        epoch, int(all_.message_boot[epoch.messages[0]]), begin, base, (first, last), made, drift,
        is_slow, wire_stm32_us, 0.0 if is_sure else wire_us * (1 - SLOW), allan_deviation(curve.at(even), step_s),
    )  # fmt: skip


def against_right(frame_gap8_us: Ints, boot: Ints, arrival_us: Floats) -> tuple[float, float] | None:
    """Drift of the GAP8's clock, ppm, and how far off that may be, by when frames came to a host."""
    mine = boot == np.bincount(boot).argmax() if len(boot) else np.zeros(0, np.bool_)
    if mine.sum() < FRAMES_MIN:
        return None
    gap8_us = (frame_gap8_us[mine] - frame_gap8_us[mine][0]).astype(np.float64)
    late_us = arrival_us[mine] - arrival_us[mine][0] - gap8_us
    slope, base = np.polyfit(gap8_us, late_us, 1)
    # Delays on the network come and go slowly: as if there were one at either end.
    scatter_us = float((late_us - base - slope * gap8_us).std())
    return -1e6 * float(slope), 1e6 * 3 * math.sqrt(12) * scatter_us / max(float(gap8_us[-1]), 1.0)


def between(all_: Sorted, told: Ints, each: Fitted, frames: Floats) -> NDArray[np.bool_]:
    """Frames beside an epoch, on a side where messages of another one of the same boot came, be they ever so few: in
    which of both they are is not known. `told`: the STM32's count of its resets, in each message."""
    others = told != told[each.epoch.messages[0]]
    for epoch in all_.epochs:
        if epoch is not each.epoch:
            others[epoch.messages] = True
    heard = all_.gap8_us[others & (all_.message_boot == each.boot)]
    if not len(heard):
        return np.zeros(len(frames), np.bool_)
    first, last = each.sent_us
    return np.asarray((frames < first) & (heard.min() < first) | (frames > last) & (heard.max() > last))


def away_us(all_: Sorted, each: Fitted, frames: Floats) -> Floats:
    """What the clock may have done since the nearest message: its own Allan deviation at that span, thrice; and beyond
    the first and the last, how well the rate there is known."""
    heard = all_.gap8_us[each.epoch.messages].astype(np.float64)
    after = np.clip(np.searchsorted(heard, frames), 0, len(heard) - 1)
    before = np.maximum(after - 1, 0)
    apart_s = np.minimum(np.abs(heard[after] - frames), np.abs(frames - heard[before])) * 1e-6
    known = each.steadiness
    ppm = np.interp(apart_s, known.span_s, known.deviation_ppm) if known.span_s else np.full(len(frames), 100.0)
    away: Floats = np.where(apart_s > NEAR_S, 3 * np.maximum(ppm, LONE_PPM) * apart_s, 0.0)
    for end, beyond in (0, frames < heard[0]), (-1, frames > heard[-1]):
        far_s = apart_s[beyond]
        # Of longer spans than are known: a clock that warms up or cools down changes in proportion to them.
        longer = np.maximum(far_s / known.span_s[-1], 1) if known.span_s else far_s
        rate_ppm = each.smoothed.bound_us[end] / (STIFFNESS * each.smoothed.block_s[end])
        away[beyond] = (BEYOND * np.maximum(ppm[beyond] * longer, LONE_PPM) + rate_ppm) * far_s
    return away


def refusals(all_: Sorted, fitted: tuple[Fitted, ...], frames: Floats) -> Ints:
    """Why each frame would get no time, as a place in REFUSALS."""
    why = np.full(len(frames), REFUSALS.index("no messages"))
    for boot in np.unique(all_.frame_boot):
        mine = all_.frame_boot == boot
        spans = sorted(each.sent_us for each in fitted if each.boot == boot)
        if not spans:
            if (all_.message_boot == boot).any():
                why[mine] = REFUSALS.index("too few messages")
            continue
        inside = np.zeros(len(frames), np.bool_)
        for begin, end in spans:
            inside |= (frames >= begin) & (frames <= end)
        reason = np.where(inside, REFUSALS.index("no message near"), REFUSALS.index("between epochs"))
        heard = all_.gap8_us[all_.message_boot == boot]
        outside = (frames < spans[0][0]) | (frames > spans[-1][1])
        reason = np.where(outside, REFUSALS.index("too few messages"), reason)
        reason = np.where(outside & (frames < heard.min()), REFUSALS.index("before the first message"), reason)
        reason = np.where(outside & (frames > heard.max()), REFUSALS.index("after the last message"), reason)
        why = np.where(mine, reason, why)
    return why
