"""The radio of a host that broadcasts to all robots of a world: nobody acknowledges, each hears for itself or not.

A broadcast leaves the host late by `host_delay_us`, the same for all robots. Each robot hears it, or not, on its own,
and later by `floor_us` and an exponential delay of its own, from its radio chip to the moment when a task has it.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .world import World

BEACON = struct.Struct("<BBIQ")
BEACON_HEAD = 0xD2, 0x62
RESET = b"\x23\0usec\0reset\0\x08\x01"
"""The parameter usec.reset, set to 1 by its name."""
NS_US = 1000


@dataclass(frozen=True, slots=True)
class Air:
    """How broadcasts fare."""

    delay_us: float = 300.0
    """Mean of each robot's own delay."""
    floor_us: float = 250.0
    loss: float = 0.0
    """Probability that a robot does not hear one, each by itself."""
    host_delay_us: float = 0.0
    """Mean of an exponential delay between the host's reading of its clock and the air."""


class Radio:
    """Of a host whose clock is the true time, from `host_start_us` on."""

    def __init__(self, world: World, air: Air | None = None, *, seed: int = 1, host_start_us: int = 1 << 33) -> None:
        self.world = world
        self.air = air or Air()
        self.host_start_us = host_start_us
        self.sequence = 0
        self._random = np.random.default_rng([world.scenario.seed, seed])

    def beacons(self, seconds: float, hz: float = 1.0) -> None:
        """Lets so much time pass, and broadcasts the host's clock meanwhile."""
        start_ns = self.world.now_ns
        heard = []
        for each in range(int(seconds * hz)):
            at_ns = start_ns + round(each * 1e9 / hz)
            host_us = self.host_start_us + at_ns // NS_US
            heard += self._hears(BEACON.pack(*BEACON_HEAD, self.sequence, host_us), at_ns)
            self.sequence += 1
        self._deliver(heard, start_ns + round(seconds * 1e9))

    def reset(self, repeats: int = 1, every_us: int = 1000) -> list[list[int]]:
        """Broadcasts that all stamp clocks start from 0, so many times; and which of these each robot has heard."""
        start_ns = self.world.now_ns
        heard = []
        numbers: list[list[int]] = [[] for _ in self.world.robots]
        for each in range(repeats):
            came = self._hears(RESET, start_ns + each * every_us * NS_US)
            heard += came
            for _, robot, _ in came:
                numbers[robot].append(each)
        self._deliver(heard, start_ns)
        return numbers

    def _hears(self, packet: bytes, at_ns: int) -> list[tuple[int, int, bytes]]:
        """(true time, robot, packet) of each robot that will hear it."""
        air = self.air
        sent_ns = at_ns + round(self._exponential(air.host_delay_us) * NS_US)
        late = [air.floor_us + self._exponential(air.delay_us) for _ in self.world.robots]
        lost = [self._random.random() < air.loss for _ in self.world.robots]
        return [
            (sent_ns + round(late[robot] * NS_US), robot, packet)
            for robot in range(len(self.world.robots))
            if not lost[robot]
        ]

    def _exponential(self, mean: float) -> float:
        return float(self._random.exponential(mean))

    def _deliver(self, heard: Sequence[tuple[int, int, bytes]], until_ns: int) -> None:
        for at_ns, robot, packet in sorted(heard):
            self.world.run_until(max(at_ns, self.world.now_ns))
            if packet == RESET:
                # In the Crazyflie a task of its firmware does this; here the stamp clock is the board's.
                self.world.robots[robot].reset_stamp_clock("stm32")
            else:
                self.world.robots[robot].radio(packet)
        self.world.run_until(max(until_ns, self.world.now_ns))
