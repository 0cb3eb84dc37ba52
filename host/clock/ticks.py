"""Readings of counters as times: unwrapped, their ticks recognised, and split where one of the clocks began anew.

An epoch is a stretch of messages over which both clocks only went on. Where it ends, the offset jumps and stays; what
jumps and comes back is an outlier, or a message that was late.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

WRAPS = (32, 48)
"""Bits of the counters that are in use; one of 64 never wraps."""
WRAP_US = 60_000_000
"""A wrap leads no further than this over it; else it is a reset."""
BACK_US = 2_000_000
"""The GAP8's times come in order but for this much; else it has started anew."""
RTC_HZ = 32768
RTC_PARTS = 15625, 512
"""A step of it, and 1 us, in whole parts."""
AT_ONCE = 8
EVEN = 0.5
"""Share of them, seen a few at a time, that are sent at even steps, if any are: some are wrong, or the rate changes."""
SLOW = 84 / 85
"""Rate of a clock that counts 84 where 85 have passed, against a right one: STM32 firmware before August 2026."""
JUMP_US = 20_000.0
"""More than delays scatter."""
DRIFT = 0.003
"""How much the rate may change while nothing is heard."""
RATE_MAX = 0.1
"""Between two messages; more is their delay."""
RETURN_US = 3e6
"""What is late for less than this was the messages' delay, not the clock."""
AGREED = 6
"""Messages that agree make an epoch; fewer are outliers."""
STUCK = 5
"""Messages in a row with the same time."""
BLOCK = 25
SIDE = 8
"""Blocks on either side that a small step is seen in."""
STEP_US = 600.0
"""Smaller steps are not told from changes of the rate."""
STEP_SIGMAS = 10.0
STEP_TICKS = 2.5


@dataclass(frozen=True, slots=True)
class Epoch:
    """Messages that one curve goes through."""

    messages: Ints
    """Their numbers, in order."""
    why: str
    """What it began with."""


@dataclass(frozen=True, slots=True)
class Sorted:
    """All messages and frames, told apart."""

    stm32_us: Ints
    gap8_us: Ints
    """Unwrapped."""
    frame_gap8_us: Ints
    message_boot: Ints
    """How often the GAP8 had started anew before each message."""
    frame_boot: Ints
    epochs: tuple[Epoch, ...]
    dropped: dict[str, int]
    """Messages in no epoch, by why."""


def unwrap(raw: NDArray[np.uint64]) -> Ints:
    """A counter of 32 or 48 bits that has wrapped, as one of 64. Signed differences: order is not asked for."""
    values = raw.astype(np.int64)
    if len(values) < 2:
        return values
    top = int(values.max())
    bits = next((each for each in WRAPS if top < 1 << each), None)
    if bits is None:
        return values
    period = 1 << bits
    step = np.diff(values)
    if -(period - WRAP_US) < step.min() and step.max() < period - WRAP_US:
        return values
    turns = (step + period < WRAP_US).astype(np.int64) - (step - period > -WRAP_US).astype(np.int64)
    values[1:] += period * np.cumsum(turns)
    return values


def tick_us(readings: NDArray[np.uint64] | Ints) -> float:
    """The step of a clock that is read in us: 1 ms, the 32768 Hz of a watch crystal, or 1 us. Steps may begin anywhere:
    a counter that started elsewhere, or has wrapped, has its own."""
    first = np.asarray(readings)[: 100 * 1000]
    some = first[:: max(1, len(first) // 1000)].astype(np.int64)
    if len(some) < AT_ONCE:
        return 1.0
    varied = len(np.unique(np.diff(some))) > 1  # A clock of 1 us that hears every 10 ms has steps of 1 ms too.
    if (some % 1000 == 0).mean() > 0.95 or (varied and on_grid(some, 1000, 1)):
        return 1000.0
    return 1e6 / RTC_HZ if on_grid(some, *RTC_PARTS) else 1.0


def sent_tick_us(readings: NDArray[np.uint64]) -> float:
    """As tick_us, of a clock that is read to be sent: at even steps of its own, which then say nothing of its ticks.
    One of 1 us that sends at each whole ms reads as one of 1 ms that sends at each tick: it is taken for that, whose
    bound has half a tick in it."""
    some: Ints = readings[:1000].astype(np.int64)
    steps = some[1:] - some[:-1]
    steps = steps[steps != 0]  # a clock that stands for a while
    if len(steps) < AT_ONCE:
        return 1.0
    # Messages are lost, and their rate may be changed: each few steps have a measure of their own.
    even = np.gcd.reduce(steps[: len(steps) // AT_ONCE * AT_ONCE].reshape(-1, AT_ONCE), axis=1)
    return 1.0 if (even > 1000).mean() > EVEN else tick_us(readings)


def on_grid(readings: Ints, step: int, us: int) -> bool:
    """Whether readings, cut to whole us, are on a grid of that step, as far as they are seen a few at a time. Both in
    parts, of which there are `us` in 1 us."""
    few = readings[: len(readings) // AT_ONCE * AT_ONCE].reshape(-1, AT_ONCE)
    place = np.sort(few * us % step, axis=1)
    empty = np.maximum(np.diff(place, axis=1).max(axis=1), place[:, 0] + step - place[:, -1])
    return bool((empty > step - us).mean() > 0.95)


def sort(
    stm32: NDArray[np.uint64],
    gap8: NDArray[np.uint64],
    frame_gap8: NDArray[np.uint64],
    frame_after: Ints,
    resets: Ints | None,
    coarse_us: float,
) -> Sorted:
    """Messages (time in it, time of its arrival) in the order of their arrival, and frames: `frame_after`, how many
    messages had come before each. `resets`: the STM32's own count of them, where messages bear one.
    `coarse_us`: the coarser tick of the two."""
    stm32_us = unwrap(stm32)
    both = unwrap(np.insert(gap8, frame_after, frame_gap8))
    boot = np.concatenate(([0], np.cumsum(np.diff(both) < -BACK_US))).astype(np.int64)[: len(both)]
    is_frame = np.zeros(len(both), np.bool_)
    is_frame[frame_after + np.arange(len(frame_after))] = True
    gap8_us, boots = both[~is_frame], boot[~is_frame]
    dropped: dict[str, int] = {}
    good = order(stm32_us, dropped)
    epochs: list[Epoch] = []
    told = resets if resets is not None else np.zeros(len(stm32_us), np.int64)
    anew = np.flatnonzero((np.diff(boots[good]) != 0) | (np.diff(told[good]) != 0)) + 1
    for part in np.split(good, anew):
        why = "the first message"
        if len(part) and part[0] != good[0]:
            same_boot = boots[part[0]] == boots[part[0] - 1]
            why = "the STM32 says that its clock was reset" if same_boot else "the GAP8 has started anew"
        epochs += split(stm32_us, gap8_us, part, why, dropped, coarse_us)
    return Sorted(stm32_us, gap8_us, both[is_frame], boots, boot[is_frame], tuple(epochs), dropped)


def order(stm32_us: Ints, dropped: dict[str, int]) -> Ints:
    """Numbers of the messages that are neither repeated, nor of a clock that stands still, nor swapped."""
    same = np.diff(stm32_us, prepend=stm32_us[:1] - 1) == 0
    run = np.diff(np.append(np.flatnonzero(~same), len(same))) - 1
    count(dropped, "the STM32's clock stood still", int(run[run >= STUCK].sum()))
    count(dropped, "repeated", int(run[run < STUCK].sum()))
    left = np.flatnonzero(~same)
    times = stm32_us[left]
    if len(left) > 3:
        back = np.flatnonzero(np.diff(times) < 0)
        back = back[(back > 0) & (back < len(times) - 2)]
        within = (times[back - 1] < times[back + 1]) & (times[back + 2] > times[back])
        swapped = back[within & (times[back] - times[back + 1] < BACK_US)]
        out = np.unique(np.concatenate((swapped, swapped + 1)))
        count(dropped, "out of order", len(out))
        left = np.delete(left, out)
    return left


def count(dropped: dict[str, int], why: str, messages: int) -> None:
    if messages:
        dropped[why] = dropped.get(why, 0) + messages


def split(
    stm32_us: Ints, gap8_us: Ints, part: Ints, why: str, dropped: dict[str, int], coarse_us: float
) -> list[Epoch]:
    """Epochs of messages between which nobody says that a clock began anew."""
    held = held_up(stm32_us[part], gap8_us[part])
    count(dropped, "late", int(held.sum()))
    part = part[~held]
    if len(part) < AGREED:
        count(dropped, "too few to agree", len(part))
        return []
    gap8 = gap8_us[part].astype(np.float64)
    offset = (gap8_us[part] - stm32_us[part]).astype(np.float64)
    apart = np.maximum(np.diff(gap8), 1.0)
    rates = np.diff(offset) / apart
    rates = rates[np.abs(rates) < RATE_MAX]
    rate = float(np.median(rates)) if len(rates) else 0.0
    level = offset - rate * (gap8 - gap8[0])
    jump = np.abs(np.diff(level)) > JUMP_US + DRIFT * apart
    begin = np.concatenate(([0], np.flatnonzero(jump) + 1))
    end = np.append(begin[1:], len(part))
    found: list[Epoch] = []
    for pieces, because in joined(level, gap8, begin, end, why, dropped):
        found += [
            Epoch(part[pieces[piece]], reason)
            for piece, reason in stepped(level[pieces], gap8[pieces], because, coarse_us)
        ]
    return found


def held_up(stm32_us: Ints, gap8_us: Ints) -> NDArray[np.bool_]:
    """Messages that came at once with others, which tell that they are late by more than delays scatter."""
    if len(stm32_us) < 2:
        return np.zeros(len(stm32_us), np.bool_)
    apart = np.diff(stm32_us)
    # Nearer than they were sent: messages sent faster than most are no crowd. And nearer than most: a leap is none.
    at_once = np.diff(gap8_us) < np.minimum(apart, np.median(apart)) / 2
    begin = np.concatenate(([0], np.flatnonzero(~at_once) + 1))
    offset = gap8_us - stm32_us
    least = np.minimum.reduceat(offset, begin)
    return np.asarray(offset - np.repeat(least, np.diff(begin, append=len(offset))) > JUMP_US)


def joined(
    level: Floats, gap8: Floats, begin: Ints, end: Ints, why: str, dropped: dict[str, int]
) -> list[tuple[Ints, str]]:
    """Stretches without a jump, put together where the offset is the same: (places, why an epoch begins there)."""
    size = end - begin
    ends = [float(np.median(level[max(b, e - 32) : e])) for b, e in zip(begin, end, strict=True)]
    starts = [float(np.median(level[b : min(e, b + 32)])) for b, e in zip(begin, end, strict=True)]
    found: list[tuple[list[Ints], str]] = []
    last_level, last_us = 0.0, 0.0
    for k in range(len(begin)):
        here = np.arange(begin[k], end[k])
        from_us = gap8[begin[k]]
        to_us = float(gap8[end[k] - 1])
        away = min(abs(starts[k] - last_level), abs(ends[k] - last_level))
        if found and away <= JUMP_US / 2 + DRIFT * (from_us - last_us):
            found[-1][0].append(here)
        elif found and ends[k] > last_level and returns(k, begin, starts, gap8, last_level):
            count(dropped, "late", int(size[k]))
            continue
        elif size[k] < AGREED:
            count(dropped, "impossible", int(size[k]))
            continue
        else:
            leap_ms = (last_level - starts[k]) / 1000
            found.append(([here], f"the STM32's clock leapt by {leap_ms:+.1f} ms" if found else why))
        last_level, last_us = ends[k], to_us
    return [(np.concatenate(pieces), because) for pieces, because in found]


def returns(k: int, begin: Ints, starts: list[float], gap8: Floats, to: float) -> bool:
    """A later stretch is where the one before this was, soon."""
    for later in range(k + 1, len(begin)):
        if gap8[begin[later]] - gap8[begin[k]] > RETURN_US:
            return False
        if abs(starts[later] - to) <= JUMP_US / 2:
            return True
    return False


def stepped(level: Floats, gap8: Floats, why: str, coarse_us: float) -> list[tuple[slice, str]]:
    """Split where the least delay steps, by less than delays scatter. One-way messages cannot tell a clock that leapt
    back from a delay that grew."""
    blocks = len(level) // BLOCK
    if blocks < 2 * SIDE + 1:
        return [(slice(0, len(level)), why)]
    least = level[: blocks * BLOCK].reshape(-1, BLOCK).min(axis=1)
    # A single block that is out of line is an outlier, or late as a whole.
    least = np.median(np.lib.stride_tricks.sliding_window_view(np.pad(least, 1, mode="reflect"), 3), axis=1)
    length = np.diff(gap8[: blocks * BLOCK : BLOCK], append=gap8[blocks * BLOCK - 1])
    # The value at the boundary of straight lines through the blocks before it and behind it.
    at = np.arange(SIDE) + 0.5
    weight = 1 / SIDE - (at - at.mean()) * at.mean() / ((at - at.mean()) ** 2).sum()
    ahead = np.convolve(least, weight[::-1], mode="valid")
    behind = np.convolve(least, weight, mode="valid")
    step = ahead[SIDE:] - behind[: len(behind) - SIDE]
    # Lines do not reach over silence, and a backlog that comes at once is late as a whole.
    spans = np.lib.stride_tricks.sliding_window_view(length, 2 * SIDE)
    usual = float(np.median(length))
    step = np.where((spans.max(axis=1) > 3 * usual) | (spans.min(axis=1) < usual / 3), 0.0, step)
    noise = float(np.median(np.abs(step))) / 0.6745
    size = np.abs(step)
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(size, SIDE), 2 * SIDE + 1).max(axis=1)
    peaks = np.flatnonzero((size == windows) & (size > max(STEP_US, STEP_TICKS * coarse_us, STEP_SIGMAS * noise)))
    found: list[tuple[slice, str]] = []
    since = 0
    for peak in peaks:
        boundary = int(peak) + SIDE
        if bends(least[boundary - SIDE : boundary + SIDE]):
            continue
        place = locate(level, boundary, float(step[peak]))
        found.append((slice(since, place), why))
        leap_ms = -float(step[peak]) / 1000
        less = "longer" if leap_ms < 0 else "less"
        why = f"the STM32's clock leapt by {leap_ms:+.2f} ms, or messages take as much {less}"
        since = place
    found.append((slice(since, len(level)), why))
    return found


def bends(least: Floats) -> bool:
    """A line with a bend in it, wherever that is best, is nearer to these than one with a step."""
    at = np.arange(len(least), dtype=np.float64)

    def left(part: Floats) -> float:
        return float(np.linalg.lstsq(np.stack((np.ones(len(at)), at, part), axis=1), least, rcond=None)[1].sum())

    bend = min(left(np.maximum(at - place, 0)) for place in np.arange(1, len(at) - 2, 0.5))
    return bend <= min(left((at >= place).astype(np.float64)) for place in range(2, len(at) - 1))


def locate(level: Floats, boundary: int, step: float) -> int:
    """The first message behind a step at about that block."""
    before = level[(boundary - SIDE) * BLOCK : (boundary - 2) * BLOCK].min()
    begin, end = (boundary - 2) * BLOCK, min((boundary + 2) * BLOCK, len(level))
    near = level[begin:end]
    if step > 0:
        earlier = np.flatnonzero(near < before + step * 0.7)
        return begin + (int(earlier[-1]) + 1 if len(earlier) else 0)
    later = np.flatnonzero(near < before + step * 0.3)
    return begin + (int(later[0]) if len(later) else 0)
