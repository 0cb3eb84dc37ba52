"""Served robots: each behind a door of its own, for clients that know nothing of the simulator.

One thread and no waiting but in select: a client that reads slowly, or has vanished, holds up neither the world nor
another robot's client. What it does not take stays in the robot, whose TCP window closes, and which then drops whole
frames. True time is 0 until the first client comes; what clients send enters at the true time of that moment and is
logged with it, so that World.replay gives the same bytes again.
"""

from __future__ import annotations

import select
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

from sim.robot import Robot
from sim.scenario import Scenario
from sim.world import Trace, World

from .doors import Client, Door

NS = 1_000_000_000
STEP_NS = NS // 200
"""The world runs this far, at most, before clients get what has come for them."""
CREDIT_STEP_NS = NS // 2000
"""Likewise on UART2, where each packet waits for the client's credit for the one before."""
LATE_NS = NS
"""A computer that was away for longer, asleep say, does not catch up: time has stood still for the robots too."""
WAIT_S = 0.005
LOOK_S = 0.05
"""How often doors and stop() are looked at while time stands still."""
CHUNK_BYTES = 65536
AHEAD_BYTES = 32 << 10
"""With pace=max the world waits for a client that has so much to take,"""
AHEAD_S = 1.0
"""but not longer than this since it last took something."""
STUCK_S = 5.0
"""A client that has taken nothing for so long, with bytes waiting for it, must make room when another one comes."""


@dataclass(frozen=True)
class Happening:
    """Something that a person may want to know of."""

    what: Literal["came", "went", "refused", "replaced", "ended"]
    """refused: another client is there already; ended: by the robot."""
    robot: int
    client: str
    true_ns: int


@dataclass
class Station:
    """One robot, its door, and its client if it has one."""

    robot: Robot
    door: Door
    client: Client | None = None
    from_client: bytes = b""
    """Received, and not yet taken by the robot."""
    to_client: memoryview = field(default_factory=lambda: memoryview(b""))
    """Left the robot, and not yet taken by the client."""
    was_connected: bool = False
    moved_s: float = 0.0
    """When the client last took something, or had nothing to take."""
    clients: int = 0
    refused: int = 0
    bytes_to_clients: int = 0
    bytes_from_clients: int = 0


class Server:
    """Serves a world until stop(). run() belongs to one thread; stop() and reading the counters to any."""

    def __init__(
        self,
        scenario: Scenario,
        doors: Sequence[Door],
        *,
        trace: Trace = "off",
        keep_log: bool = False,
        report: Callable[[Happening], None] = lambda _: None,
    ) -> None:
        """One door for each robot, which whoever opened it closes. LocalError if the scenario is impossible."""
        self.world = World(scenario, trace=trace, keep_log=keep_log)
        self.pace = scenario.pace
        self.step_ns = CREDIT_STEP_NS if any(robot.wire == "uart2" for robot in scenario.robots) else STEP_NS
        self.stations = [Station(robot, door) for robot, door in zip(self.world.robots, doors, strict=True)]
        self.times_late = 0
        """How often this computer was too slow, or away, and time stood still."""
        self._report = report
        self._stopping = False
        self._started_ns: int | None = None
        """Wall time at which true time was 0."""

    def run(self) -> None:
        """Until stop(), or an exception such as KeyboardInterrupt."""
        while not self._stopping:
            self._wait()
            self._let_time_pass()
            for station in self.stations:
                self._look_at_door(station)
                self._take(station)
                self._give(station)

    def stop(self) -> None:
        """From any thread; run() returns within LOOK_S."""
        self._stopping = True

    def close(self) -> None:
        """Sends everybody away. The world stays readable: its log, its truth, its counters."""
        for station in self.stations:
            if station.client is not None:
                station.client.close()
        if not self.world.closed:
            self.world.land()

    def _wait(self) -> None:
        """Until something can be done: a step of time, something from a client, room for something to a client."""
        readers: list[int] = []
        writers: list[int] = []
        for station in self.stations:
            number = station.door.fileno()
            if number is not None:
                readers.append(number)
            if station.client is not None:
                if not station.from_client:
                    readers.append(station.client.fileno())
                if station.to_client:
                    writers.append(station.client.fileno())
        select.select(readers, writers, [], self._patience_s())

    def _patience_s(self) -> float:
        if self._started_ns is None:
            return LOOK_S
        if self.pace == "real":
            ahead_ns = self.world.now_ns + self.step_ns - (time.monotonic_ns() - self._started_ns)
            return min(max(0, ahead_ns), self.step_ns) / NS
        if all(station.client is None for station in self.stations):
            return LOOK_S
        return WAIT_S if self._must_wait() else 0.0

    def _let_time_pass(self) -> None:
        if self._started_ns is None:
            return
        now_ns = self.world.now_ns
        if self.pace == "max":
            if not self._must_wait():
                self.world.run_until(now_ns + self.step_ns)
            return
        due_ns = time.monotonic_ns() - self._started_ns
        if due_ns - now_ns > LATE_NS:
            self.times_late += 1
            self._started_ns += due_ns - now_ns
            due_ns = now_ns
        if due_ns > now_ns:
            self.world.run_until(min(due_ns, now_ns + self.step_ns))

    def _must_wait(self) -> bool:
        """With pace=max: nobody is there, or somebody is behind, and has not been so for long."""
        now_s = time.monotonic()
        there = [station for station in self.stations if station.client is not None]
        return not there or any(
            len(station.to_client) + station.robot.available > AHEAD_BYTES and now_s - station.moved_s < AHEAD_S
            for station in there
        )

    def _look_at_door(self, station: Station) -> None:
        came = station.door.accept()
        if came is None:
            return
        if station.client is not None:
            if not station.to_client or time.monotonic() - station.moved_s < STUCK_S:
                station.refused += 1
                came.close()
                self._happened("refused", station, came)
                return
            self._leave(station, "replaced")
        if self._started_ns is None:
            self._started_ns = time.monotonic_ns()
        station.client = came
        station.clients += 1
        station.moved_s = time.monotonic()
        station.robot.read()  # on a UART: what nobody was there to hear
        station.robot.connect()
        self._happened("came", station, came)

    def _take(self, station: Station) -> None:
        """From the client to the robot."""
        if station.client is None:
            return
        if not station.from_client:
            received = station.client.receive(CHUNK_BYTES)
            if received == b"":
                self._leave(station, "went")
                return
            station.from_client = received or b""
            station.bytes_from_clients += len(station.from_client)
        if station.from_client:
            station.from_client = station.from_client[station.robot.write(station.from_client) :]

    def _give(self, station: Station) -> None:
        """From the robot to the client."""
        if station.client is None:
            if station.robot.settings.wire != "tcp":
                station.robot.read()
            return
        connected = station.robot.connected
        ended = station.was_connected and not connected
        station.was_connected = connected
        try:
            while True:
                if not station.to_client:
                    station.moved_s = time.monotonic()
                    station.to_client = memoryview(station.robot.read(CHUNK_BYTES))
                if not station.to_client:
                    break
                sent = station.client.send(station.to_client)
                if not sent:
                    break
                station.moved_s = time.monotonic()
                station.bytes_to_clients += sent
                station.to_client = station.to_client[sent:]
        except OSError:
            self._leave(station, "went")
            return
        if ended:
            self._leave(station, "ended")

    def _leave(self, station: Station, what: Literal["went", "replaced", "ended"]) -> None:
        client, station.client = station.client, None
        assert client is not None
        client.close()
        station.from_client = b""
        station.to_client = memoryview(b"")
        station.was_connected = False
        station.robot.disconnect()
        station.robot.read()  # nothing of this connection is for the next client
        self._happened(what, station, client)

    def _happened(self, what: Literal["came", "went", "refused", "replaced", "ended"], at: Station, by: Client) -> None:
        self._report(Happening(what, at.robot.index, by.name, self.world.now_ns))
