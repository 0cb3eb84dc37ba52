"""Where a turning camera with a rolling shutter sees a far thing again in its next frame.

Pixels count from the middle of the picture: u to the right, v down. The camera's axes are u, v and ahead; the body's
are forward, left, up. A row's time is the middle of its exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ticks import Floats
from .turning import Turning, from_vector

MIDDLE, SKEW, LINE, FOCAL, BEND, MOUNT, BIAS, GAIN, COUNT = 0, 1, 2, 3, 4, 5, 8, 11, 12
"""Places in the vector of what is unknown: middle_s (of the middle row, after the frame's stamp, on the gyro's clock),
skew (of the gyro's clock against the stamps'), line_s (from row to row), focal_px, bend (of the lens: a ray's tangent
is (1 + bend p^2) p with p = pixels / focal), mount (3, rad: off the mount that was assumed), bias (3, rad/s: of the
gyro), gain (of the gyro, less 1)."""
SOLVE_LENS = 5
"""Iterations; with a bend of 0.3 the last one moves nothing by 0.01 px."""
ROW_ROUNDS, ROW_PX = 3, 0.05
"""To find in which row, and so when, a thing is seen again: at 8 rad/s a row off is 0.1 px."""


@dataclass(frozen=True, slots=True)
class Places:
    """Things that were seen in two frames that follow each other; one row each."""

    pair: NDArray[np.intp]
    """Which two frames."""
    stamps_s: Floats
    """(n, 2): of the two frames, from the middle of the recording on."""
    before: Floats
    """(n, 2): u, v in the first."""
    after: Floats
    """(n, 2): in the second."""
    information: Floats
    """(n, 2, 2): the inverse of the covariance of `after`."""

    def some(self, which: NDArray[np.bool_]) -> Places:
        return Places(*(getattr(self, name)[which] for name in self.__slots__))


def mount(pitch_deg: float, roll_deg: float = 0.0) -> Floats:
    """Body to camera, of one that looks forward, then up by `pitch_deg`, its picture turned by `roll_deg`."""
    up, turned = np.radians([pitch_deg, roll_deg])
    upright = np.array([[0, -1, 0], [np.sin(up), 0, -np.cos(up)], [np.cos(up), 0, np.sin(up)]])
    about = np.array([[np.cos(turned), np.sin(turned), 0], [-np.sin(turned), np.cos(turned), 0], [0, 0, 1]])
    return np.asarray(about @ upright)


def when_s(theta: Floats, stamp_s: Floats, v: Floats) -> Floats:
    """On the gyro's clock: the middle of the exposure of the row at `v`."""
    return np.asarray(stamp_s * (1 + theta[SKEW]) + theta[MIDDLE] + v * theta[LINE])


def turned(theta: Floats, turning: Turning, stamps_s: Floats, v: Floats) -> tuple[Floats, Floats]:
    """How the body turns from row `v[:, 0]` of the first frame to row `v[:, 1]` of the second, and in which time."""
    first, last = when_s(theta, stamps_s[:, 0], v[:, 0]), when_s(theta, stamps_s[:, 1], v[:, 1])
    return turning.between(first, last), last - first


def seen_again(theta: Floats, assumed: Floats, before: Floats, turn: Floats, passed_s: Floats) -> Floats:
    """(n, 2): where things at `before` are after the body's turn; NaN where that is behind the camera."""
    true_turn = (1 + theta[GAIN]) * turn - theta[BIAS : BIAS + 3] * passed_s[:, None]
    vector = true_turn @ (rotation(theta[MOUNT : MOUNT + 3]) @ assumed).T
    # By components: arrays (n,) are worked through several times faster than (n, 3).
    x, y, z = vector.T
    u, v = (before / theta[FOCAL]).T
    bent = 1 + theta[BEND] * (u * u + v * v)
    u, v = bent * u, bent * v
    angle = np.sqrt(x * x + y * y + z * z)
    # Rodrigues: the ray (u, v, 1) turns against the camera.
    near, far = np.sinc(angle / np.pi), 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    right, down, on = y - z * v, z * u - x, x * v - y * u
    ahead = 1 - near * on + far * (x * down - y * right)
    ahead[ahead <= 0.1] = np.nan
    u, v = (
        (u - near * right + far * (y * on - z * down)) / ahead,
        (v - near * down + far * (z * right - x * on)) / ahead,
    )
    bent = np.ones_like(u)
    for _ in range(SOLVE_LENS):
        bent = 1 + theta[BEND] * (u * u + v * v) / bent**2
    return np.asarray(np.stack([u / bent, v / bent], axis=1) * theta[FOCAL])


def rotation(vector: Floats) -> Floats:
    """(3, 3)."""
    w, x, y, z = from_vector(vector[None])[0]
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def expected(theta: Floats, assumed: Floats, turning: Turning, stamps_s: Floats, before: Floats) -> Floats:
    """Where things at `before` will be; their row in the second frame, which its time depends on, is found as well."""
    row = before[:, 1]
    for _ in range(ROW_ROUNDS):
        turn, passed_s = turned(theta, turning, stamps_s, np.stack([before[:, 1], row], axis=1))
        after = seen_again(theta, assumed, before, turn, passed_s)
        row, last = np.where(np.isnan(after[:, 1]), before[:, 1], after[:, 1]), row
        if np.abs(row - last).max(initial=0) < ROW_PX:
            break
    return after
