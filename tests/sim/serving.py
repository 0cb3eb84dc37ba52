"""Served worlds and their clients, for tests."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from host.link.frame import Frame
from host.link.session import Session
from sim import scenario
from sim.robot import Robot
from sim.serial.doors import PtyDoor, TcpDoor
from sim.serial.serve import Server
from sim.world import World


@contextlib.contextmanager
def served(name: str = "hover", *, pty: bool = False, **settings: object) -> Iterator[Server]:
    """A server in a thread of its own, on ports that are free; at the end its world is at rest and readable."""
    if pty:
        settings.setdefault("wire", "uart2")
    made = scenario.load(name, **{"pace": "max", **settings})
    with contextlib.ExitStack() as opened:
        doors = [PtyDoor() if pty else TcpDoor("127.0.0.1", 0) for _ in made.robots]
        for door in doors:
            opened.callback(door.close)
        happened = []
        server = Server(made, doors, trace="hash", keep_log=True, report=happened.append)
        server.happened = happened
        opened.callback(server.close)
        thread = threading.Thread(target=server.run)
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join(timeout=30)
            assert not thread.is_alive()


def connected(server: Server, robot: int = 0) -> socket.socket:
    return socket.create_connection(("127.0.0.1", server.stations[robot].door.port), timeout=30)


def whats(server: Server) -> list[str]:
    return [each.what for each in server.happened]


def replayed(server: Server, monkeypatch: pytest.MonkeyPatch) -> tuple[World, dict[int, bytearray]]:
    """The served world's log, run again in-process: its world, and all that each robot's host has read."""
    read: dict[int, bytearray] = {}
    original = Robot.read

    def keep(self: Robot, size: int | None = None) -> bytes:
        data = original(self, size)
        read.setdefault(self.index, bytearray()).extend(data)
        return data

    with monkeypatch.context() as patched:
        patched.setattr(Robot, "read", keep)
        return World.replay(server.world.log), read


class Listener:
    """A client with our own session; keeps every byte that came."""

    def __init__(self, connection: socket.socket, dialect: str = "native", framing: str = "tcp") -> None:
        self.connection = connection
        self.session = Session(framing, dialect)
        self.came = bytearray()
        self.frames: list[Frame] = []
        self.now_ns = 0

    def listen(self, count: int) -> list[Frame]:
        """Until so many frames are there, or the end."""
        while len(self.frames) < count:
            data_to_send = self.session.data_to_send()
            if data_to_send:
                self.connection.sendall(data_to_send)
            data = self.connection.recv(1 << 16)
            if not data:
                break
            self.came += data
            self.now_ns += 1_000_000
            events = self.session.receive(data, self.now_ns)
            self.frames += [event for event in events if isinstance(event, Frame)]
        return self.frames
