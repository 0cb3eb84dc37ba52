"""The edge that delays have: nothing comes before it was sent, so the earliest of many messages are nearly on time.

Of n delays, exponential with mean mu, the least is mu / n on average and scatters by as much. A clock of coarse ticks
blurs the edge: then the least is read up to half a tick too early, and the more messages, the more surely so.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..native import ffi, lib

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

MU_PAIRS = 512
"""Messages that share an estimate of the mean delay."""
QUARTILE = -math.log(0.75)
"""Of an exponential delay of mean 1. The lower quartile says how dense the edge is, and nothing of rare long delays."""


@dataclass(frozen=True, slots=True)
class Track:
    """A smooth curve of a clock's offset: value and rate at knots, cubic in between, straight outside."""

    time_s: Floats
    offset_us: Floats
    rate_ppm: Floats
    sigma_us: Floats

    def at(self, time_s: Floats) -> Floats:
        """Offset, us."""
        times = np.ascontiguousarray(time_s, np.float64)
        values = np.empty(len(times))
        knots = (np.ascontiguousarray(each) for each in (self.time_s, self.offset_us, self.rate_ppm))
        of = [ffi.from_buffer("double[]", each) for each in knots]
        given, out = ffi.from_buffer("double[]", times), ffi.from_buffer("double[]", values)
        lib.track_values(len(self.time_s), *of, len(times), given, out)
        return values

    def sigma_at(self, time_s: Floats) -> Floats:
        return np.asarray(np.interp(time_s, self.time_s, self.sigma_us), np.float64)


def track(time_s: Floats, value_us: Floats, sigma_us: Floats, wander: float) -> Track:
    """Through readings that scatter by sigma; `wander` is the growth of the rate's variance, ppm^2/s."""
    time_s, value_us = np.ascontiguousarray(time_s), np.ascontiguousarray(value_us)
    variance = np.ascontiguousarray(sigma_us**2)
    work = np.empty(len(time_s) * lib.TRACK_WORK)
    offset, rate, offset_variance = (np.empty(len(time_s)) for _ in range(3))
    of = [ffi.from_buffer("double[]", each) for each in (time_s, value_us, variance)]
    out = [ffi.from_buffer("double[]", each) for each in (work, offset, rate, offset_variance)]
    lib.track_smooth(len(time_s), *of, wander, RATE_PPM**2, *out)
    return Track(time_s, offset, rate, np.sqrt(np.maximum(offset_variance, 0)))


RATE_PPM = 30_000.0
"""No two of these clocks differ by more."""


def edge(mu_us: Floats, count: Floats, tick_us: float) -> tuple[Floats, Floats]:
    """Mean and scatter of the least of `count` delays, less the delay itself, on a clock of such ticks (its readings
    taken for the middle of a tick, phases all alike)."""
    # The density of delay and tick together rises linearly over a tick: the survival of the least in closed form.
    crowd = np.clip(count * tick_us / mu_us, 1e-9, 1e9)
    root = np.sqrt(math.pi / (2 * crowd)) * _erf(np.sqrt(crowd / 2))
    tail = np.exp(-crowd / 2)
    mean = root + tail / crowd
    square = 2 / crowd * (1 - tail) + 2 * tail * (1 / crowd + 1 / crowd**2)
    return (mean - 0.5) * tick_us, np.sqrt(np.maximum(square - mean**2, 0)) * tick_us


_ERF_AT = np.linspace(0, 4, 401)
_ERF = np.array([math.erf(each) for each in _ERF_AT])


def _erf(x: Floats) -> Floats:
    return np.asarray(np.interp(x, _ERF_AT, _ERF), np.float64)


FINE_US = 2.0
"""Ticks up to here are finer than any delay's scatter."""


@dataclass(frozen=True, slots=True)
class Blocks:
    """The least delay of each block of time."""

    time_s: Floats
    value_us: Floats
    count: Floats
    phased: Floats
    """How much alike the phases of the messages are against the ticks: 0 all phases, 1 always the same."""


def block_minima(time_s: Floats, delay_us: Floats, length_s: float, phase: Floats | None) -> Blocks:
    """At the time of the message that has it. Empty blocks are left out."""
    number = np.floor(time_s / length_s)
    begin = np.flatnonzero(np.concatenate(([True], number[1:] != number[:-1])))
    least = np.minimum.reduceat(delay_us, begin)
    count = np.diff(np.append(begin, len(time_s)))
    at = np.flatnonzero(delay_us == np.repeat(least, count))
    block = np.searchsorted(begin, at, side="right") - 1
    first = at[np.concatenate(([True], block[1:] != block[:-1]))]
    phased = np.zeros(len(begin))
    if phase is not None:
        phased = np.abs(np.add.reduceat(np.exp(2j * np.pi * phase), begin)) / count
    return Blocks(time_s[first], least, count.astype(np.float64), phased)


COARSE_US = 100.0
"""In longer ticks the edge is not seen: the mean is, if delays spread the messages over them."""
LATE_MEANS = 8.0
"""Few messages this late are left out of means."""
MU_COARSE_PAIRS = 4096
EDGE_PAIRS = (256, 4096)
"""Messages whose least is held against the curve of means: few show a curve that swings, many sweep over ticks."""
UNEVEN = 0.1
"""What delays do not even out, in ticks."""


def block_means(time_s: Floats, delay_us: Floats, length_s: float, phase: Floats) -> Blocks:
    """As block_minima, of coarse ticks."""
    number = np.floor(time_s / length_s)
    begin = np.flatnonzero(np.concatenate(([True], number[1:] != number[:-1])))
    count = np.diff(np.append(begin, len(time_s)))
    when, value = (np.add.reduceat(each, begin) / count for each in (time_s, delay_us))
    phased = np.abs(np.add.reduceat(np.exp(2j * np.pi * phase), begin)) / count
    return Blocks(when, value, count.astype(np.float64), phased)


def mean_noise(blocks: Blocks, mu_us: Floats, tick_us: float) -> Floats:
    """Scatter of the mean of each block's readings."""
    uneven = tick_us * np.hypot(UNEVEN, blocks.phased / math.sqrt(12))
    return np.hypot(np.sqrt((mu_us**2 + tick_us**2 / 12) / blocks.count), uneven)


def spread_delay(time_s: Floats, delay_us: Floats, tick_us: float) -> tuple[Floats, Floats]:
    """As mean_delay, of coarse ticks: their share of the scatter is known, and exponential delays are as long on
    average as they scatter."""
    chunk = min(MU_COARSE_PAIRS, len(delay_us))
    whole = len(delay_us) // chunk * chunk
    variance = delay_us[:whole].reshape(-1, chunk).var(axis=1)
    mu = np.sqrt(np.maximum(variance - tick_us**2 / 12, 0))
    return time_s[:whole].reshape(-1, chunk).mean(axis=1), np.maximum(mu, 1.0)


def off_edge(
    time_s: Floats, delay_us: Floats, mu_us: Floats, tick_us: float, phase: Floats | None, at_s: Floats
) -> Floats:
    """How far the edge lies from where exponential delays of such mean have it. Delays that are not exponential have
    another mean than spread_delay says; nothing else tells of it."""
    every_s = float(time_s[-1] - time_s[0]) / len(time_s)
    most = np.zeros(len(at_s))
    for pairs in EDGE_PAIRS:
        blocks = block_minima(time_s, delay_us, max(pairs * every_s, 1e-3), phase)
        late, _ = edge(np.interp(blocks.time_s, time_s, mu_us), blocks.count, tick_us)
        off = np.abs(blocks.value_us - late * (1 - blocks.phased))
        most = np.maximum(most, np.interp(at_s, blocks.time_s, off))
    return most


def mean_delay(time_s: Floats, delay_us: Floats, tick_us: float) -> tuple[Floats, Floats]:
    """(when, mu) along the run, from delays over the edge."""
    chunk = min(MU_PAIRS, len(delay_us))
    whole = len(delay_us) // chunk * chunk
    table = delay_us[:whole].reshape(-1, chunk)
    lower = np.partition(table, chunk // 4, axis=1)[:, chunk // 4]
    mu = lower / QUARTILE
    if tick_us > FINE_US:
        # A quartile of delay and tick together is no longer the delay's.
        ordered = np.partition(table, (chunk // 4, chunk // 2), axis=1)
        spread = (ordered[:, chunk // 2] - ordered[:, chunk // 4]) / (math.log(2) - QUARTILE)
        mu = np.sqrt(np.maximum(spread**2 - tick_us**2 / 12, 0))
    when = time_s[:whole].reshape(-1, chunk).mean(axis=1)
    return when, np.maximum(mu, max(1.0, tick_us / 20))
