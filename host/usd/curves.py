"""Polynomials through rows, and turns between attitudes: for many times at once, one in each row of an array."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def norm(vectors: Floats) -> Floats:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=-1)))


def lagrange(at: Floats, times: Floats) -> tuple[Floats, Floats]:
    """Weights of the rows at these times in the polynomial through them, and |(t - t1) ... (t - tn)|."""
    away = at[:, None] - times
    weights = np.ones_like(times)
    for place in range(times.shape[1]):
        for other in range(times.shape[1]):
            if other != place:
                weights[:, place] *= away[:, other] / (times[:, place] - times[:, other])
    return weights, np.abs(away.prod(axis=1))


def divided(times: Floats, values: Floats) -> Floats:
    """Newton's divided difference over all rows of each run."""
    for order in range(1, times.shape[1]):
        values = (values[:, 1:] - values[:, :-1]) / (times[:, order:] - times[:, :-order])[:, :, None]
    return values[:, 0]


def slerp(first: Floats, second: Floats, part: Floats) -> Floats:
    """Along the shorter way."""
    second = np.where((first * second).sum(axis=1, keepdims=True) < 0, -second, second)
    angle = 2 * np.arctan2(norm(first - second), norm(first + second))
    with np.errstate(invalid="ignore", divide="ignore"):
        near = np.sin(angle) < 1e-9
        weights = [np.where(near, each, np.sin(each * angle) / np.sin(angle)) for each in (1 - part, part)]
    value = weights[0][:, None] * first + weights[1][:, None] * second
    return np.asarray(value / norm(value)[:, None])


def rotation_vector(first: Floats, second: Floats) -> Floats:
    """From one attitude to the other, in the axes of the first."""
    v, w = -first[:, :3], first[:, 3:]
    other_v, other_w = second[:, :3], second[:, 3:]
    vector = w * other_v + other_w * v + np.cross(v, other_v)
    scalar = w * other_w - (v * other_v).sum(axis=1, keepdims=True)
    vector = np.where(scalar < 0, -vector, vector)
    length = norm(vector)[:, None]
    angle = 2 * np.arctan2(length, np.abs(scalar))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(np.where(length < 1e-12, 2 * vector, vector / length * angle))
