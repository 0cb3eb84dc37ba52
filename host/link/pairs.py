"""Stamp messages that came in pairs messages and wait for the frame that carries them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import assemble
from .frame import PAIR_DTYPE

PAIRS_KEPT = 8192
"""At most: 80 s of them."""


class Pairs:
    def __init__(self) -> None:
        self.received = 0
        self._waiting: list[NDArray[np.void]] = []
        self._count = 0
        self._dropped = 0
        self._lost_gap8: tuple[int, int] | None = None
        """What the GAP8 counted first and last."""

    def take(self, message: bytes) -> None:
        """A native pairs message that the C has found good."""
        pairs, lost = assemble.pairs(message)
        self._lost_gap8 = (lost if self._lost_gap8 is None else self._lost_gap8[0], lost)
        self.received += len(pairs)
        self._waiting.append(pairs)
        self._count += len(pairs)
        while self._count > PAIRS_KEPT:
            oldest = len(self._waiting.pop(0))
            self._count -= oldest
            self._dropped += oldest

    def give(self) -> NDArray[np.void]:
        """All that wait: the frame has come."""
        given, self._waiting, self._count = self._waiting, [], 0
        return np.concatenate(given) if given else np.empty(0, PAIR_DTYPE)

    @property
    def lost(self) -> int:
        """By the GAP8, since the first message; and here, for want of a frame."""
        return self._dropped + (0 if self._lost_gap8 is None else self._lost_gap8[1] - self._lost_gap8[0])
