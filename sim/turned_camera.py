"""A robot that is turned, its gyro's log, its camera's frames and the truth: what `host sync camera` is tried on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .bmi088 import LSB_DPS, as_logged, lag_s
from .panorama import Floats, Optics, panorama, render

Motion = Literal["teeter", "yaw", "still", "spin"]
FINE_S = 2e-4
TEETER_DEG = 15.0
TEETER_S = 0.25
"""From one side of the board to the other: slowly at first, and with a knock at the end ..."""
KNOCK_S = 4e-3
"""... in which it comes to rest."""


@dataclass(frozen=True, slots=True)
class Gyro:
    """BMI088 behind the Crazyflie's filter, as a log of the µSD card has it."""

    rate_hz: float = 1000.0
    noise_deg_s: float = 0.1
    """Of each row."""
    bias_deg_s: float = 0.3
    gain: float = 0.01
    quantum_deg_s: float = LSB_DPS
    filtered: bool = True
    """As the Crazyflie does; else there is no lag."""

    @property
    def lag_s(self) -> float:
        """Of slow motion."""
        return lag_s() if self.filtered else 0.0


class Turned:
    """Angles of yaw, pitch and roll over time, smooth to FINE_S; exact rotations and rates of the body from them."""

    def __init__(self, motion: Motion, seconds: float, seed: int) -> None:
        rng = np.random.default_rng([seed, 1])
        self.begin_s = -2.0
        self.time_s = np.arange(self.begin_s, seconds + 2.0, FINE_S)
        self.speed = np.radians(rates_deg_s(motion, self.time_s, rng))
        steps = 0.5 * (self.speed[1:] + self.speed[:-1]) * FINE_S
        self.angle = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])

    def _angles(self, at_s: Floats) -> tuple[Floats, Floats]:
        place = (at_s - self.begin_s) / FINE_S
        row = np.clip(place.astype(np.intp), 0, len(self.time_s) - 2)
        part = (place - row)[:, None]
        first, change = self.speed[row], self.speed[row + 1] - self.speed[row]
        return self.angle[row] + (first + 0.5 * change * part) * part * FINE_S, first + change * part

    def to_world(self, at_s: Floats) -> Floats:
        """(n, 3, 3): from the body's axes (forward, left, up)."""
        angles = self._angles(at_s)[0].T
        (cy, cp, cr), (sy, sp, sr) = np.cos(angles), np.sin(angles)
        rows = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return np.moveaxis(np.array(rows), 2, 0)

    def rate(self, at_s: Floats) -> Floats:
        """(n, 3), rad/s, about the body's axes."""
        (_, pitch, roll), (yaw_s, pitch_s, roll_s) = (each.T for each in self._angles(at_s))
        return np.stack(
            [
                roll_s - yaw_s * np.sin(pitch),
                pitch_s * np.cos(roll) + yaw_s * np.sin(roll) * np.cos(pitch),
                -pitch_s * np.sin(roll) + yaw_s * np.cos(roll) * np.cos(pitch),
            ],
            axis=1,
        )


def rates_deg_s(motion: Motion, time_s: Floats, rng: np.random.Generator) -> Floats:
    """(n, 3): how fast yaw, pitch and roll change."""
    rates = np.zeros((len(time_s), 3))
    if motion == "teeter":
        # Rests between falls to the other side; about an axis that is not quite the robot's.
        tilt = np.zeros(len(time_s))
        at, side = float(time_s[0]) + rng.uniform(0.4, 0.9), 1.0
        while at < time_s[-1] - 1:
            falls = slice(*np.searchsorted(time_s, [at, at + TEETER_S]))
            tilt[falls] += side * 4 * TEETER_DEG * (time_s[falls] - at) / TEETER_S**2
            at, side = at + TEETER_S + rng.uniform(0.3, 0.9), -side
        window = np.hanning(round(KNOCK_S / FINE_S) + 2)
        rates[:, 1] = np.convolve(tilt, window / window.sum(), "same")
        rates[:, 2] = 0.1 * rates[:, 1]
    elif motion == "yaw":
        for axis, deg_s in enumerate((90.0, 12.0, 12.0)):
            for _ in range(12):
                hz = rng.uniform(0.15, 1.0)
                rates[:, axis] += np.sin(2 * np.pi * (hz * time_s + rng.uniform())) * deg_s / np.sqrt(6)
    elif motion == "spin":
        rates[:, 0] = 60.0
    return rates


@dataclass(frozen=True)
class Flight:
    """Times are true; a log's and frames' stamps are times on one clock, the STM32's, plus what the truth says."""

    turned: Turned
    optics: Optics
    to_camera: Floats
    """(3, 3), body to camera."""
    gyro_time_s: Floats
    gyro_deg_s: Floats
    stamp_s: Floats
    """Of each frame, as stamped: its end less `offset_s`."""
    offset_s: float
    """True: what has to be added to a stamp to have the end of frame."""
    gyro: Gyro
    seed: int
    world: NDArray[np.float32] | None = field(default=None, compare=False)

    @property
    def body_middle_s(self) -> float:
        """True: from a stamp to the middle of exposure of the middle row."""
        return self.offset_s - self.optics.middle_to_end_s

    @property
    def middle_s(self) -> float:
        """The same on the gyro's log, which is late."""
        return self.body_middle_s + self.gyro.lag_s

    def frame(self, index: int) -> NDArray[np.uint8]:
        """Rendered anew each time, always the same."""
        world = panorama(self.seed, 3 * self.optics.height // 2) if self.world is None else self.world
        rng = np.random.default_rng([self.seed, 2, index])
        end_s = float(self.stamp_s[index]) + self.offset_s
        return render(world, self.optics, self.camera_to_world, end_s, rng)

    def camera_to_world(self, at_s: Floats) -> Floats:
        """(n, 3, 3)."""
        return self.turned.to_world(at_s) @ self.to_camera.T

    def band_shifts(self, bands: int, noise_px: float) -> tuple[NDArray[np.intp], Floats, Floats]:
        """Frame, where the middle of each band is (n, 2), and where it is seen in the next frame, with noise."""
        rng = np.random.default_rng([self.seed, 3])
        index = np.repeat(np.arange(len(self.stamp_s) - 1), bands)
        edges = (np.arange(bands) + 0.5) / bands - 0.5
        v = np.tile(edges * self.optics.height, len(self.stamp_s) - 1)
        before = np.stack([np.zeros(len(v)), v], axis=1)
        ray = np.stack([before[:, 0] / self.optics.focal_px, v / self.optics.focal_px, np.ones(len(v))], axis=1)
        ray = np.einsum("nij,nj->ni", self.camera_to_world(self._row_s(index, v)), ray)
        after = before
        for _ in range(6):
            seen = np.einsum("nji,nj->ni", self.camera_to_world(self._row_s(index + 1, after[:, 1])), ray)
            after = self.optics.focal_px * seen[:, :2] / seen[:, 2:]
        return index, before, after + rng.normal(0, noise_px, after.shape)

    def _row_s(self, index: NDArray[np.intp], v: Floats) -> Floats:
        end_s = self.stamp_s[index] + self.offset_s
        return np.asarray(end_s - self.optics.middle_to_end_s + v * self.optics.line_s)


def flight(
    seed: int,
    motion: Motion = "teeter",
    *,
    seconds: float = 40.0,
    fps: float = 30.0,
    optics: Optics | None = None,
    gyro: Gyro | None = None,
    pitch_deg: float = 0.0,
    world: NDArray[np.float32] | None = None,
) -> Flight:
    """One robot, turned for so long. `world`: a panorama instead of the one that the seed makes."""
    optics, gyro = optics or Optics(), gyro or Gyro()
    rng = np.random.default_rng([seed, 0])
    made = Turned(motion, seconds, seed)
    offset_s = float(rng.uniform(-0.05, 0.05))
    stamps = np.arange(rng.uniform(0.2, 0.2 + 1 / fps), seconds - 0.2, 1 / fps)
    rate = made.rate(made.time_s)
    rate = as_logged(rate, FINE_S) if gyro.filtered else rate
    times = np.arange(-0.5 + rng.uniform(0, 1 / gyro.rate_hz), seconds + 0.5, 1 / gyro.rate_hz)
    logged = np.stack([np.interp(times, made.time_s, rate[:, axis]) for axis in range(3)], axis=1)
    logged = np.degrees(logged) * (1 + rng.normal(0, gyro.gain)) + rng.normal(0, gyro.bias_deg_s, 3)
    logged += rng.normal(0, gyro.noise_deg_s, logged.shape)
    logged = np.round(logged / gyro.quantum_deg_s) * gyro.quantum_deg_s
    up = np.radians(pitch_deg)
    to_camera = np.array([[0, -1, 0], [np.sin(up), 0, -np.cos(up)], [np.cos(up), 0, np.sin(up)]])
    return Flight(made, optics, to_camera, times, logged, stamps, offset_s, gyro, seed, world)
