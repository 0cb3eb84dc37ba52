"""Gyros' own filters, as far as they differ.

A gyro's filter counts its samples, and those come from its own oscillator: a gyro that samples 0.1 % slower is 0.1 %
later, of 5 ms. Rows follow the samples (synchronous logging), so their rate tells. Here one gyro's samples are made
what they would have been had it run at the other's rate. BMI088 in a Crazyflie: 116 Hz in the sensor (two poles:
assumed, the data sheet gives the bandwidth only) and two poles of 80 Hz in the firmware, all at 1 kHz.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .gyro_signal import Floats, Samples
from .turning import lag_s

NOMINAL_US = 1000.0
SENSOR_HZ, FIRMWARE_HZ = 116.0, 80.0
TRUSTED_HZ = 300.0
"""Above, the filters let nothing through that could be set right."""
FAR = 0.01
"""Rates that are so far apart are not those of two such gyros."""
DELAY_US = 1e6 * (2**0.5 / (2 * np.pi * SENSOR_HZ) + lag_s((FIRMWARE_HZ,)))
"""Of slow movements."""
HOLE = 1.5


def sample_us(samples: Samples) -> float:
    """Between the gyro's samples, on the log's clock, by its rows."""
    steps = np.diff(samples.time_us)
    row_us = float(steps[steps < HOLE * np.median(steps)].mean())
    return row_us / max(round(row_us / NOMINAL_US), 1)


def later_us(own_us: float, wanted_us: float) -> float:
    """By so much a slow movement is later for a gyro that samples every `own_us`."""
    return 0.0 if far(own_us, wanted_us) else DELAY_US * (own_us - wanted_us) / NOMINAL_US


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
        row_us = sample_us(samples) if len(part) < 2 else float(np.ptp(time_us[part])) / (len(part) - 1)
        hz: Floats = np.fft.rfftfreq(room, row_us * 1e-6).astype(np.float64)
        spectrum *= response(hz * wanted_us / NOMINAL_US) / response(hz * own_us / NOMINAL_US)
        value[part] = np.fft.irfft(spectrum, room)[: len(part)]
    return Samples(time_us, value)


def response(hz: Floats) -> NDArray[np.complex128]:
    """Of both filters at the nominal rate."""
    at = np.minimum(hz, TRUSTED_HZ)
    sensor = 1j * at / SENSOR_HZ
    firmware = 1j * np.tan(np.pi * at * NOMINAL_US * 1e-6) / np.tan(np.pi * FIRMWARE_HZ * NOMINAL_US * 1e-6)
    return np.asarray(1 / (poles(sensor) * poles(firmware)))


def poles(s: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Butterworth's two."""
    return np.asarray(1 + np.sqrt(2) * s + s * s)
