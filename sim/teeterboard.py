"""Two robots on one teeterboard: what their gyros log while it rocks and strikes its stops, and the truth of it.

The board turns about one axis: it rocks slowly, and at each impact there is a blow of 2 ms (240 to 560 deg/s) that
makes it ring at 75 Hz. Each robot has a gyro as the Crazyflie's (BMI088: 16 bits of 2000 deg/s, 0.014 deg/s per root Hz
and 1 kHz by the data sheet, its filter of 116 Hz; then the firmware's low pass of 80 Hz) that runs on an oscillator of
its own, and logs each sample with the STM32's microseconds, synchronously.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .bmi088 import LSB_DPS, ODR_HZ, Floats, firmware_response, sensor_response
from .row_log import FIXED, Block, row_log

DENSITY_DPS_RTHZ = 0.014
FINE = 8
"""The sensor is simulated so many times faster than it gives samples."""
QUIET_S = 1.0
"""Before the board begins to move, and after it has come to rest."""
BLOW_S = 0.002
"""Smooth at both ends, as is the ringing: kinks would tell on which fine grid it was sampled, by half a microsecond."""
RING, RING_HZ, RING_S = 0.3, 75.0, 0.03
ROCK_DPS = 60.0


@dataclass(frozen=True, slots=True)
class Board:
    """What is simulated. Shifts are the second robot's stamp clock less the first's."""

    seed: int = 1
    seconds: float = 60.0
    impacts: int = 16
    rocking_dps: float = ROCK_DPS
    density_dps_rthz: float = DENSITY_DPS_RTHZ
    """Of the sensors' noise, white before their filters."""
    white_dps: float = 0.0
    """And noise that is white in the logged samples, standard deviation."""
    shift_us: float = 20_000.0
    """When the log begins."""
    skew_ppm: float = 15.0
    warming_ppm: float = 0.0
    """So much more at the beginning, gone with a time constant of a minute."""
    gain: float = 1.01
    """Of the second gyro over the first."""
    bias_dps: tuple[float, float] = (0.3, -0.2)
    turned_deg: float = 30.0
    """How the second robot is mounted, about the vertical."""
    every: int = 1
    """Of the samples, one in so many is logged: 2 for 500 Hz."""
    jitter_us: float = 0.0
    """Stamps are taken up to so much later than the sample."""
    flex: float = 0.0
    """The board bends: this part of a blow does not reach the second robot."""


@dataclass(frozen=True, slots=True)
class Teetered:
    board: Board
    logs: tuple[bytes, bytes]
    """Files of the µSD cards."""
    clean_dps: Floats
    """What the first gyro would have logged without noise, about the board's axis, 1 kHz."""
    stamp_us: Floats
    """Of each of these samples, first clock."""

    def shift_us(self, at_us: Any) -> Any:
        """The second clock less the first when the first says `at_us`."""
        first, second = clocks(self.board)
        true_s = (np.asarray(at_us, np.float64) - first.start_us) * 1e-6 / (1 + first.ppm * 1e-6)
        return second.at(true_s) - np.asarray(at_us, np.float64)


@dataclass(frozen=True, slots=True)
class Clock:
    start_us: float
    ppm: float
    warming_ppm: float = 0.0

    def at(self, true_s: Any) -> Any:
        """Microseconds that it shows."""
        warming = self.warming_ppm * 60.0 * (1 - np.exp(-np.asarray(true_s) / 60.0))
        return self.start_us + np.asarray(true_s) * (1e6 + self.ppm) + warming


def clocks(board: Board) -> tuple[Clock, Clock]:
    start_us = 5_000_000.0
    return Clock(start_us, 0.0), Clock(start_us + board.shift_us, board.skew_ppm, board.warming_ppm)


def teeter(board: Board) -> Teetered:
    """Both logs; the same board gives the same bytes."""
    random = np.random.default_rng(board.seed)
    blows = Blows.drawn(board, random)
    logs = []
    clean, clean_stamp = np.zeros(0), np.zeros(0)
    for robot, clock in enumerate(clocks(board)):
        odr_hz = ODR_HZ * (1 + random.uniform(-0.003, 0.003))
        true_s = random.uniform(0, 1 / ODR_HZ) + np.arange(int(board.seconds * odr_hz) * FINE) / (odr_hz * FINE)
        rate = blows.rate(true_s, 1.0 - board.flex * robot) * (board.gain if robot else 1.0)
        sample_s = true_s[::FINE]
        if robot == 0:
            clean = firmware(sensor(rate))
            clean_stamp = clock.at(sample_s)
        axis = np.radians(90.0 - board.turned_deg * robot)
        noise = random.normal(0, board.density_dps_rthz * np.sqrt(ODR_HZ * FINE / 2), (3, len(true_s)))
        axes = np.array([np.cos(axis), np.sin(axis), 0.0])
        raw = [sensor(part * rate + own) + board.bias_dps[robot] for part, own in zip(axes, noise, strict=True)]
        logged = [firmware(np.round(each / LSB_DPS) * LSB_DPS) for each in raw]
        logged = [each + random.normal(0, board.white_dps, len(each)) for each in logged]
        late_us = random.uniform(0, board.jitter_us, len(sample_s)) if board.jitter_us else 0.0
        stamp_us = np.floor(clock.at(sample_s) + late_us).astype(np.int64)
        columns = {f"gyro.{name}": each[:: board.every] for name, each in zip("xyz", logged, strict=True)}
        block = Block(FIXED, stamp_us[:: board.every], columns)
        logs.append(row_log([block], hz=round(1000 / board.every), session=board.seed * 2 + robot + 1))
    return Teetered(board, (logs[0], logs[1]), clean, clean_stamp)


@dataclass(frozen=True, slots=True)
class Blows:
    """How the board turns."""

    at_s: Floats
    size_dps: Floats
    rock_dps: Floats
    rock_hz: Floats
    phase: Floats
    from_s: float
    to_s: float

    @classmethod
    def drawn(cls, board: Board, random: np.random.Generator) -> Blows:
        first, last = QUIET_S + 0.5, board.seconds - QUIET_S - 0.5
        between = (last - first) / max(board.impacts, 1)
        at_s = first + (np.arange(board.impacts) + random.uniform(0.2, 0.8, board.impacts)) * between
        sign = np.where(np.arange(board.impacts) % 2, -1.0, 1.0)
        return cls(
            at_s=at_s,
            size_dps=sign * random.uniform(240, 560, board.impacts),
            rock_dps=board.rocking_dps * np.array([0.6, 0.3, 0.1]),
            rock_hz=np.array([0.7, 1.1, 1.9]) * random.uniform(0.95, 1.05, 3),
            phase=random.uniform(0, 2 * np.pi, 3),
            from_s=QUIET_S,
            to_s=board.seconds - QUIET_S,
        )

    def rate(self, true_s: Floats, part: float) -> Floats:
        """deg/s. `part`: of the blows."""
        rate = np.zeros(len(true_s))
        for size, hz, phase in zip(self.rock_dps, self.rock_hz, self.phase, strict=True):
            rate += size * np.sin(2 * np.pi * hz * true_s + phase)
        rate *= np.clip(np.minimum(true_s - self.from_s, self.to_s - true_s) / 0.5, 0, 1)
        for at, size in zip(self.at_s, self.size_dps * part, strict=True):
            here = slice(*np.searchsorted(true_s, [at, at + 10 * RING_S]))
            since = true_s[here] - at
            rate[here] += size * np.where(since < BLOW_S, np.sin(np.pi * since / BLOW_S) ** 2, 0.0)
            swells = np.exp(-since / RING_S) * (1 - np.exp(-since / BLOW_S))
            rate[here] += RING * size * np.sin(2 * np.pi * RING_HZ * since) * swells
        return rate


def sensor(fine: Floats) -> Floats:
    """The BMI088's filter, and one sample in FINE."""
    return filtered(fine, ODR_HZ * FINE, sensor_response)[::FINE]


def firmware(samples: Floats) -> Floats:
    """The low pass of the Crazyflie's firmware, from rest."""
    return filtered(samples, ODR_HZ, firmware_response)


def filtered(samples: Floats, hz: float, response: Callable[[Floats], NDArray[np.complex128]]) -> Floats:
    room = 1 << (len(samples) + round(hz / 10)).bit_length()
    spectrum = np.asarray(np.fft.rfft(samples, room)) * response(frequencies(room, hz))
    return np.fft.irfft(spectrum, room)[: len(samples)]


def frequencies(count: int, hz: float) -> Floats:
    """Of rfft."""
    return np.fft.rfftfreq(count, 1 / hz).astype(np.float64)


def noise_density(board: Board, hz: Floats) -> Floats:
    """Variance of a logged sample's noise per bin of a discrete spectrum at 1 kHz: what white noise of that variance
    would have."""
    through = np.zeros(len(hz))
    for k in range(-FINE // 2, FINE // 2):
        through += np.abs(sensor_response(hz + k * ODR_HZ)) ** 2
    sampled = board.density_dps_rthz**2 * ODR_HZ / 2 * through + LSB_DPS**2 / 12
    return np.asarray(sampled * np.abs(firmware_response(hz)) ** 2 + board.white_dps**2)


def noise_dps(board: Board) -> float:
    """Standard deviation of a logged sample's noise."""
    return float(np.sqrt(noise_density(board, (np.arange(2048) + 0.5) / 4096 * ODR_HZ).mean()))


def bound_us(teetered: Teetered, at_us: float, below_hz: float = ODR_HZ / 2) -> float:
    """Cramér and Rao's bound of the shift at that time of the first clock, when skew, gain and bias are unknown too.

    The Fisher information of the difference of both gyros, whose noise is that of both: derivatives of the clean
    signal, each frequency weighed by the noise there. With white noise, and the rest known, it is
    sqrt(2) sigma / sqrt(sum of the squared derivative). `below_hz`: for who uses no frequencies above.
    """
    clean, since_s = teetered.clean_dps, (teetered.stamp_us - at_us) * 1e-6
    hz = frequencies(len(clean), ODR_HZ)
    slope = np.fft.irfft(np.fft.rfft(clean) * 2j * np.pi * hz * 1e-6, len(clean))
    spectra = np.fft.rfft(np.stack([slope, slope * since_s, clean, np.ones(len(clean))]))
    # At half the rate the filter lets nothing through, no noise either.
    twice = np.where(hz == 0, 1.0, np.where(hz < below_hz, 2.0, 0.0)) / len(clean)
    noise = 2 * np.maximum(noise_density(teetered.board, hz), 1e-12)
    information = np.real((spectra * (twice / noise)) @ spectra.conj().T)
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))
