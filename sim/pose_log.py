"""A log of a robot that flies with motion capture: its gyro, the poses that it is told late, and an estimate of its
own; and how late they are. Nothing of host.clock is in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .bmi088 import LSB_DPS, Floats, as_logged
from .row_log import FIXED, Block, row_log
from .turned_camera import FINE_S, Motion, Turned

START_US = 12_000_000


@dataclass(frozen=True, slots=True)
class Flight:
    """What is simulated."""

    seed: int = 1
    seconds: float = 20.0
    motion: Motion = "yaw"
    mocap_lag_us: float = 12_000.0
    """From the motion to the pose's stamp."""
    mocap_jitter_us: float = 300.0
    """And up to so much more."""
    mocap_noise_deg: float = 0.05
    lost: float = 0.05
    """Of the poses, on the radio."""
    estimate_lag_us: float = 6_000.0
    estimate_noise_deg: float = 0.05
    gyro_noise_dps: float = 0.12
    bias_dps: float = 0.3
    gain: float = 1.01
    mount_deg: float = 1.0
    hz: int = 500


def pose_log(flight: Flight) -> bytes:
    """gyro and stateEstimate at a fixed frequency, and estPose with locSrv at 100 Hz."""
    random = np.random.default_rng([flight.seed, 7])
    turned = Turned(flight.motion, flight.seconds, flight.seed)
    begin_s, end_s = 0.2, flight.seconds - 0.2
    row_s = np.arange(begin_s, end_s, 1 / flight.hz)
    rate = np.degrees(as_logged(turned.rate(turned.time_s), FINE_S)) * flight.gain + flight.bias_dps
    gyro = np.stack([np.interp(row_s, turned.time_s, rate[:, axis]) for axis in range(3)], axis=1)
    gyro = np.round((gyro + random.normal(0, flight.gyro_noise_dps, gyro.shape)) / LSB_DPS) * LSB_DPS
    estimate = seen(turned, row_s - flight.estimate_lag_us * 1e-6, flight.estimate_noise_deg, 0.0, random)
    fixed = Block(
        FIXED,
        stamps_us(row_s),
        {
            **{f"gyro.{name}": gyro[:, axis] for axis, name in enumerate("xyz")},
            **{f"stateEstimate.q{name}": estimate[:, place] for place, name in enumerate("wxyz")},
        },
    )
    taken_s = np.arange(begin_s, end_s - 0.1, 0.01)
    taken_s = taken_s[random.random(len(taken_s)) > flight.lost]
    poses = seen(turned, taken_s, flight.mocap_noise_deg, flight.mount_deg, random)
    late_s = flight.mocap_lag_us * 1e-6 + random.uniform(0, flight.mocap_jitter_us * 1e-6, len(taken_s))
    told = Block(
        "estPose",
        stamps_us(taken_s + late_s),
        {
            **{f"locSrv.{name}": np.zeros(len(poses)) for name in "xyz"},
            **{f"locSrv.q{name}": poses[:, place] for place, name in enumerate("wxyz")},
        },
    )
    return row_log([fixed, told], hz=flight.hz, session=flight.seed + 1)


def seen(turned: Turned, at_s: Floats, noise_deg: float, mount_deg: float, random: np.random.Generator) -> Floats:
    """Attitudes then, w x y z, turned by the mount and by noise."""
    small = np.radians(random.normal(0, noise_deg, (len(at_s), 3)) + mount_deg)
    return quaternions(turned.to_world(at_s) @ little(small))


def little(angles: Floats) -> Floats:
    """Rotation matrices of small rotation vectors, to the second order."""
    x, y, z = angles.T
    zero = np.zeros(len(angles))
    cross = np.moveaxis(np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]), 2, 0)
    return np.asarray(np.eye(3) + cross + 0.5 * cross @ cross)


def quaternions(matrices: Floats) -> Floats:
    """w x y z; of matrices of less than half a turn from another, by the largest eigenvalue (Bar-Itzhack)."""
    m = np.moveaxis(matrices, 0, 2)
    rows = [
        [m[0, 0] + m[1, 1] + m[2, 2], m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], m[0, 0] - m[1, 1] - m[2, 2], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], m[1, 1] - m[0, 0] - m[2, 2], m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], m[2, 2] - m[0, 0] - m[1, 1]],
    ]
    return np.asarray(np.linalg.eigh(np.moveaxis(np.array(rows), 2, 0))[1][:, :, -1])


def stamps_us(at_s: Floats) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.floor(START_US + at_s * 1e6).astype(np.int64)
