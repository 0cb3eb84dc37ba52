"""Memory for the rows of a log: an array for each type, which a walk fills."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..native import ffi
from .log import Array, EventType


class Arrays:
    """With room for so many rows of each type."""

    def __init__(self, types: tuple[EventType, ...], room: list[int]) -> None:
        self._arrays: list[Array] = [np.empty(rows, each.dtype) for each, rows in zip(types, room, strict=True)]
        self._filled = [0] * len(types)
        self.out: Any = ffi.new("uint8_t *[]", len(types))
        """For usd_walk, as `room`: what is left behind the rows that are there."""
        self.room: Any = ffi.new("uint64_t[]", len(types))
        self._point()

    def _point(self) -> None:
        for number, (array, filled) in enumerate(zip(self._arrays, self._filled, strict=True)):
            self.out[number] = ffi.cast("uint8_t *", array.ctypes.data + filled * array.itemsize)
            self.room[number] = len(array) - filled

    def enlarge(self, number: int, rows: int) -> None:
        """The walk has filled that type's room, and needs this much."""
        old = self._arrays[number]
        self._arrays[number] = np.empty(len(old) + rows, old.dtype)
        self._arrays[number][: len(old)] = old
        self._point()

    def add(self, rows: tuple[int, ...]) -> None:
        """What the walk has copied."""
        self._filled = [filled + more for filled, more in zip(self._filled, rows, strict=True)]
        self._point()

    def first(self, rows: list[int]) -> list[Array]:
        """So many of each type; the memory behind them is given back."""
        for array, count in zip(self._arrays, rows, strict=True):
            array.resize(count, refcheck=False)  # in its place
        return self._arrays
