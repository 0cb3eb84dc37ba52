"""The Crazyflie's gyro (BMI088) as it is logged: how its filters answer.

Its filter of 116 Hz is ahead of its samples; the firmware has one of 80 Hz. That the sensor's has two equal poles is an
assumption: the data sheet says the bandwidth, and Bosch's support that the noise's is 1.22 of it. Nothing of host.clock
is in it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

SENSOR_HZ = 116.0
UNFILTERED_HZ = 523.0
"""All that comes to it, by the data sheet: taken for steep, and without a delay of its own."""
FIRMWARE_HZ = 80.0
ODR_HZ = 1000.0
LSB_DPS = 2000.0 / 32768


def sensor_response(hz: Floats) -> NDArray[np.complex128]:
    s = 1j * hz / SENSOR_HZ * np.sqrt(np.sqrt(2) - 1)
    return np.asarray(1 / ((1 + s) ** 2 * np.sqrt(1 + (hz / UNFILTERED_HZ) ** 8)))


def firmware_response(hz: Floats) -> NDArray[np.complex128]:
    """lpf2pApply at 1 kHz: Butterworth of two poles by the bilinear transform."""
    s = 1j * np.tan(np.pi * hz / ODR_HZ) / np.tan(np.pi * FIRMWARE_HZ / ODR_HZ)
    return np.asarray(1 / (1 + np.sqrt(2) * s + s * s))


def lag_s() -> float:
    """Of slow motion: the slope of the phase."""
    slow = np.array([0.01])
    return float(-np.angle(sensor_response(slow) * firmware_response(slow))[0] / (2 * np.pi * slow[0]))


def as_logged(values: Floats, step_s: float) -> Floats:
    """Both filters, columns apart; the ends wrap. Nothing is left of what is faster than half the loop."""
    hz: Floats = np.minimum(np.fft.rfftfreq(len(values), step_s), ODR_HZ / 2 - 1)
    through = sensor_response(hz) * firmware_response(hz)
    return np.fft.irfft(np.fft.rfft(values, axis=0) * through[:, None], len(values), axis=0)
