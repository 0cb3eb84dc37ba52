"""The time offset between frames and gyro, from places that were seen twice: least squares on the whole model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera_model import COUNT, FOCAL, LINE, MIDDLE, SKEW, Places, seen_again, turned
from .jackknife import left_out
from .ticks import Floats
from .turning import Turning

ITERATIONS = 12
BLOCKS = 20
"""Of the jackknife."""
RAYLEIGH = 0.8326
"""Median of the root mean square of two normal numbers, whose sigma is 1."""
SETTLED = 0.01
"""Sigmas of times and focal length: a smaller step is the last. What a motion does not show may sway for long."""
OUTLIER = 3.0
"""Sigmas: places further off count less, with the square of how much further."""
STEP = np.array([1e-5, 1e-6, 1e-7, 1e-2, 1e-4, *[1e-5] * 3, *[1e-5] * 3, 1e-5])
"""For derivatives."""
LOOSE = np.array([np.inf, np.inf, np.inf, np.inf, 0.2, *[0.3] * 3, *[0.1] * 3, 0.02])
"""Sigma of what is known beforehand: a lens bends little, a gyro is right to 2 %. What no motion shows stays so."""


@dataclass(frozen=True, slots=True)
class Fit:
    """What came out, as camera_model's vector."""

    theta: Floats
    sigma: Floats
    """The larger of two: from the scatter of places, and from the scatter of the estimates without one of 20 parts."""
    residual_px: Floats
    """(n, 2): seen less expected."""
    weight: Floats
    """1, or less for places that are off."""
    scale: float
    """How much larger residuals are than the places' own covariances say."""


def start(middle_s: float, line_s: float, focal_px: float) -> Floats:
    theta = np.zeros(COUNT)
    theta[MIDDLE], theta[LINE], theta[FOCAL] = middle_s, line_s, focal_px
    return theta


def fit(places: Places, turning: Turning, assumed: Floats, theta: Floats, line_free: bool) -> Fit | None:
    """Gauss-Newton from `theta`; None when it leads nowhere. `line_free`: line_s is unknown too."""
    free = np.array([each for each in range(COUNT) if each != LINE or line_free])
    begin, root = theta, roots(places.information)
    prior = np.diag(1 / LOOSE[free] ** 2)
    for _ in range(ITERATIONS):
        away, slopes = linear(places, turning, assumed, theta, free)
        away, slopes = np.matmul(away[:, None], root)[:, 0], np.matmul(root.transpose(0, 2, 1), slopes)
        size = np.sqrt(0.5 * (away * away).sum(axis=1))
        scale = max(float(np.median(size)) / RAYLEIGH, 1e-3)
        weight = np.minimum(1.0, (OUTLIER * scale / np.maximum(size, 1e-12)) ** 2)
        away, slopes = away * np.sqrt(weight)[:, None], slopes * np.sqrt(weight)[:, None, None]
        columns, left = slopes.reshape(-1, len(free)), away.ravel()
        normal, right = columns.T @ columns + prior, columns.T @ left - prior @ (theta - begin)[free]
        try:
            step = np.linalg.solve(normal, right)
        except np.linalg.LinAlgError:
            return None
        theta = theta.copy()
        theta[free] += step
        if not np.isfinite(theta).all() or not 0.3 < theta[FOCAL] / begin[FOCAL] < 3:
            return None
        spread = np.sqrt(np.maximum(np.diag(np.linalg.inv(normal)), 0)) * scale
        if np.abs(step / spread)[free <= FOCAL].max() < SETTLED:
            break
    else:
        return None
    sigma = np.zeros(COUNT)
    parts = left_out(columns, left, np.repeat(blocks(places.pair), 2), prior).spread
    sigma[free] = np.fmax(spread, np.sqrt(np.diag(parts)))
    residual = places.after - model(places, turning, assumed, theta)
    return Fit(theta, sigma, residual, weight, scale)


@dataclass(frozen=True, slots=True)
class Part:
    """What one part of the recording says by itself about the offset, with all else as the whole has it."""

    stamp_s: float
    middle_s: float
    sigma_s: float


def by_part(places: Places, turning: Turning, assumed: Floats, found: Fit) -> list[Part]:
    """Of BLOCKS; those in which the robot hardly turned say little."""
    away, slopes = linear(places, turning, assumed, found.theta, np.array([MIDDLE]))
    root = roots(places.information)
    away, slopes = np.matmul(away[:, None], root)[:, 0], np.matmul(root.transpose(0, 2, 1), slopes)
    pull = found.weight * (slopes[:, :, 0] * away).sum(axis=1)
    power = found.weight * (slopes[:, :, 0] ** 2).sum(axis=1)
    number = blocks(places.pair)
    parts = []
    for each in np.unique(number):
        mine = number == each
        strength = float(power[mine].sum())
        if strength > 0:
            at_s = float(places.stamps_s[mine].mean())
            middle_s = float(found.theta[MIDDLE] + pull[mine].sum() / strength)
            parts.append(Part(at_s, middle_s, found.scale / np.sqrt(strength)))
    return parts


def blocks(pair: NDArray[np.intp]) -> NDArray[np.intp]:
    """BLOCKS parts in time."""
    return np.asarray((pair - pair.min()) * BLOCKS // (np.ptp(pair) + 1))


def model(places: Places, turning: Turning, assumed: Floats, theta: Floats) -> Floats:
    """Where the places are expected in the second frame, at the time of the row where they were found."""
    rows = np.stack([places.before[:, 1], places.after[:, 1]], axis=1)
    return seen_again(theta, assumed, places.before, *turned(theta, turning, places.stamps_s, rows))


def linear(
    places: Places, turning: Turning, assumed: Floats, theta: Floats, free: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """Residuals (n, 2), and derivatives of what is expected (n, 2, free)."""
    rows = np.stack([places.before[:, 1], places.after[:, 1]], axis=1)
    turn = turned(theta, turning, places.stamps_s, rows)
    here = seen_again(theta, assumed, places.before, *turn)
    slopes = []
    for each in free:
        moved = theta.copy()
        moved[each] += STEP[each]
        # Only times change how far the body turns.
        other = turned(moved, turning, places.stamps_s, rows) if each in (MIDDLE, SKEW, LINE) else turn
        slopes.append((seen_again(moved, assumed, places.before, *other) - here) / STEP[each])
    return places.after - here, np.stack(slopes, axis=2)


def roots(information: Floats) -> Floats:
    """(n, 2, 2): L with information = L L^T, also where nothing is known across one direction."""
    a, b, c = information[:, 0, 0], information[:, 0, 1], information[:, 1, 1]
    first = np.sqrt(np.maximum(a, 1e-12))
    second = b / first
    out = np.zeros_like(information)
    out[:, 0, 0], out[:, 1, 0], out[:, 1, 1] = first, second, np.sqrt(np.maximum(c - second**2, 0))
    return out
