"""Two gyros' logs laid over each other roughly, whatever the clocks say: which axis, which shift, which rate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .gyro_signal import Floats, Samples
from .ticks import SLOW

BIN_US = 4000.0
"""Rates are averaged over so much for the search."""
PIECE_US = 10e6
"""That is searched for in the other log."""
RATES = (1.0, SLOW, 1 / SLOW)
"""Of one clock against another, either of which may be slow."""
ALIKE_MIN = 0.5
"""Correlation."""
TWICE = 0.97
"""A second shift that fits so well, against the best, leaves it open which is right."""
APART_US = 300e3
"""Shifts that are apart: a board does not swing faster."""
AROUND_US = 60e3
"""Where the next piece is looked for, besides what the rate may be off by."""
RATE_OFF = 1e-3


@dataclass(frozen=True, slots=True)
class Aligned:
    """Second clock = at + shift + skew * (at - middle), at: first clock."""

    shift_us: float
    skew: float
    middle_us: float
    sign: float
    """-1: the second gyro's axis points the other way."""
    correlation: float


def main_axis(rate: Floats) -> Floats:
    """Along the axis about which a gyro (n, 3) turned most."""
    centred = rate - np.median(rate, axis=0)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    return np.asarray(centred @ vectors[:, -1])


def binned(samples: Samples, rate: float = 1.0) -> tuple[float, Floats]:
    """Start, and means over BIN_US of a clock that runs at that rate; where there is no sample, as before."""
    time = samples.time_us * rate
    place = ((time - time[0]) // BIN_US).astype(np.intp)
    count = np.bincount(place)
    total = np.bincount(place, samples.value)
    known = np.flatnonzero(count)
    mean = np.interp(np.arange(len(count)), known, total[known] / count[known])
    return float(time[0]), mean


def align(first: Samples, second: Samples) -> Aligned | str:
    """Or why not. By the rates; if an even swing leaves it open which is right, by how they change: by the impacts."""
    found = search(first, second, changes=False)
    if found.correlation < ALIKE_MIN:
        return f"the robots did not turn alike (correlation {found.correlation:.2f}): were they fixed on one board?"
    if found.rival > TWICE * found.correlation:
        found = search(first, second, changes=True)
    if found.rival > TWICE * found.correlation:
        return "another shift fits as well: the board only swung evenly; strike it at uneven times"
    return followed(first, second, found)


@dataclass(frozen=True, slots=True)
class Found:
    correlation: float
    rival: float
    """The correlation of the best shift that is apart."""
    rate: float
    """The second clock's, of RATES, to be multiplied with."""
    sign: float
    piece_us: float
    """Where the piece begins, first clock; and second, times the rate."""
    found_us: float


def search(first: Samples, second: Samples, changes: bool) -> Found:
    """The liveliest piece of the first in all of the second."""
    begin, here = binned(first)
    here = np.diff(here) if changes else here
    best = Found(-1, 0, 1, 1, 0, 0)
    for rate in RATES:
        other_begin, there = binned(second, rate)
        there = np.diff(there) if changes else there
        size = min(int(PIECE_US / BIN_US), len(here), len(there))
        place = liveliest(here, size)
        alike = correlations(here[place : place + size], there)
        at = int(np.argmax(np.abs(alike)))
        if abs(alike[at]) > best.correlation:
            apart = np.abs(np.arange(len(alike)) - at) * BIN_US > APART_US
            best = Found(
                correlation=float(abs(alike[at])),
                rival=float(np.abs(alike[apart]).max()) if apart.any() else 0.0,
                rate=rate,
                sign=float(np.sign(alike[at])),
                piece_us=begin + place * BIN_US,
                found_us=other_begin + at * BIN_US,
            )
    return best


def liveliest(values: Floats, size: int) -> int:
    """Where the piece of that size begins that changes most."""
    change = np.concatenate([[0.0], np.cumsum(np.diff(values, prepend=values[:1]) ** 2)])
    return int(np.argmax(change[size:] - change[:-size]))


def correlations(piece: Floats, whole: Floats) -> Floats:
    """With each part of `whole` of the piece's size, -1 to 1."""
    size, room = len(piece), 1 << int(len(piece) + len(whole)).bit_length()
    centred = piece - piece.mean()
    product = np.fft.irfft(np.fft.rfft(whole, room) * np.conj(np.fft.rfft(centred, room)), room)
    product = product[: len(whole) - size + 1]
    total = np.concatenate([[0.0], np.cumsum(whole)])
    squares = np.concatenate([[0.0], np.cumsum(whole**2)])
    spread = squares[size:] - squares[:-size] - (total[size:] - total[:-size]) ** 2 / size
    scale = np.sqrt(np.maximum(spread, 1e-9 * max(float(squares[-1]), 1e-300)) * max(float(centred @ centred), 1e-300))
    return np.asarray(product / scale)


def followed(first: Samples, second: Samples, found: Found) -> Aligned:
    """From the piece that was found to the others, nearest first: a line through the shifts of all."""
    rate, sign, piece_us = found.rate, found.sign, found.piece_us
    begin, here = binned(first)
    other_begin, there = binned(second, rate)
    size = min(int(PIECE_US / BIN_US), len(here), len(there))
    starts = np.arange(0, len(here) - size + 1, max(size // 4, 1))
    at_us = begin + starts * BIN_US
    known_us, known_shift = [piece_us], [found.found_us - piece_us]
    for start, at in sorted(
        zip(starts.tolist(), at_us.tolist(), strict=True), key=lambda each: abs(each[1] - piece_us)
    ):
        nearest = int(np.argmin(np.abs(np.array(known_us) - at)))
        expected = at + known_shift[nearest] - other_begin
        reach = AROUND_US + RATE_OFF * abs(at - known_us[nearest])
        low = max(int((expected - reach) / BIN_US), 0)
        high = min(int((expected + reach) / BIN_US) + 1 + size, len(there))
        if high - low <= size + 2:
            continue
        alike = correlations(here[start : start + size], there[low:high]) * sign
        top = int(np.argmax(alike))
        if alike[top] < ALIKE_MIN or not 0 < top < len(alike) - 1:
            continue
        before, peak, behind = alike[top - 1 : top + 2]
        part = 0.5 * (before - behind) / min(before - 2 * peak + behind, -1e-12)
        known_us.append(at)
        known_shift.append(other_begin + (low + top + part) * BIN_US - at)
    times = np.array(known_us[1:] or known_us) + size * BIN_US / 2
    shifts = np.array(known_shift[1:] or known_shift)
    middle = float(times.mean())
    slope = float(np.polyfit(times - middle, shifts, 1)[0]) if np.ptp(times) > 0 else 0.0
    # Back from the clock that runs at `rate` to the second's own.
    shift = float(np.median(shifts - slope * (times - middle)))
    return Aligned((middle + shift) / rate - middle, (1 + slope) / rate - 1, middle, sign, found.correlation)
