"""Two clocks, and messages from one to the other: what the estimators are tried on. Nothing of it is the kernel's.

T is the STM32's stamp clock, written into 100 messages a second; G is the GAP8's, read when a message has come. T is
the reference here: G runs at 1 + rate(T). A message is late by an exponential delay over a fixed floor (of zero: no
one-way estimate sees the floor), and messages come in order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

STEP_S = 0.01
RTC_US = 1e6 / 32768
OSCILLATORS = ("const100", "typ", "fll5000", "presc85", "rcbad")
SINE_S = 120.0
"""Period of the RC-like clock's 100 ppm: air conditioning."""


def rate_ppm(name: str, seconds: float, random: np.random.Generator) -> Floats:
    """Of G against T, each STEP_S."""
    at_s = np.arange(0, seconds + 1, STEP_S)
    walk = np.cumsum(random.normal(0, 1, len(at_s))) * np.sqrt(STEP_S)
    warm = 1 - np.exp(-at_s / 60)
    if name.startswith("const"):
        return np.full(len(at_s), float(name.removeprefix("const")))
    if name == "typ":
        return -60 - 10 * warm + 0.01 * walk
    if name == "fll5000":
        return 5000 - 100 * warm + 0.1 * walk
    if name == "presc85":
        return 1e6 / 84 - 10 * warm + 0.01 * walk
    if name == "rcbad":
        return -5000 + 500 * warm + 100 * np.sin(2 * np.pi * at_s / SINE_S) + 1 * walk
    raise ValueError(name)


@dataclass(frozen=True)
class Run:
    """What the host has, and beside it the truth."""

    stm32_us: Ints
    gap8_us: Ints
    """Of each message that came, in the order of their coming."""
    frame_gap8_us: Ints
    frame_true_us: Floats
    """T at the end of each frame."""
    sent_us: Floats
    """When each message was sent, on a clock that no fault touches and that T was before any ..."""
    come_us: Floats
    """... when it came ..."""
    frame_us: Floats
    """... and when each frame's end was read."""

    @property
    def frame_after(self) -> Ints:
        """How many messages had come before each frame."""
        return np.searchsorted(self.come_us, self.frame_us)


@dataclass(frozen=True)
class Link:
    """How a run's messages fare."""

    oscillator: str = "typ"
    mu_us: float | Callable[[Floats], Floats] = 500.0
    """Mean delay; or its value at each T in s."""
    seconds: float = 300.0
    loss: float = 0.0
    burst_s: float = 0.0
    """Mean length of bursts of loss; 0: each message by itself."""
    late: float = 0.0
    """Probability of 5 to 50 ms more."""
    gap8_tick_us: float = 1.0
    stm32_tick_us: float = 1.0
    fps: float = 30.0
    rate_step_ppm: float = 0.0
    """In the middle of the run."""
    latency_us: float = 0.0
    """Mean of what passes from the end of a frame to its reading."""
    delay_us: Callable[[Floats], Floats] | None = None
    """Added to each message's, by its T in s: not random."""


def ticked(values: Floats, tick_us: float) -> Ints:
    """As a counter of such ticks reads, in whole us."""
    return np.floor(np.floor(values / tick_us) * tick_us + 1e-6).astype(np.int64)


def run(link: Link, seed: int) -> Run:
    random = np.random.default_rng(seed)
    rates = rate_ppm(link.oscillator, link.seconds, random)
    at_s = np.arange(len(rates)) * STEP_S
    rates = rates + link.rate_step_ppm * (at_s >= link.seconds / 2)
    ahead_us = np.concatenate(([0.0], np.cumsum((rates[1:] + rates[:-1]) / 2 * STEP_S)))
    start_stm32_us, start_gap8_us = random.uniform(1e5, 1e7), random.uniform(1e5, 1e7)

    def gap8_us(true_us: Floats) -> Floats:
        return start_gap8_us + true_us + np.interp(true_us * 1e-6, at_s, ahead_us)

    sent_us = np.arange(0, link.seconds * 1e6, 10_000.0) + random.uniform(0, 10_000)
    mu_us = link.mu_us(sent_us * 1e-6) if callable(link.mu_us) else link.mu_us
    delay_us = random.exponential(1, len(sent_us)) * mu_us
    delay_us += (random.random(len(sent_us)) < link.late) * random.uniform(5e3, 50e3, len(sent_us))
    if link.delay_us:
        delay_us += link.delay_us(sent_us * 1e-6)
    come_us = np.maximum.accumulate(sent_us + delay_us)
    here = ~lost(len(sent_us), link, random)
    frames_us = np.arange(50_000.0, link.seconds * 1e6 - 50_000, 1e6 / link.fps) + random.uniform(0, 1e6 / link.fps)
    frames_us = frames_us[frames_us < link.seconds * 1e6 - 20_000]
    read_us = frames_us + (random.exponential(link.latency_us, len(frames_us)) if link.latency_us else 0)
    return Run(
        stm32_us=ticked(start_stm32_us + sent_us, link.stm32_tick_us)[here],
        gap8_us=ticked(gap8_us(come_us), link.gap8_tick_us)[here],
        frame_gap8_us=ticked(gap8_us(read_us), link.gap8_tick_us),
        frame_true_us=start_stm32_us + frames_us,
        sent_us=sent_us[here],
        come_us=come_us[here],
        frame_us=read_us,
    )


def starved(at_s: Floats) -> Floats:
    """A delay_us: what is sent in the first 40 ms of a second comes at their end."""
    return np.where(at_s % 1 < 0.04, (0.04 - at_s % 1) * 1e6, 0.0)


def lost(count: int, link: Link, random: np.random.Generator) -> NDArray[np.bool_]:
    """Gilbert and Elliott's two states: good, where all comes, and bad, where nothing does."""
    if not link.burst_s:
        return random.random(count) < link.loss
    bad = np.zeros(count, np.bool_)
    at = 0.0
    good_s = link.burst_s * (1 - link.loss) / link.loss
    while at < count:
        at += random.exponential(good_s) * 100
        end = at + random.exponential(link.burst_s) * 100
        bad[int(at) : int(end)] = True
        at = end
    return bad


# Faults: each takes a run and returns another. `at` is a message's number.


def take(run: Run, order: NDArray[np.intp] | NDArray[np.bool_]) -> Run:
    return replace(
        run,
        stm32_us=run.stm32_us[order],
        gap8_us=run.gap8_us[order],
        sent_us=run.sent_us[order],
        come_us=run.come_us[order],
    )


LEAP_BEFORE_US = 5_000
"""The first message that has a leap in it was sent so long after it: half of the time between two."""


def stm32_leap(run: Run, at: int, by_us: int) -> Run:
    """From that message on the STM32's clock is another by so much; so is the truth of the frames from
    LEAP_BEFORE_US before it was sent."""
    from_us = run.sent_us[at] - LEAP_BEFORE_US
    return replace(
        run,
        stm32_us=run.stm32_us + by_us * (np.arange(len(run.stm32_us)) >= at),
        frame_true_us=run.frame_true_us + by_us * (run.frame_us >= from_us),
    )


def stm32_resets(run: Run, at: int, times: int, apart_us: int) -> Run:
    """A broadcast that sets the STM32's clock to 0 just before that message is sent, and is repeated."""
    first_us = run.sent_us[at] - LEAP_BEFORE_US
    last_us = first_us + (times - 1) * apart_us

    def since_us(true_us: Floats, was_us: NDArray[np.float64] | Ints) -> Floats:
        """The clock at that true time, which was another before."""
        set_us = first_us + np.floor((np.clip(true_us, first_us, last_us) - first_us) / apart_us) * apart_us
        return np.where(true_us >= first_us, true_us - set_us, was_us)

    return replace(
        run,
        stm32_us=np.floor(since_us(run.sent_us, run.stm32_us)).astype(np.int64),
        frame_true_us=since_us(run.frame_us, run.frame_true_us),
    )


def silence(run: Run, at: int, seconds: float) -> Run:
    after_us = run.gap8_us - run.gap8_us[at]
    return take(run, ~((after_us >= 0) & (after_us < seconds * 1e6)))


def backlog(run: Run, at: int, seconds: float) -> Run:
    """Nothing for a while, then all of it at once: 1.5 ms each."""
    gap8_us = run.gap8_us.copy()
    held = np.flatnonzero((gap8_us >= gap8_us[at]) & (gap8_us < gap8_us[at] + seconds * 1e6))
    gap8_us[held] = gap8_us[held[-1]] + 1_500 * np.arange(len(held))
    return replace(run, gap8_us=np.maximum.accumulate(gap8_us))


def duplicates(run: Run, share: float, seed: int) -> Run:
    again = np.random.default_rng(seed).random(len(run.stm32_us)) < share
    order = np.sort(np.concatenate((np.arange(len(again)), np.flatnonzero(again))))
    twice = take(run, order)
    late = np.concatenate(([0], (np.diff(order) == 0) * 1_500))
    return replace(twice, gap8_us=np.maximum.accumulate(twice.gap8_us + late))


def swapped(run: Run, share: float, seed: int) -> Run:
    """Pairs of messages whose contents have changed places."""
    first = np.flatnonzero(np.random.default_rng(seed).random(len(run.stm32_us) - 1) < share)
    first = first[np.concatenate(([True], np.diff(first) > 1))]
    stm32_us = run.stm32_us.copy()
    stm32_us[first], stm32_us[first + 1] = run.stm32_us[first + 1], run.stm32_us[first]
    return replace(run, stm32_us=stm32_us)


def glitches(run: Run, at: list[int], by_us: int) -> Run:
    stm32_us = run.stm32_us.copy()
    stm32_us[at] += by_us
    return replace(run, stm32_us=stm32_us)


def damaged(run: Run, share: float, seed: int) -> Run:
    """One bit of the time of some messages is another, and their check did not see it."""
    random = np.random.default_rng(seed)
    hit = np.flatnonzero(random.random(len(run.stm32_us)) < share)
    stm32_us = run.stm32_us.copy()
    stm32_us[hit] ^= np.int64(1) << random.integers(0, 63, len(hit))
    return replace(run, stm32_us=stm32_us)


def stuck(run: Run, at: int, seconds: float) -> Run:
    """The STM32's clock stands still in the messages, and then goes on as if it had not."""
    stm32_us = run.stm32_us.copy()
    held = (run.gap8_us >= run.gap8_us[at]) & (run.gap8_us < run.gap8_us[at] + seconds * 1e6)
    stm32_us[held] = run.stm32_us[at]
    return replace(run, stm32_us=stm32_us)


def gap8_reboot(run: Run, at: int, gap_s: float) -> Run:
    """The GAP8 counts from 0 again; nothing comes meanwhile, frames neither."""
    from_us = int(run.gap8_us[at]) + int(gap_s * 1e6)
    kept = take(run, (run.gap8_us < run.gap8_us[at]) | (run.gap8_us >= from_us))
    frames = (run.frame_gap8_us < run.gap8_us[at]) | (run.frame_gap8_us >= from_us)
    return replace(
        kept,
        gap8_us=kept.gap8_us - from_us * (kept.gap8_us >= from_us),
        frame_gap8_us=(run.frame_gap8_us - from_us * (run.frame_gap8_us >= from_us))[frames],
        frame_true_us=run.frame_true_us[frames],
        frame_us=run.frame_us[frames],
    )
