"""A sampled signal between its samples, and the noise of what is left of it: for fits of one clock to another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

NODES = 8
"""Of the polynomial between samples: 80 Hz sampled at 1 kHz is right to 4e-6, at 500 Hz to 1e-3."""
HOLE = 1.7
"""Times the usual step, on average over the nodes' span: a row or more is missing there."""
SLOPE_STEPS = 0.1
"""Of a step to each side, for a derivative."""
SMOOTH_HZ = 200.0
"""There is hardly any turning above, after a filter of 80 Hz."""
SMOOTH_HALF_US = 10e3
ORDER = 12
"""Of the noise's autoregression."""
FLOOR = 1e-2
"""White noise, as a part of its power, that is taken to be in it: frequencies with less are not trusted either."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Times in order, none twice."""

    time_us: Floats
    value: Floats

    @property
    def step_us(self) -> float:
        return float(np.median(np.diff(self.time_us)))

    def at(self, time_us: Floats) -> Floats:
        """By the polynomial through the nearest NODES samples; NaN where there are none, or some are missing."""
        count = len(self.time_us)
        first = np.searchsorted(self.time_us, time_us) - NODES // 2
        known = (first >= 0) & (first + NODES <= count)
        if count < NODES:
            return np.full(len(time_us), np.nan)
        first = np.clip(first, 0, count - NODES)
        places = first + np.arange(NODES)[:, None]
        nodes = self.time_us[places]
        known &= nodes[-1] - nodes[0] < HOLE * (NODES - 1) * self.step_us
        # Neville's scheme: stable, and a node itself is no special case.
        value = self.value[places]
        for order in range(1, NODES):
            left, right = nodes[:-order], nodes[order:]
            value = ((time_us - left) * value[1:] - (time_us - right) * value[:-1]) / (right - left)
        return np.where(known, value[0], np.nan)

    def slope(self, time_us: Floats) -> Floats:
        """Per us."""
        aside = SLOPE_STEPS * self.step_us
        return (self.at(time_us + aside) - self.at(time_us - aside)) / (2 * aside)


def prediction(residual: Floats, used: Mask) -> Floats:
    """The filter (1, -a1, ...) that makes this noise white, from the samples that are used (Yule and Walker)."""
    own = np.where(used, residual, 0.0)
    pairs = [float(own[lag:] @ own[: len(own) - lag]) / max(int((used[lag:] & used[: len(used) - lag]).sum()), 1)
             for lag in range(ORDER + 1)]  # fmt: skip
    covariance = np.array(pairs)
    matrix = covariance[np.abs(np.subtract.outer(np.arange(ORDER), np.arange(ORDER)))]
    matrix += np.eye(ORDER) * FLOOR * covariance[0]
    return np.concatenate([[1.0], -np.linalg.solve(matrix, covariance[1:])])


def low_pass(step_us: float) -> Floats:
    """A filter without delay that lets through what is below SMOOTH_HZ."""
    half = max(round(SMOOTH_HALF_US / step_us), 1)
    at = np.arange(-half, half + 1)
    kernel = np.sinc(2e-6 * SMOOTH_HZ * step_us * at) * np.hanning(2 * half + 3)[1:-1]
    return np.asarray(kernel / kernel.sum())


def smoothed(columns: Floats, by: Floats) -> Floats:
    """Each column through low_pass; half its length at both ends is of no use."""
    return np.stack([np.convolve(column, by, "same") for column in columns.T], axis=1)


def whitened(columns: Floats, by: Floats) -> Floats:
    """Each column through the filter; the first ORDER rows are of no use."""
    return np.stack([np.convolve(column, by)[: len(column)] for column in columns.T], axis=1)
