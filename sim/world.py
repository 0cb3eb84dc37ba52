"""A simulated world and its robots, as Python sees them: run it, read and write, let things go wrong, know the truth.

Everything that comes from outside, from a connection to a fault, is logged with its true time; World.replay makes
the same run from the log.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from host.native import ffi, lib
from host.protocol.errors import LocalError, PeerError

from . import camera, configure, emulated, scenario
from .albums import Albums
from .captures import Captures
from .images import Image
from .journal import Journal, Record
from .possible import check_robot
from .radio import Radio
from .receiver import Dialect, Receiver
from .replay import repeat
from .robot import Robot
from .settings import RobotSettings
from .storage import Storage
from .trace import Run, take

NS = 1_000_000_000
SLICE_NS = NS // 10
"""The kernel is called for at most this much, so that Ctrl-C and other threads get their turn."""
LISTEN_NS = NS // 200
"""Receivers read this often."""
END = 1 << 62
"""Of a log: after everything else."""

Trace = Literal["off", "hash", "full"]
TRACES = {"off": lib.TRACE_OFF, "hash": lib.TRACE_HASH, "full": lib.TRACE_FULL}


class Kernel:
    """Owns a kernel_t. The pointer is None once it is freed: when garbage is collected, a port may be closed later."""

    def __init__(self, seed: int) -> None:
        self.pointer: Any = None
        pointer = lib.kernel_new(seed)
        if pointer == ffi.NULL:
            raise MemoryError
        self.pointer = pointer

    def free(self) -> None:
        if self.pointer is not None:
            lib.kernel_free(self.pointer)
            self.pointer = None

    def __del__(self) -> None:
        self.free()


class World:
    """Robots under one true time. Not for several threads, unless `lock` is a lock."""

    def __init__(
        self,
        source: str | scenario.Scenario = "hover",
        *,
        trace: Trace = "off",
        lock: AbstractContextManager[Any] | None = None,
        keep_log: bool = True,
        images: Mapping[str, str | Path] | None = None,
        **overrides: object,
    ) -> None:
        """A scenario, or its name and keys that override it. LocalError if it is impossible.

        A world that runs for days is better off with keep_log=False: a log grows with all that the host sends.
        `images`: ELF files by MCU ("stm32", "gap8"), which those MCUs of every robot run, whatever `backend` says.
        """
        source = scenario.load(source, **overrides) if isinstance(source, str) else source.changed(overrides)
        if trace not in TRACES:
            raise LocalError(f"trace={trace}: allowed is {' | '.join(TRACES)}")
        self.scenario = source
        self.trace = trace
        self.lock = nullcontext() if lock is None else lock
        self._captures = Captures()
        self._albums = Albums(source.seed)
        self.pictures: dict[int, camera.Pictures] = {}
        """What each robot's camera shows, of those that have one."""
        self._given = dict(images or {})
        self._images: dict[tuple[int, str], Image] = {}
        """What is emulated, by robot and MCU; the kernel keeps their addresses."""
        self.storages: list[Storage] = []
        """The kernel has their addresses: they must live as long as it."""
        self._kernel = Kernel(source.seed)
        lib.kernel_trace(self.kernel, TRACES[trace])
        self.robots = tuple(self._add(index, settings) for index, settings in enumerate(source.robots))
        self._journal = (
            Journal([configure.unread_bytes_max(robot.settings) for robot in self.robots]) if keep_log else None
        )
        self.radio = Radio(source.general, source.robots)
        self._receivers: list[Receiver] = []
        self._closed_log: list[Record] | None = None

    def _add(self, index: int, settings: RobotSettings) -> Robot:
        pictures, views = self._albums.of(settings) if settings.camera.fps else (None, [])
        if pictures is not None:
            own = dataclasses.replace(settings.camera, width=pictures.width, height=pictures.height)
            settings = dataclasses.replace(settings, camera=own)
            check_robot(settings)
        result = lib.kernel_add_robot(self.kernel, configure.robot_config(settings, self.scenario.seed, index))
        if result == lib.KERNEL_ERR_MEMORY:
            raise MemoryError
        if result != index:
            raise LocalError(f"robot {index}: the simulator refuses this scenario: {settings}")
        if pictures is not None:
            self.pictures[index] = pictures
            result = lib.kernel_set_images(self.kernel, index, *views, len(pictures.raw))
            if result < 0:
                raise MemoryError
        runs = emulated.images_of(settings, self._given)
        for mcu, image in runs.items():
            emulated.emulate(self.kernel, index, mcu, image)
            self._images[index, mcu] = image
        robot = Robot(self, index, settings, runs)
        if settings.usd.config:
            robot.put_card(configure.card_seed(self.scenario.seed, index), len(self.scenario.robots))
        return robot

    @property
    def kernel(self) -> Any:
        """kernel_t *; LocalError after close."""
        if self.closed:
            raise LocalError("this world is closed")
        return self._kernel.pointer

    @property
    def closed(self) -> bool:
        return self._kernel.pointer is None

    @property
    def now_ns(self) -> int:
        """True time."""
        with self.lock:
            return int(lib.kernel_now_ns(self.kernel))

    @property
    def seconds(self) -> float:
        """True time."""
        return self.now_ns / NS

    def run(self, seconds: float) -> None:
        """Lets this much true time pass."""
        if not (math.isfinite(seconds) and seconds >= 0):
            raise LocalError(f"seconds={seconds}: allowed is 0 and more")
        end_ns = self.now_ns + round(seconds * NS)
        while self._receivers and self.now_ns < end_ns:
            self.run_until(min(end_ns, self.now_ns + LISTEN_NS))
            for receiver in self._receivers:
                receiver.poll()
        self.run_until(end_ns)

    def listen(self, robot: int = 0, dialect: Dialect = "native") -> Receiver:
        """That robot with a host that reads and decodes whenever run() lets time pass."""
        if not 0 <= robot < len(self.robots):
            raise LocalError(f"robot {robot}: this world has 0 .. {len(self.robots) - 1}")
        self._receivers.append(Receiver(self, robot, dialect))
        return self._receivers[-1]

    def run_until(self, true_ns: int, robot: int = -1, size: int = 1) -> bool:
        """Runs until then, or until that robot's host can read `size` bytes; True if that came first."""
        while True:
            with self.lock:
                now_ns = self.now_ns
                if true_ns < now_ns:
                    raise LocalError(f"true time {true_ns} ns has passed: it is {now_ns} ns")
                stop_ns = min(true_ns, now_ns + SLICE_NS, self.radio.next_ns)
                bytes_first = self._kernel_run(stop_ns, robot, size)
                self.radio.deliver(self, self.now_ns)
                self._captures.take(self.kernel)
            if bytes_first:
                return True
            if stop_ns >= true_ns:
                return False

    @property
    def truth(self) -> NDArray[np.void]:
        """Every completed capture of every robot, dtype TRUTH_DTYPE, oldest first, at most TRUTH_MAX."""
        with self.lock:
            if not self.closed:
                self._captures.take(self.kernel, now=True)
            return self._captures.all()

    @property
    def truth_lost(self) -> int:
        """Captures that `truth` has forgotten."""
        return self._captures.lost

    def picture_numbers(self, robot: int) -> dict[int, list[int]]:
        """CRC-32 of each picture that this robot's camera shows, raw and JPEG, and its numbers in the truth."""
        own = self.pictures.get(robot)
        return {} if own is None else own.numbers

    def trace_hash(self) -> int:
        """Of all that every sender of every robot has sent; equal runs have equal hashes."""
        if self.trace == "off":
            raise LocalError("this world keeps no trace: make it with World(..., trace='hash')")
        with self.lock:
            hashes = [
                int(lib.kernel_trace_hash(self.kernel, robot.index, wire))
                for robot in self.robots
                for wire in range(lib.WIRE_COUNT)
            ]
        return functools.reduce(lambda whole, each: (whole * 0x100000001B3 ^ each) % 2**64, hashes, len(hashes))

    def take_trace(self) -> list[Run]:
        """All that has been sent since the last call, with trace="full", which keeps it until then."""
        if self.trace != "full":
            raise LocalError("this world keeps no bytes: make it with World(..., trace='full')")
        with self.lock:
            return take(self.kernel)

    def broadcast(self, packet: bytes) -> None:
        """A host sends this CRTP packet to all robots by radio, now: each hears it, later, or does not (radio_*)."""
        with self.lock:
            self.radio.broadcast(self.now_ns, packet)
            self.did("broadcast", hex=packet.hex())

    def did(self, do: str, **arguments: Any) -> None:
        """After something was done to this world from outside: logs it, and lets happen what is due at this instant.

        Without that, a later run(0) would make a difference, which no log tells.
        """
        if self._journal is not None:
            self._journal.add(self.now_ns, do, **arguments)
        self._settle()

    def did_write(self, robot: int, data: bytes) -> None:
        """As did, of what a host has sent."""
        if self._journal is not None:
            self._journal.write(self.now_ns, robot, data)
        self._settle()

    def did_read(self, robot: int, available: int, size: int) -> None:
        """As did, after a host has read."""
        if self._journal is not None:
            self._journal.read(self.now_ns, robot, available, size)
        self._settle()

    def _settle(self) -> None:
        self._kernel_run(self.now_ns, -1, 0)

    def _kernel_run(self, true_ns: int, robot: int, size: int) -> bool:
        result = lib.kernel_run(self.kernel, true_ns, robot, size)
        for storage in self.storages:
            storage.raise_error()
        if result < 0:
            if result == lib.KERNEL_ERR_IMAGE:
                raise PeerError(emulated.fault(self.kernel, self._images))
            raise MemoryError(f"kernel_run({true_ns}): {result}")
        return bool(result == lib.KERNEL_BYTES)

    @property
    def log(self) -> list[Record]:
        """The scenario, all that was done from outside, and the present time: JSON-able, for World.replay."""
        with self.lock:
            if self._closed_log is not None:
                return self._closed_log
            if self._journal is None:
                raise LocalError("this world keeps no log: make it with World(..., keep_log=True)")
            available = [robot.available for robot in self.robots]
            first = {
                "t": 0,
                "n": 0,
                "do": "world",
                "scenario": self.scenario.name,
                "values": dict(self.scenario.values),
                "trace": self.trace,
                "images": {mcu: str(path) for mcu, path in self._given.items()},
            }
            return [first, *self._journal.records(available), {"t": self.now_ns, "n": END, "do": "end"}]

    @classmethod
    def replay(cls, log: Iterable[Record]) -> World:
        """The world of `log` at its end, run anew."""
        records = list(log)
        if not records or records[0].get("do") != "world":
            raise LocalError("a log begins with its world: give World.log as it was")
        world = cls(
            scenario.Scenario.of(records[0]["scenario"], {**records[0]["values"], "usd_image": ""}),
            trace=records[0]["trace"],
            images=records[0].get("images"),
        )
        repeat(world, records[1:])
        return world

    def land(self) -> None:
        """The flight is over: robots whose card's image is kept (usd_image) close their logs, and it is written."""
        failed: Exception | None = None
        for robot in self.robots:
            try:
                robot.land()
            except Exception as error:  # The others' cards come first.
                failed = failed or error
        if failed:
            raise failed

    def close(self) -> None:
        """Frees the kernel, after land(); truth and log stay readable. May be called again."""
        with self.lock:
            if self.closed:
                return
            try:
                self.land()
            finally:
                self._captures.take(self.kernel, now=True)
                self._closed_log = None if self._journal is None else self.log
                self._kernel.free()
                self._albums.close()

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
