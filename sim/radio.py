"""The radio of a host that broadcasts to all robots of a world: nobody acknowledges, each hears for itself or not.

A robot hears a broadcast, or not, and later by a fixed time and by an exponential delay of its own: from the host's
antenna to the moment when a task of the robot has the packet. The host's clock is the true time, from HOST_START_US on.
"""

from __future__ import annotations

import heapq
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from host.native import lib
from host.protocol.errors import LocalError

from .settings import General, RobotSettings

if TYPE_CHECKING:
    from .world import World

BEACON = struct.Struct("<BBIQ")
BEACON_HEAD = 0xD2, 0x62
RESET = b"\x23\0usec\0reset\0\x08\x01"
"""The parameter usec.reset, set to 1 by its name."""
HOST_START_US = 1 << 33
REPEAT_NS = 1_000_000
"""From one reset to the next, when it is repeated."""
STREAM = 0x5261
"""Of the random numbers."""
OTHERS_STREAM = 0x526F
"""Of those for what is broadcast from outside: it changes nothing for what the scenario has."""
NEVER_NS = 1 << 62
OTHER = -1
"""Number of a broadcast from outside."""


@dataclass(frozen=True, slots=True, order=True)
class Heard:
    at_ns: int
    """True time."""
    robot: int
    packet: bytes
    number: int
    """Of the broadcast among its like."""


class Radio:
    """Beacons and a reset, as the scenario has them."""

    def __init__(self, general: General, robots: tuple[RobotSettings, ...]) -> None:
        self.general = general
        self.robots = robots
        self.heard_resets: list[list[int]] = [[] for _ in robots]
        """By robot: which of the repeats."""
        self._random = [np.random.default_rng([general.seed, STREAM, robot]) for robot in range(len(robots))]
        self._others = [np.random.default_rng([general.seed, OTHERS_STREAM, robot]) for robot in range(len(robots))]
        self.heard_others = [0 for _ in robots]
        """By robot: packets that were broadcast from outside, without resets."""
        self._broadcasts = self._all()
        self._coming: list[Heard] = []
        self._ahead: tuple[int, bytes, int] | None = next(self._broadcasts, None)

    @property
    def next_ns(self) -> int:
        """True time at which a robot hears something next; NEVER_NS."""
        # What is broadcast later is heard later than that, so it cannot come before what is heard until then.
        while self._ahead is not None and (not self._coming or self._coming[0].at_ns >= self._ahead[0]):
            for heard in self._hear(*self._ahead, self._random):
                heapq.heappush(self._coming, heard)
            self._ahead = next(self._broadcasts, None)
        return self._coming[0].at_ns if self._coming else NEVER_NS

    def broadcast(self, now_ns: int, packet: bytes) -> None:
        """From outside, now."""
        for heard in self._hear(now_ns, packet, OTHER, self._others):
            heapq.heappush(self._coming, heard)

    def deliver(self, world: World, now_ns: int) -> None:
        """All that is heard by now."""
        while self.next_ns <= now_ns:
            heard = heapq.heappop(self._coming)
            self.heard_others[heard.robot] += heard.number == OTHER and heard.packet != RESET
            if heard.packet == RESET:
                # In the Crazyflie a task of its firmware does this; here the stamp clock is the board's.
                lib.kernel_reset_stamp_clock(world.kernel, heard.robot, lib.MCU_STM32, 0)
                self.heard_resets[heard.robot].append(heard.number)
            elif lib.kernel_radio(world.kernel, heard.robot, heard.packet, len(heard.packet)) < 0:
                raise LocalError(f"robot {heard.robot} runs an image, which has no radio: backend=native")

    def _all(self) -> Iterator[tuple[int, bytes, int]]:
        """(true time, packet, number) of each broadcast, in order, without end if there are beacons."""
        general = self.general
        resets = [
            (round(general.reset_s * 1e9) + each * REPEAT_NS, RESET, each)
            for each in range(general.reset_repeats if general.reset_s else 0)
        ]
        yield from heapq.merge(resets, self._beacons()) if general.beacon_hz else resets

    def _beacons(self) -> Iterator[tuple[int, bytes, int]]:
        number = 0
        while True:
            number += 1
            at_ns = round(number * 1e9 / self.general.beacon_hz)
            sequence = number % (1 << 32)
            yield at_ns, BEACON.pack(*BEACON_HEAD, sequence, HOST_START_US + at_ns // 1000), number

    def _hear(self, at_ns: int, packet: bytes, number: int, randoms: list[np.random.Generator]) -> Iterator[Heard]:
        for robot, (settings, random) in enumerate(zip(self.robots, randoms, strict=True)):
            radio = settings.radio
            lost = random.random() < radio.loss
            late_us = radio.latency_us + float(random.exponential(radio.jitter_us))
            if not lost:
                yield Heard(at_ns + round(late_us * 1000), robot, packet, number)
