"""How long a card takes: the bus, and the stalls."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from .card_format import SECTOR
from .card_sectors import Command

COMMAND_BYTES: Final = 8
"""On the bus: six of the command, and the answer."""
BLOCK_BYTES: Final = 1 + SECTOR + 2 + 1
"""Token, data, CRC, the card's answer."""
STOP_BYTES: Final = 2
"""Ends a command of several blocks."""
Z_99: Final = 2.3263478740408408
"""Standard deviations above the median that 1 % of a normal distribution exceed."""
NS: Final = 1_000_000_000


class Times:
    """Stalls are log-normal: one in each request that writes sectors. No stalls with a median of 0."""

    def __init__(self, random: np.random.Generator, spi_hz: int, stall_ms: float, p99_ms: float, max_ms: float) -> None:
        self._random = random
        self._byte_ns = 8 * NS / spi_hz
        self._stall = (stall_ms, math.log(max(p99_ms / stall_ms, 1)) / Z_99, max_ms) if stall_ms else None

    def of(self, commands: Sequence[Command]) -> tuple[int, list[float]]:
        """What they take, in ns, and when each sector that they write is on the card. The stall is in one of the
        writing commands."""
        writing = [number for number, each in enumerate(commands) if each.write]
        stall_ns, stalled = self.draw_stall_ns(), -1
        if writing:
            stalled = writing[int(self._random.integers(len(writing)))]
        ends_ns: list[float] = []
        passed = 0.0
        for number, each in enumerate(commands):
            passed += COMMAND_BYTES * self._byte_ns
            for _ in range(each.count):
                passed += BLOCK_BYTES * self._byte_ns
                if each.write:
                    ends_ns.append(passed)
            if each.count > 1:
                passed += STOP_BYTES * self._byte_ns
            if number == stalled:
                passed += stall_ns
                if ends_ns:
                    ends_ns[-1] = passed
        return round(passed), ends_ns

    def draw_stall_ns(self) -> float:
        if self._stall is None:
            return 0.0
        median_ms, sigma, most_ms = self._stall
        return float(min(median_ms * math.exp(sigma * self._random.standard_normal()), most_ms)) * 1e6
