"""How late the attitudes of a log are, motion capture's or an estimator's, by the gyro of the same log.

Between two attitudes a robot has turned as far as the integral of its gyro says, only earlier, by the lag. So the lag,
and what else the two may differ in (gain and bias of the gyro, a mount that is a little askew), are fitted by least
squares: attitudes against the integral, by segments of a second, each with an attitude of its own at its start, so that
what drifts does not count. The same clock is on both sides: nothing is known of it, and nothing is needed. How sure it
is, the segments say: each in turn is left out (jackknife).

A gyro is late too, by its filters: the lag behind the motion is longer by that, and both are given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .gyro import DPS, IN_RADIANS, Gyro, Refused
from .gyro_filter import late_us, sample_us
from .jackknife import left_out
from .ticks import Floats
from .turning import Turning, conjugate, from_vector, product, to_vector

SEGMENT_S = 1.0
POSES_MIN = 10
"""Of a segment."""
SEGMENTS_MIN = 4
SEARCHED = 30
"""Poses of a segment are enough for the search."""
SEARCH_US = np.arange(-60e3, 160e3, 4e3)
APART_US = 12e3
RIVAL = 1.15
"""A lag elsewhere whose error is less than so many times the best's leaves it open which is right."""
RATE_S = 5e-3
"""To each side, over which a rate is taken."""
OUTLIER = 6.0
AGREE = 0.5
"""What is left, over how far the robot has turned within segments."""
SIGMA_US_MAX = 3000.0
STEPS_MAX = 10
STEP_US = 0.1
LAG, GAIN, MOUNT, BIAS = slice(0, 1), slice(1, 2), slice(2, 5), slice(5, 8)
NOISE = 1e-3
"""rad, of an attitude: until it is known."""
PRIOR = np.array([np.inf, 0.05, *[0.1] * 3, *[0.05] * 3])
"""How large each may be; rad and rad/s. It holds what a motion does not show."""
NOTHING = np.zeros(len(PRIOR))


@dataclass(frozen=True, slots=True)
class Attitudes:
    """On the gyro's clock, in order; x y z w."""

    time_us: Floats
    attitude: Floats


@dataclass(frozen=True, slots=True)
class Lag:
    lag_us: float
    """Behind the gyro as it is logged."""
    sigma_us: float
    behind_motion_us: float
    """And what the Crazyflie's filters make the gyro late."""
    gain: float
    """Of the attitudes' turning over the gyro's."""
    mount_deg: tuple[float, float, float]
    """Of the attitudes' axes against the gyro's."""
    noise_deg: float
    """Standard deviation, each axis, of what is left."""
    rate_dps: float
    """Root mean square of how fast the robot turned, less the segments' means."""
    poses: int
    outliers: int
    segments: int
    at_us: Floats
    """Of each pose used: its time ..."""
    left_deg: Floats
    """... and what is left, (poses, 3) ..."""
    turning_dps: Floats
    """... and how fast the robot turned, about the same axes."""


def lag_of(poses: Attitudes, gyro: Gyro) -> Lag | Refused:
    known = np.isfinite(poses.attitude).all(axis=1)
    least = POSES_MIN * SEGMENTS_MIN
    if min(known.sum(), len(gyro.time_us)) < least:
        return Refused(f"{known.sum()} attitudes and {len(gyro.time_us)} rows of the gyro: {least} of each are needed")
    begin_us = float(gyro.time_us[0])
    turning = Turning((gyro.time_us - begin_us) * 1e-6, np.radians(gyro.rate_dps))
    fit = LagFit(turning, (poses.time_us[known] - begin_us) * 1e-6, poses.attitude[known][:, [3, 0, 1, 2]])
    turns = fit.rows(0.0, np.ones(len(fit.time_s), np.bool_), NOTHING[MOUNT])
    if len(turns.place) and turns.residual.std() > IN_RADIANS * turns.columns[:, GAIN].std() > IN_RADIANS * NOISE:
        return Refused(f"the attitudes turn 40 times as far as the gyro, or more: is it in rad/s? {DPS}")
    found = fit.searched()
    if isinstance(found, Refused):
        return found
    late_s, mount, used = found, np.zeros(3), np.ones(len(fit.time_s), np.bool_)
    for step in range(STEPS_MAX):
        rows = fit.rows(late_s, used, mount)
        if len(np.unique(rows.number)) < SEGMENTS_MIN:
            return Refused(f"less than {SEGMENTS_MIN} seconds with attitudes and gyro")
        state, left = rows.solved(mount)
        late_s += float(state[0])
        mount = mount + state[MOUNT]
        size = np.abs(left.reshape(-1, 3)).max(axis=1)
        if step > 1 and abs(state[0]) < STEP_US * 1e-6:
            break
        if step == 1:
            used[rows.place[size > OUTLIER * 1.4826 * float(np.median(size))]] = False
    noise = float(left.std())
    turned = float(rows.columns[:, GAIN].std())
    if noise > AGREE * turned:
        return Refused(
            f"the attitudes do not turn as the gyro does ({np.degrees(noise):.1f} of {np.degrees(turned):.1f} deg are"
            " left): too little rotation, or other axes"
        )
    sigma_us = rows.sigma(noise, left) * 1e6
    rate = rows.columns[:, 0].reshape(-1, 3)
    rate_dps = float(np.degrees(np.sqrt((rate**2).sum(axis=1).mean())))
    if not sigma_us < SIGMA_US_MAX:
        return Refused(
            f"too little rotation (rms {rate_dps:.1f} deg/s): the lag would be sure to ± {sigma_us / 1000:.1f} ms only"
        )
    return Lag(
        lag_us=late_s * 1e6,
        sigma_us=sigma_us,
        behind_motion_us=late_s * 1e6 + late_us(sample_us(gyro.time_us)),
        gain=1 + float(state[GAIN][0]),
        mount_deg=tuple(np.degrees(mount).tolist()),
        noise_deg=float(np.degrees(noise)),
        rate_dps=rate_dps,
        poses=len(rows.place),
        outliers=int((~used).sum()),
        segments=int(rows.number[-1]) + 1,
        at_us=fit.time_s[rows.place] * 1e6 + begin_us,
        left_deg=np.degrees(left.reshape(-1, 3)),
        turning_dps=np.degrees(-rate),
    )


@dataclass(frozen=True, slots=True)
class Rows:
    """The linear problem at a lag: three rows for each pose."""

    place: NDArray[np.intp]
    """Of each pose used."""
    number: NDArray[np.intp]
    """Of its segment, from 0 on."""
    columns: Floats
    residual: Floats

    def solved(self, mount: Floats) -> tuple[Floats, Floats]:
        """The state, of lag and mount what they change by; and what is left. The prior is weighed by the noise that
        there is, and holds all of the mount."""
        already = NOTHING.copy()
        already[MOUNT] = mount
        noise = float(solved(self.columns, self.residual, held(NOISE), already)[1].std())
        return solved(self.columns, self.residual, held(noise), already)

    def sigma(self, noise: float, left: Floats) -> float:
        """Of the lag."""
        number = np.repeat(self.number, 3)
        return left_out(self.columns, left, number, held(noise)).sigma(np.eye(len(PRIOR))[0])


def solved(columns: Floats, residual: Floats, prior: Floats, already: Floats) -> tuple[Floats, Floats]:
    """By least squares, beyond what is in `residual` already; and what is left."""
    pulled = columns.T @ residual - prior @ already
    state: Floats = np.linalg.solve(columns.T @ columns + prior, pulled).astype(np.float64)
    return state, residual - columns @ state


def held(noise: float) -> Floats:
    return np.diag((noise / PRIOR) ** 2)


class LagFit:
    """Attitudes against the integral of a gyro; times in seconds since its first row."""

    def __init__(self, turning: Turning, time_s: Floats, attitude: Floats) -> None:
        """`attitude`: w x y z."""
        self.turning = turning
        self.time_s = time_s
        self.attitude = attitude

    def searched(self) -> float | Refused:
        """The lag that leaves least, seconds, of those tried one by one."""
        errors = np.full(len(SEARCH_US), np.inf)
        segments = np.ptp(self.time_s) / SEGMENT_S + 1
        some = np.arange(len(self.time_s)) % max(int(len(self.time_s) / segments / SEARCHED), 1) == 0
        for place, lag_us in enumerate(SEARCH_US.tolist()):
            rows = self.rows(lag_us * 1e-6, some, NOTHING[MOUNT])
            if len(rows.place):
                errors[place] = float(
                    np.median(np.abs(solved(rows.columns[:, 1:], rows.residual, held(NOISE)[1:, 1:], NOTHING[1:])[1]))
                )
        best = int(np.argmin(errors))
        if not np.isfinite(errors[best]):
            return Refused("attitudes and gyro are not of the same time")
        elsewhere = np.abs(SEARCH_US - SEARCH_US[best]) > APART_US
        if best in (0, len(errors) - 1) or errors[elsewhere].min() <= RIVAL * errors[best]:
            return Refused(
                "too little rotation, or an even one: no lag between -60 and 160 ms fits better than others;"
                " turn the robot to and fro, quickly, for 10 s"
            )
        return float(SEARCH_US[best]) * 1e-6

    def rows(self, late_s: float, used: NDArray[np.bool_], mount: Floats) -> Rows:
        """`mount` is taken off: of a degree, what is not linear in it would be 13 us of lag."""
        at_s = self.time_s - late_s
        place = np.flatnonzero(used & self.turning.is_known(at_s - RATE_S, at_s + RATE_S))
        segment = np.floor(self.time_s[place] / SEGMENT_S)
        _, number, count = np.unique(segment, return_inverse=True, return_counts=True)
        place = place[count[number] >= POSES_MIN]
        if not len(place):
            return Rows(place, place, np.zeros((0, len(PRIOR))), np.zeros(0))
        segment = np.floor(self.time_s[place] / SEGMENT_S)
        starts, number = np.unique(segment, return_index=True, return_inverse=True)[1:]
        at_s = at_s[place]
        body = self.turning.at(at_s)
        attitude = product(self.attitude[place], from_vector(-mount[None]))
        apart = product(attitude, conjugate(body))
        residual = to_vector(product(conjugate(apart[starts])[number], apart))
        rate = rotated(body, self.turning.between(at_s - RATE_S, at_s + RATE_S) / (2 * RATE_S))
        step_s = np.diff(at_s, prepend=at_s[:1])
        step = rotated(body, to_vector(product(conjugate(np.concatenate([body[:1], body[:-1]])), body)))
        turns = [rotated(body, np.tile(axis, (len(body), 1))) for axis in np.eye(3)]
        columns = np.stack(
            [-rate, np.cumsum(step, axis=0), *turns, *(np.cumsum(each * step_s[:, None], axis=0) for each in turns)],
            axis=2,
        )
        every = np.concatenate([columns, residual[:, :, None]], axis=2)
        total = np.add.reduceat(every, starts, axis=0)
        every -= (total / np.diff(starts, append=len(place))[:, None, None])[number]
        return Rows(place, number, every[:, :, :-1].reshape(-1, columns.shape[2]), every[:, :, -1].reshape(-1))


def rotated(quaternion: Floats, vector: Floats) -> Floats:
    """From the body's axes."""
    pure = np.concatenate([np.zeros((len(vector), 1)), vector], axis=1)
    return product(product(quaternion, pure), conjugate(quaternion))[:, 1:]
