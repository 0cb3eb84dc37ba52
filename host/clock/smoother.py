"""The offset between two clocks along a whole recording, from all its messages, and how well it is known.

Passes over ever longer blocks: each takes the least delay of each block, measured from the curve of the pass before,
and draws a smooth curve through them. Longer blocks have a sharper edge, and ask for a steadier clock. Which length a
clock bears, it says itself, place by place: a longer block is believed as long as its curve agrees with those of all
shorter ones (Lepski's rule). Cost: O(n).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .envelope import (
    COARSE_US,
    FINE_US,
    LATE_MEANS,
    Blocks,
    Floats,
    Track,
    block_means,
    block_minima,
    edge,
    mean_delay,
    mean_noise,
    off_edge,
    spread_delay,
    track,
)

BLOCK_PAIRS = 25
"""In the shortest blocks."""
LEVELS_MAX = 10
STIFFNESS = 1.5
"""The curve of a pass bends within so many blocks."""
AGREES = 4.0
"""A longer block agrees with a shorter one: the square of their distance in sigmas of the shorter one is about 1 on
average, when both err by chance alone, over so many ..."""
AGREES_HERE = 30.0
SHARED = 4.0
"""Blocks that a value of a curve is the mean of, about."""
NEIGHBOURS = 50
OUTLIER = 6.0
MISFIT = 1.7
NEAR = 4
"""Blocks."""
KINK_SIDE = 16
KINK_SIGMAS = 4.0
"""A step of the rate is seen by so many blocks on either side."""
KINK_PPM_MAX = 5000.0
"""More is no clock: messages that came late, many at once."""
KINK = 1.2
"""Block lengths."""
NOTHING_US = 1e5
"""Sigma of a reading that says nothing."""
END_S = 1e-3
COVERED = 3.4
"""Sigmas of the declared bound, of 99 %, where the curve's noise is all there is."""
BIAS = 0.7
"""Of what Lepski's rule lets pass, as part of the bound; and of what it does not, by the first blocks that are too
long: where the rate steps a curve is off in proportion to its blocks, as it is from that of twice the length ..."""
BEND_SIGMAS = 4.0
"""... if that is no chance."""


@dataclass(frozen=True, slots=True)
class Smoothed:
    """The offset of one epoch: clock of arrival less clock of sending, for a message without delay."""

    track: Track
    bound_us: Floats
    """At the track's knots, 99 %: of the curve alone, without the clocks' ticks."""
    block_s: Floats
    """At the knots: which blocks were believed."""
    mu_time_s: Floats
    mu_us: Floats
    """Mean delay over the least, along the run."""
    kept: NDArray[np.intp]
    """Messages that are not impossibly early."""


def smooth(
    time_s: Floats,
    offset_us: Floats,
    tick_us: float,
    block_s_max: float = math.inf,
    coarse_mu_us: float | None = None,
) -> Smoothed:
    """`offset_us`: arrival less sending of each message, `time_s` not decreasing. At least BLOCK_PAIRS of them.
    `block_s_max`: longer blocks are not tried, however steady the clock seems; the shortest always are.
    `coarse_mu_us`: the mean delay, where it is known and small against a coarse tick."""
    kept = np.arange(len(time_s))
    curve = seed(time_s, offset_us)
    delay_us = offset_us - curve.at(time_s)
    spread = max(float(np.median(delay_us) - np.quantile(delay_us, 0.2)) / (math.log(2) + math.log(0.8)), 1.0)
    early = delay_us < -(math.log(2) + 3.5) * spread - tick_us - 20
    kept = kept[~early]
    block_s = BLOCK_PAIRS * float(time_s[-1] - time_s[0]) / max(len(time_s) - 1, 1)
    block_s = max(block_s, BLOCK_PAIRS * float(np.median(np.diff(time_s[:: max(1, len(time_s) // 100_000)]))), 1e-3)
    used = kept
    if tick_us > COARSE_US:
        used = kept[delay_us[kept] < LATE_MEANS * max(spread, tick_us / 2) + tick_us]
    time_s, offset_us = time_s[used], offset_us[used]
    phase = ticks_phase(time_s, offset_us, curve, tick_us)
    # Twice at the finest, for the seed runs through the middle of the delays, not along their edge.
    delay_us = offset_us - curve.at(time_s)
    blocks = gathered(time_s, delay_us, block_s, phase, tick_us)
    curve = through(curve, blocks, edge_noise(blocks, np.full(len(blocks.count), spread), tick_us), block_s)
    delay_us = offset_us - curve.at(time_s)
    if tick_us > COARSE_US:
        mu_time_s, mu_us = spread_delay(time_s, delay_us, tick_us)
        mu_us = mu_us if coarse_mu_us is None else np.full(len(mu_us), coarse_mu_us)
    else:
        mu_time_s, mu_us = mean_delay(time_s, delay_us, tick_us)

    grid = curve.time_s
    chosen: Track = curve
    sigma = curve.sigma_us
    block = np.full(len(grid), block_s)
    values: list[Floats] = []
    sigmas: list[Floats] = []
    valid = np.ones(len(grid), np.bool_)
    bias = np.zeros(len(grid))
    bend = np.zeros(len(grid))
    for level in range(LEVELS_MAX):
        length_s = block_s * 2**level
        if level and (length_s > min((time_s[-1] - time_s[0]) / 6, block_s_max) or not valid.any()):
            break
        delay_us = offset_us - chosen.at(time_s)
        blocks = gathered(time_s, delay_us, length_s, phase, tick_us)
        mu = np.interp(blocks.time_s, mu_time_s, mu_us)
        made = through(chosen, blocks, edge_noise(blocks, mu, tick_us), length_s)
        value, rate, scatter = made.at(grid), slope(made, grid), made.sigma_at(grid)
        before = valid.copy()
        for below, (other, noise) in enumerate(zip(values, sigmas, strict=True)):
            away = deviance((other - value) / np.maximum(noise, 1e-9))
            mean, sigma = around(away, 2**below)
            valid &= (mean <= 1 + AGREES * sigma) & (away < AGREES_HERE)
        if level == 0:
            late, noise = edge_noise(blocks, mu, tick_us)
            finest = blocks.time_s, blocks.value_us - late + chosen.at(blocks.time_s), noise
            chosen = Track(grid, value, rate, scatter)
            sigma = scatter
        else:
            bias = np.where(valid, np.abs(value - values[-1]), bias)
            off = np.abs(value - chosen.offset_us)
            bend = np.where(before & ~valid & (off > BEND_SIGMAS * chosen.sigma_us), off, bend)
            chosen = Track(
                grid,
                np.where(valid, value, chosen.offset_us),
                np.where(valid, rate, chosen.rate_ppm),
                np.where(valid, scatter, chosen.sigma_us),
            )
            sigma = chosen.sigma_us
            block = np.where(valid, length_s, block)
        values.append(value)
        sigmas.append(scatter)
    bound = COVERED * sigma + BIAS * np.maximum(bias, bend) + misfit(*finest, chosen)
    bound += kinks(*finest, grid, block, block_s)
    if tick_us > COARSE_US and coarse_mu_us is None:
        mu = np.interp(time_s, mu_time_s, mu_us)
        bound += off_edge(time_s, offset_us - chosen.at(time_s), mu, tick_us, phase, grid)
    return Smoothed(chosen, bound, block, mu_time_s, mu_us, kept)


def seed(time_s: Floats, offset_us: Floats) -> Track:
    """Through medians of neighbours: robust, and blind to where the edge is."""
    chunk = BLOCK_PAIRS
    whole = len(time_s) // chunk * chunk
    middle = np.median(offset_us[:whole].reshape(-1, chunk), axis=1)
    when = time_s[:whole].reshape(-1, chunk).mean(axis=1)
    apart = np.concatenate(([True], np.diff(when) > 0))
    when, middle = when[apart], middle[apart]
    if len(when) == 1:
        return Track(when, middle, np.zeros(1), np.zeros(1))
    rates = np.diff(middle) / np.diff(when)
    rough = np.abs(rates - np.median(rates)) * np.diff(when)
    noise = max(float(np.median(rough)), 1.0)
    step = float(np.median(np.diff(when)))
    return robust(when, middle, np.full(len(when), noise), noise**2 * step / (3 * step) ** 4)


def edge_noise(blocks: Blocks, mu_us: Floats, tick_us: float) -> tuple[Floats, Floats]:
    """Mean and scatter of the blocks' least delays, or of their means."""
    if tick_us > COARSE_US:
        return mu_us, mean_noise(blocks, mu_us, tick_us)
    bias, sigma = edge(mu_us, blocks.count, tick_us)
    return bias * (1 - blocks.phased), np.hypot(sigma, blocks.phased * tick_us / math.sqrt(12))


def through(curve: Track, blocks: Blocks, noise: tuple[Floats, Floats], length_s: float) -> Track:
    """A smooth curve through the blocks' edges."""
    bias, sigma = noise
    value = curve.at(blocks.time_s) + blocks.value_us - bias
    typical = float(np.median(sigma))
    # The ends, of which nothing is known but that the curve goes on to them.
    ends = (
        min(float(curve.time_s[0]), blocks.time_s[0] - END_S),
        max(float(curve.time_s[-1]), blocks.time_s[-1] + END_S),
    )
    time_s = np.concatenate((ends[:1], blocks.time_s, ends[1:]))
    value = np.concatenate((value[:1], value, value[-1:]))
    sigma = np.concatenate(([NOTHING_US], sigma, [NOTHING_US]))
    return robust(time_s, value, sigma, typical**2 * length_s / (STIFFNESS * length_s) ** 4)


def robust(time_s: Floats, value_us: Floats, sigma_us: Floats, wander: float) -> Track:
    """Twice: the second time without what the first has shown to lie far off."""
    first = track(time_s, value_us, sigma_us, wander)
    far = np.abs(value_us - first.offset_us) > OUTLIER * sigma_us
    if not far.any() or far.mean() > 0.5:
        return first
    sigma = np.where(far, sigma_us + np.abs(value_us - first.offset_us), sigma_us)
    return track(time_s, value_us, sigma, wander)


def gathered(time_s: Floats, delay_us: Floats, length_s: float, phase: Floats | None, tick_us: float) -> Blocks:
    if phase is not None and tick_us > COARSE_US:
        return block_means(time_s, delay_us, length_s, phase)
    return block_minima(time_s, delay_us, length_s, phase)


def ticks_phase(time_s: Floats, offset_us: Floats, curve: Track, tick_us: float) -> Floats | None:
    """Where between two ticks each message would have come without delay, in ticks; None for a fine clock."""
    if tick_us <= FINE_US:
        return None
    sent_us = time_s * 1e6 - offset_us
    return (sent_us + curve.at(time_s)) / tick_us


def misfit(time_s: Floats, value_us: Floats, sigma_us: Floats, curve: Track) -> Floats:
    """At the curve's knots: how far messages nearby came earlier than it allows, or later in blocks on end. Only
    this shows a clock that changed faster than the shortest blocks can follow."""
    off = value_us - curve.at(time_s)
    early = np.where(-off > OUTLIER * sigma_us, -off, 0.0)
    late = np.where(off > OUTLIER * sigma_us, off, 0.0)
    late[1:-1] = np.median(np.lib.stride_tricks.sliding_window_view(late, 3), axis=1) if len(late) > 2 else 0.0
    if not (early.any() or late.any()):
        return np.zeros(len(curve.time_s))
    worst = np.lib.stride_tricks.sliding_window_view(np.pad(np.maximum(2 * early, late), NEAR), 2 * NEAR + 1).max(
        axis=1
    )
    near: Floats = MISFIT * np.interp(curve.time_s, time_s, worst)
    return near


def kinks(time_s: Floats, value_us: Floats, sigma_us: Floats, at_s: Floats, block_s: Floats, least_s: float) -> Floats:
    """How far off a curve of such blocks is where the rate steps nearby by more than noise explains: it cannot bend so
    fast. `least_s`: the shortest blocks, whose readings these are."""
    if len(time_s) < 2 * KINK_SIDE + 1:
        return np.zeros(len(at_s))
    times, values, noise = (np.lib.stride_tricks.sliding_window_view(each, KINK_SIDE) for each in
                            (time_s, value_us, sigma_us))  # fmt: skip
    apart_s = times - times.mean(axis=1, keepdims=True)
    square = (apart_s**2).sum(axis=1)
    rate = (apart_s * values).sum(axis=1) / square
    variance = (noise**2).mean(axis=1) / square
    step = np.abs(rate[KINK_SIDE + 1 :] - rate[: -KINK_SIDE - 1])
    sure = step > KINK_SIGMAS * np.sqrt(variance[KINK_SIDE + 1 :] + variance[: -KINK_SIDE - 1])
    here = np.pad(np.where(sure & (step < KINK_PPM_MAX), step, 0.0), KINK_SIDE)
    near = np.lib.stride_tricks.sliding_window_view(np.pad(here, NEAR), 2 * NEAR + 1).max(axis=1)
    return KINK * np.asarray(np.interp(at_s, time_s, near), np.float64) * np.minimum(block_s, KINK_SIDE * least_s)


def deviance(away: Floats) -> Floats:
    """About the square of what many blocks' mean is off, in sigmas, but for a mean of waiting times: that is easily too
    great, and hardly ever too small."""
    ratio = np.maximum(1 + away / math.sqrt(SHARED), 0.03)
    return 2 * SHARED * (ratio - 1 - np.log(ratio))


def around(values: Floats, step: int) -> tuple[Floats, Floats]:
    """Means over NEIGHBOURS * step values to either side, fewer at the ends; and their scatter if it is chance, where
    values are alike within a curve's reach."""
    reach = NEIGHBOURS * step
    total = np.concatenate(([0.0], np.cumsum(values)))
    at = np.arange(len(values))
    begin, end = np.maximum(at - reach, 0), np.minimum(at + reach + 1, len(values))
    alike = 4 * step
    return (total[end] - total[begin]) / (end - begin), np.sqrt(2 * alike / (end - begin))


def slope(curve: Track, time_s: Floats) -> Floats:
    return np.interp(time_s, curve.time_s, curve.rate_ppm)
