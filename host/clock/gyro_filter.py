"""A Crazyflie's filters of its gyro: how late they are, and what a log tells of the motion before them.

The BMI088 has one of 116 Hz, ahead of its samples; the firmware another of 80 Hz, Butterworth's of two poles at 1 kHz.
Of the sensor's the data sheet gives the bandwidth only. Bosch's support works out its noise as 0.014 deg/s times the
root of 1.22 times the bandwidth, "where 1.22 is the coefficient of internal low pass filter" (November 2020,
community.bosch-sensortec.com, "Why the power spectral density (PSD) of BMI088 Gyro(x/y/z) have strange peak point?").
That is what two equal poles let through; one would be 1.57, Butterworth's two 1.11, three equal ones 1.16. So it is
taken for two equal ones.

Filters count samples, and those come from the gyro's own oscillator: one that samples 0.1 % slower is 0.1 % later, of
5 ms; on a clock that counts 84 where 85 have passed it is 1.2 % less late. Rows follow the samples (synchronous
logging), so their rate tells both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .gyro_signal import Floats, Samples

NOMINAL_US = 1000.0
SENSOR_HZ, FIRMWARE_HZ = 116.0, 80.0
POLE_HZ: float = SENSOR_HZ / (2**0.5 - 1) ** 0.5
"""Each of two that are 3 dB down together at SENSOR_HZ."""
FIRMWARE_TAN = float(np.tan(np.pi * FIRMWARE_HZ * NOMINAL_US * 1e-6))
SENSOR_LAG_US: float = 2e6 / (2 * np.pi * POLE_HZ)
LAG_US: float = SENSOR_LAG_US + NOMINAL_US * 0.5**0.5 / FIRMWARE_TAN
"""Of slow motion, by both, at the nominal rate."""
LAG_LESS_US: float = SENSOR_LAG_US - 1e6 / (2 * np.pi * SENSOR_HZ)
LAG_MORE_US: float = 3e6 * (2 ** (1 / 3) - 1) ** 0.5 / (2 * np.pi * SENSOR_HZ) - SENSOR_LAG_US
"""By so much it would be less had the sensor one pole, more had it three: what is not known of it (how it counts
samples inside, and that 523 Hz are all that comes to its filter) is as much."""
TRUSTED_HZ = 300.0
"""Above, the filters let nothing through that could be set right."""
FAR = 0.01
"""Rates that are so far apart are not those of two such gyros."""
OFF = 0.05
"""Rows that are so far from every so many samples say nothing of the samples."""
HOLE = 1.5
EDGE_S = 0.5
NOISE = 0.01
"""Of the filters' power: where they let less through, their inverse would bring up more noise than signal."""


def sample_us(time_us: Floats) -> float:
    """Between the gyro's samples, on the log's clock, by its rows."""
    steps = np.diff(time_us)
    row_us = float(steps[steps < HOLE * np.median(steps)].mean())
    own_us = row_us / max(round(row_us / NOMINAL_US), 1)
    return own_us if abs(own_us / NOMINAL_US - 1) < OFF else NOMINAL_US


def late_us(own_us: float) -> float:
    """Of slow motion, for a gyro that samples every `own_us`."""
    return LAG_US * own_us / NOMINAL_US


def later_us(own_us: float, wanted_us: float) -> float:
    """By so much a slow movement is later for a gyro that samples every `own_us`."""
    return 0.0 if far(own_us, wanted_us) else late_us(own_us) - late_us(wanted_us)


def far(own_us: float, wanted_us: float) -> bool:
    return abs(wanted_us / own_us - 1) > FAR


def as_sampled_every(samples: Samples, own_us: float, wanted_us: float) -> Samples:
    """What the filters would have given had the gyro, which samples every `own_us`, done so every `wanted_us`; both on
    the same clock."""
    if far(own_us, wanted_us):
        return samples
    time_us, value = samples.time_us, samples.value.copy()
    steps = np.diff(time_us)
    ends = np.flatnonzero(np.diff(time_us) > HOLE * np.median(steps)) + 1
    for part in np.split(np.arange(len(value)), ends):
        room = 1 << (len(part) + 256).bit_length()
        spectrum = np.fft.rfft(np.pad(value[part], (0, room - len(part)), "edge"))
        row_us = sample_us(time_us) if len(part) < 2 else float(np.ptp(time_us[part])) / (len(part) - 1)
        hz: Floats = np.fft.rfftfreq(room, row_us * 1e-6).astype(np.float64)
        wanted, own = (response(np.minimum(hz * each / NOMINAL_US, TRUSTED_HZ)) for each in (wanted_us, own_us))
        value[part] = np.fft.irfft(spectrum * wanted / own, room)[: len(part)]
    return Samples(time_us, value)


def as_exposed(time_s: Floats, rate_rad_s: Floats, own_us: float | None, exposure_s: float) -> Floats:
    """The rates as they were before the filters of a gyro that samples every `own_us` (None: they went through none),
    as far as noise allows; then averaged over an exposure. What they turn a body by until the middle of an exposure is
    then what a picture shows of it: the mean of the whole."""
    step_s = min(float(np.median(np.diff(time_s))), NOMINAL_US * 1e-6)
    even = np.arange(time_s[0] - EDGE_S, time_s[-1] + EDGE_S, step_s)
    hz: Floats = np.fft.rfftfreq(len(even), step_s).astype(np.float64)
    back = np.sinc(hz * exposure_s).astype(np.complex128)
    if own_us is not None:
        through = response(np.minimum(hz * own_us, 0.49e6) / NOMINAL_US)
        back *= through.conj() / (np.abs(through) ** 2 + NOISE) * (1 + NOISE)
    columns = []
    for rate in rate_rad_s.T:
        spectrum = np.fft.rfft(np.interp(even, time_s, rate))
        columns.append(np.interp(time_s, even, np.fft.irfft(spectrum * back, len(even))))
    return np.stack(columns, axis=1)


def response(hz: Floats) -> NDArray[np.complex128]:
    """Of both filters at the nominal rate, below half of it."""
    firmware = 1j * np.tan(np.pi * hz * NOMINAL_US * 1e-6) / FIRMWARE_TAN
    return np.asarray(1 / ((1 + 1j * hz / POLE_HZ) ** 2 * (1 + np.sqrt(2) * firmware + firmware**2)))
