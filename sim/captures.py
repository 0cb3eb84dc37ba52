"""The truth about every capture, as a world remembers it: the kernel itself remembers few."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host.native import ffi, lib

from .truth import TRUTH_DTYPE

NS = 1_000_000_000
TRUTH_MAX = 1 << 20
"""Captures remembered; the oldest go first."""
TRUTH_BATCH = 4096


class Captures:
    """Of all robots of a world."""

    def __init__(self) -> None:
        self.lost = 0
        """Forgotten."""
        self._parts: deque[NDArray[np.void]] = deque()
        self._next_ns = 0

    def take(self, kernel: Any, now: bool = False) -> None:
        """Takes them out of the kernel, about once a second."""
        if not now and lib.kernel_now_ns(kernel) < self._next_ns:
            return
        self._next_ns = lib.kernel_now_ns(kernel) + NS
        while True:
            batch = np.empty(TRUTH_BATCH, TRUTH_DTYPE)
            out = ffi.from_buffer("frame_truth_t[]", batch, require_writable=True)
            count = lib.kernel_read_truth(kernel, out, len(batch))
            if count:
                self._parts.append(batch[:count].copy())
            if count < len(batch):
                break
        excess = sum(map(len, self._parts)) - TRUTH_MAX
        while excess > 0:
            oldest = self._parts.popleft()
            if len(oldest) > excess:
                self._parts.appendleft(oldest[excess:])
            self.lost += min(excess, len(oldest))
            excess -= len(oldest)

    def all(self) -> NDArray[np.void]:
        """dtype TRUTH_DTYPE, oldest first, at most TRUTH_MAX."""
        whole = np.concatenate([np.empty(0, TRUTH_DTYPE), *self._parts])
        self._parts = deque([whole])
        return whole
