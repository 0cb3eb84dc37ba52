"""One robot's clock against another's, from gyros that turned as one.

Two robots on one board feel the same turning. The shift, skew, gain and bias that lay one gyro over the other best are
found by Gauss and Newton. What makes it as sharp as noise allows:
- The derivative, which tells a shift from noise, is the mean of both gyros', without what is faster than they turn: its
  noise has then nothing in common with that of their difference, which is compared with it, and is small.
- Samples count only where the derivative stands out of its noise: at impacts, or where the board moves if it is quiet.
- What is left is not white, as the gyros' filters are not. Both sides go through the filter that makes it so.
How sure it is, the events say: each in turn is left out (jackknife). Noise that the model does not know (a board that
bends, stamps that jitter) is in it then. What is the same at all events is not: a sensor that is always late.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .gyro_align import Aligned, align, main_axis
from .gyro_bend import bend_of
from .gyro_filter import as_sampled_every, later_us, sample_us
from .gyro_signal import ORDER, Floats, Mask, Samples, low_pass, prediction, smoothed, whitened
from .jackknife import Spread, left_out

Places = NDArray[np.intp]

ROWS_OF_LOG_MIN = 1000
ROWS_MIN = 100
"""That tell something."""
CELL_US = 50e3
"""Samples are used or not by cells of that."""
SHARE = 0.98
CLEAR = 2.0
"""The signal's power in the derivative, over that of its noise."""
EVENT_US = 1e6
"""Longer ones are cut."""
EVENTS_MIN = 4
"""Fewer say nothing of how sure it is."""
ALIKE_MIN = 0.5
"""Of the variance of one gyro, in the cells used: explained by the other."""
TURNED_DPS_MIN = 10.0
"""About the board's axis, between the extremes: less is next to the noise."""
SIGMA_US_MAX = 1000.0
STEPS_MAX = 12
AWAY = np.array([20e3, 3000.0, 0.9, 100.0])
"""Further from where it begins, us, ppm, gain and deg/s, the fit is lost."""
STEP_US = 0.003
IN_RADIANS = 40.0
"""Of two gyros that should be alike: one that is so much slower, and up to twice that, counts radians."""
SWUNG_DPS_MIN = 100.0
"""The faster one; a board that is rocked that little leaves it open which it is."""
DPS = "Rates must be deg/s, as gyro.x, gyro.y and gyro.z are"
SKEW = np.array([0.0, 1.0, 0.0, 0.0])


@dataclass(frozen=True, slots=True)
class Gyro:
    """One robot's log."""

    time_us: Floats
    """Its own clock; in order, none twice."""
    rate_dps: Floats
    """(rows, 3)."""


@dataclass(frozen=True, slots=True)
class Event:
    """A stretch in which the turning told the shift: an impact, or a second of movement."""

    at_us: float
    """First clock: its middle."""
    weight: float
    """Its part of what is known of the shift."""
    shift_us: float
    """By it alone, less the line through all."""


@dataclass(frozen=True, slots=True)
class Shift:
    """The second clock against the first."""

    shift_us: float
    """Second less first ..."""
    sigma_us: float
    """... with one standard deviation, by jackknife over the events ..."""
    at_us: float
    """... when the first clock says this: where it is known best."""
    skew_ppm: float
    skew_sigma_ppm: float
    bend_ppm: float
    """By so much the skew clearly changes from the middle to a usual event; 0: by nothing that is clear. What that
    makes the line wrong is in all sigmas."""
    start_us: float
    """The same, carried on to 0 of the first clock: where both were, had they begun together."""
    start_sigma_us: float
    gain: float
    """Of the first gyro over the second."""
    bias_dps: float
    noise_dps: float
    """Standard deviation of what is left in the cells used: of both gyros."""
    explained: float
    """Of the first gyro by the second, in the cells used."""
    filter_us: float
    """By so much the second gyro's filters are later than the first's; it is not in the shift."""
    span_s: float
    """Between the first and the last event."""
    events: tuple[Event, ...]
    first: Samples
    """About the board's axis ..."""
    second: Samples
    """... likewise, on its own clock."""

    def at(self, first_us: Floats) -> Floats:
        """What the second clock says when the first says this."""
        return first_us + self.shift_us + self.skew_ppm * 1e-6 * (first_us - self.at_us)


@dataclass(frozen=True, slots=True)
class Refused:
    why: str


def compare(first: Gyro, second: Gyro) -> Shift | Refused:
    rows = [len(each.time_us) for each in (first, second)]
    if min(rows) < ROWS_OF_LOG_MIN:
        return Refused(
            f"{rows[0]} and {rows[1]} rows of the gyros: {ROWS_OF_LOG_MIN} of each are needed, best at 1 kHz"
        )
    one = Samples(first.time_us, main_axis(first.rate_dps))
    other = Samples(second.time_us, main_axis(second.rate_dps))
    turned = [float(np.ptp(np.quantile(each.value, [0.001, 0.999]))) for each in (one, other)]
    if max(turned) > SWUNG_DPS_MIN and max(turned) > IN_RADIANS * min(turned) > 0.5 * max(turned):
        return Refused(
            f"the {('first', 'second')[turned[1] < turned[0]]} turned a 57th of the other: is it in rad/s? {DPS}"
        )
    if min(turned) < TURNED_DPS_MIN:
        return Refused(f"too little rotation: {min(turned):.1f} deg/s from end to end; rock and strike the board")
    found = align(one, other)
    if isinstance(found, str):
        return Refused(found)
    other = Samples(other.time_us, other.value * found.sign)
    one_us, other_us = sample_us(one.time_us), sample_us(other.time_us) / (1 + found.skew)
    return refine(one, as_sampled_every(other, other_us, one_us), found, later_us(other_us, one_us))


def refine(first: Samples, second: Samples, rough: Aligned, filter_us: float) -> Shift | Refused:
    start = np.array([rough.shift_us, rough.skew * 1e6, 1.0, 0.0])
    state = start
    smooth = low_pass(first.step_us)
    near, used = telling(first, second, state, rough.middle_us, smooth)
    if used.sum() < ROWS_MIN:
        return Refused("the gyros hardly turned: nothing stands out of their noise")
    at_us = first.time_us[near]
    since_s = (at_us - rough.middle_us) * 1e-6
    own, own_slope = first.value[near], first.slope(at_us)
    white = np.ones(1)
    for step in range(STEPS_MAX):
        columns, residual, _ = linear(at_us, own, own_slope, second, since_s, state)
        known = np.isfinite(residual) & np.isfinite(columns).all(axis=1)
        columns, residual, used = np.where(known[:, None], columns, 0.0), np.where(known, residual, 0.0), used & known
        if used.sum() < ROWS_MIN or (np.abs(state - start) > AWAY).any():
            return Refused("no shift lays one gyro over the other: were the robots fixed on one board?")
        left, by = whitened(residual[:, None], white)[used, 0], whitened(smoothed(columns, smooth), white)[used]
        change, *_ = np.linalg.lstsq(by, left, rcond=None)
        state = state + change
        if step > 2 and abs(change[0]) < STEP_US:
            break
        white = prediction(residual, used)
    at_us = at_us[used]
    explained = 1 - float(residual[used].var() / own[used].var())
    if explained < ALIKE_MIN:
        return Refused(
            f"one gyro explains {max(explained, 0):.0%} of the other where they turn: were the robots fixed on one"
            " board?"
        )
    number = events_of(at_us)
    if number[-1] + 1 < EVENTS_MIN:
        return Refused(f"{number[-1] + 1} events in which they turned; {EVENTS_MIN} are needed to know the error")
    left = left - by @ change
    fit = left_out(by, left, number)
    if not np.isfinite(fit.spread).all():
        return Refused("they turned in one event only, in effect: strike the board more often")
    events = tuple(each_event(at_us, by, left, number))
    # There the shift's error and the skew's have nothing in common.
    at_s = float(-fit.inverse[0, 1] / fit.inverse[1, 1])
    shift, sigma = carried(state, fit, at_s)
    if sigma > SIGMA_US_MAX:
        return Refused(f"too little rotation: the shift would be sure to ± {sigma / 1000:.1f} ms only")
    bent = bend_of(*(np.array([getattr(each, name) for each in events]) for name in ("at_us", "shift_us", "weight")))
    sigma = float(np.hypot(sigma, bent.at(rough.middle_us + at_s * 1e6)))
    at_zero, at_zero_sigma = carried(state, fit, -rough.middle_us * 1e-6)
    return Shift(
        shift_us=shift,
        sigma_us=sigma,
        at_us=rough.middle_us + at_s * 1e6,
        skew_ppm=float(state[1]),
        skew_sigma_ppm=float(np.hypot(fit.sigma(SKEW), bent.rate_ppm)),
        bend_ppm=bent.rate_ppm,
        start_us=at_zero,
        start_sigma_us=float(np.hypot(at_zero_sigma, bent.at(0.0))),
        gain=float(state[2]),
        bias_dps=float(state[3]),
        noise_dps=float(residual[used].std()),
        explained=explained,
        filter_us=filter_us,
        span_s=float(np.ptp(at_us)) * 1e-6,
        events=events,
        first=first,
        second=second,
    )


def telling(first: Samples, second: Samples, state: Floats, middle_us: float, smooth: Floats) -> tuple[Places, Mask]:
    """Samples in the cells that tell the shift, and those around them that filters need; and which of these are the
    former. Of the cells where the derivative stands out of its noise, the best that have SHARE of what all know."""
    at_us = first.time_us
    columns, _, noise = linear(at_us, first.value, first.slope(at_us), second, (at_us - middle_us) * 1e-6, state)
    known = np.isfinite(noise)
    both = np.where(known[:, None], np.stack([columns[:, 0], noise], axis=1), 0.0)
    cells = ((at_us - at_us[0]) // CELL_US).astype(np.intp)
    count = np.maximum(np.bincount(cells, known), 1)
    power, off = (np.bincount(cells, each**2) / count for each in smoothed(both, smooth).T)
    usual = float(np.median(off[off > 0])) if (off > 0).any() else np.inf
    good = (power > (1 + CLEAR) * usual) & (np.bincount(cells, ~known) == 0)
    told = np.where(good, power - usual, 0.0)
    best = np.argsort(-told)
    share = np.cumsum(told[best])
    good[best[np.searchsorted(share, SHARE * share[-1]) + 1 :]] = False
    chosen = good[cells]
    around = np.convolve(chosen, np.ones(2 * (ORDER + len(smooth) // 2) + 1), "same") > 0.5
    near = np.flatnonzero(around & known)
    return near, chosen[near]


def linear(
    at_us: Floats, own: Floats, own_slope: Floats, second: Samples, since_s: Floats, state: Floats
) -> tuple[Floats, Floats, Floats]:
    """Derivatives by shift (us), skew (ppm), gain and bias; what is left; and the noise of the first derivative."""
    shift, skew, gain, bias = state
    there = at_us + shift + skew * since_s
    other, other_slope = gain * second.at(there), gain * second.slope(there)
    slope, mean = 0.5 * (own_slope + other_slope), 0.5 * (own - bias + other)
    columns = np.stack([slope, slope * since_s, mean / gain, np.ones(len(other))], axis=1)
    # Equal noise in both: as much in half their difference as in their mean.
    return columns, own - other - bias, 0.5 * (own_slope - other_slope)


def events_of(at_us: Floats) -> Places:
    """For each sample the number of its event: they are apart by a cell that is not used, and last EVENT_US at most."""
    run = np.concatenate([[0], np.cumsum(np.diff(at_us) > 1.5 * CELL_US)])
    began = at_us[np.searchsorted(run, run)]
    part = ((at_us - began) // EVENT_US).astype(np.intp)
    return np.concatenate([[0], np.cumsum((np.diff(run) > 0) | (np.diff(part) > 0))])


def carried(state: Floats, fit: Spread, at_s: float) -> tuple[float, float]:
    """The shift so many seconds from the middle, and its standard deviation."""
    by = np.array([1.0, at_s, 0.0, 0.0])
    return float(by @ state), fit.sigma(by)


def each_event(at_us: Floats, by: Floats, left: Floats, number: Places) -> Iterator[Event]:
    starts = np.flatnonzero(np.diff(number, prepend=-1))
    known = np.add.reduceat(by[:, 0] ** 2, starts)
    own = np.add.reduceat(by[:, 0] * left, starts) / known
    middle = np.add.reduceat(by[:, 0] ** 2 * at_us, starts) / known
    weight = known / known.sum()
    for values in zip(middle.tolist(), weight.tolist(), own.tolist(), strict=True):
        yield Event(*values)
