"""How a body has turned between two times, by its gyro."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .ticks import Floats

GAP_S = 0.05
"""Rows further apart are a gap, in which nothing is known."""


class Turning:
    """The attitude at every row, from rates that go straight from row to row."""

    def __init__(self, time_s: Floats, rate_rad_s: Floats) -> None:
        """Times rise; rates are (rows, 3), about the body's axes."""
        self.time_s = time_s
        self.rate_rad_s = rate_rad_s
        step_s = np.diff(time_s)[:, None]
        turns = from_vector(0.5 * (rate_rad_s[1:] + rate_rad_s[:-1]) * step_s)
        self.attitude = running_product(np.concatenate([[[1.0, 0.0, 0.0, 0.0]], turns]))
        self._gaps = np.concatenate([[0], np.cumsum(np.diff(time_s) > GAP_S)])

    def is_known(self, from_s: Floats, to_s: Floats) -> NDArray[np.bool_]:
        """Both inside, and no gap between them."""
        first, last = self._rows(from_s), self._rows(to_s)
        inside = (np.minimum(from_s, to_s) >= self.time_s[0]) & (np.maximum(from_s, to_s) <= self.time_s[-1])
        whole = self._gaps[np.minimum(first, last)] == self._gaps[np.maximum(first, last) + 1]
        return np.asarray(inside & whole)

    def between(self, from_s: Floats, to_s: Floats) -> Floats:
        """(n, 3): rotation vectors, rad, about the body's axes."""
        return to_vector(product(conjugate(self.at(from_s)), self.at(to_s)))

    def _rows(self, at_s: Floats) -> NDArray[np.intp]:
        return np.clip(np.searchsorted(self.time_s, at_s, "right") - 1, 0, len(self.time_s) - 2)

    def at(self, at_s: Floats) -> Floats:
        """(n, 4): attitudes, from the first row's on."""
        row = self._rows(at_s)
        step_s = self.time_s[row + 1] - self.time_s[row]
        since_s = at_s - self.time_s[row]
        first, change = self.rate_rad_s[row], self.rate_rad_s[row + 1] - self.rate_rad_s[row]
        turn = first * since_s[:, None] + change * (0.5 * since_s**2 / step_s)[:, None]
        return product(self.attitude[row], from_vector(turn))


def from_vector(turn: Floats) -> Floats:
    """(n, 4) quaternions, w first, of (n, 3) rotation vectors."""
    half = 0.5 * np.sqrt((turn * turn).sum(axis=1))
    return np.concatenate([np.cos(half)[:, None], turn * (0.5 * np.sinc(half / np.pi))[:, None]], axis=1)


def to_vector(quaternion: Floats) -> Floats:
    quaternion = quaternion * np.where(quaternion[:, :1] < 0, -1.0, 1.0)
    size = np.sqrt((quaternion[:, 1:] ** 2).sum(axis=1))
    angle = 2 * np.arctan2(size, quaternion[:, 0])
    return quaternion[:, 1:] * np.where(size > 1e-12, angle / np.maximum(size, 1e-12), 2.0)[:, None]


def product(a: Floats, b: Floats) -> Floats:
    w, x, y, z = a.T
    p, q, r, s = b.T
    whole = np.empty((4, max(len(a), len(b))))
    whole[0] = w * p - x * q - y * r - z * s
    whole[1] = w * q + x * p + y * s - z * r
    whole[2] = w * r - x * s + y * p + z * q
    whole[3] = w * s + x * r - y * q + z * p
    return whole.T


def conjugate(quaternion: Floats) -> Floats:
    return np.asarray(quaternion * [1.0, -1.0, -1.0, -1.0])


def running_product(turns: Floats) -> Floats:
    """Of quaternions, each row's with all before it; in log2(rows) passes over all of them."""
    whole = turns.copy()
    reach = 1
    while reach < len(whole):
        whole[reach:] = product(whole[:-reach], whole[reach:])
        reach *= 2
    return np.asarray(whole / np.sqrt((whole * whole).sum(axis=1, keepdims=True)))
