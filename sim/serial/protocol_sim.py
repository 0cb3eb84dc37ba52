"""sim:// for pyserial: serial.serial_for_url("sim://hover?gap8_ppm=80&pace=max").

read() runs the simulated world in the caller's thread. With pace=real true time does not get ahead of the wall time
since the world was opened; with pace=max it goes as fast as the machine, and timeouts count simulated seconds. Ports
whose URLs differ only in `robot` share one world. A robot has one port: a second one for it gets a world of its own.
pyserial finds this module once serial.protocol_handler_packages has "sim.serial".
"""

from __future__ import annotations

import json
import threading
import time
import weakref
from typing import Any

from serial.serialutil import PortNotOpenError, SerialBase, SerialException, SerialTimeoutException, to_bytes

from sim import scenario
from sim.robot import Robot
from sim.world import World

NS = 1_000_000_000
STEP_NS = NS // 50
"""The world runs this far, at most, before other threads get their turn."""
GATHER_NS = NS // 200
"""What a read may wait for when something is there and means nothing yet."""
LOOK_NS = NS // 1000
"""What a look at in_waiting costs with pace=max: who only looks must not wait for ever."""
SLEEP_S = 0.002
AHEAD_BYTES = 32 << 10
"""With pace=max a reader waits when another one has left this much unread."""
LOOK_S = 0.01
AHEAD_S = 1.0
"""But not longer than this: then that reader is slow, and its robot notices."""

GONE = "the robot has closed the connection: its ESP32 or its Wi-Fi has gone"
FRAMINGS = {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}


class Shared:
    """One world and the ports that it is open on."""

    def __init__(self, key: str, made: scenario.Scenario) -> None:
        self.key = key
        self.changed = threading.Condition(threading.RLock())
        """Held for every use of the world; notified when something was read."""
        self.world = World(made, lock=self.changed)
        self.ports: weakref.WeakSet[Serial] = weakref.WeakSet()
        self.opened_s = time.monotonic()

    def allowed_ns(self) -> int:
        """True time that pace=real may have reached by now."""
        return round((time.monotonic() - self.opened_s) * NS)


_worlds: weakref.WeakSet[Shared] = weakref.WeakSet()
"""Kept alive by their ports alone."""
_opening = threading.Lock()


def share(made: scenario.Scenario) -> Shared:
    """An open world of this scenario whose robot is free, or a new one."""
    key = json.dumps([made.name, {**made.values, "robot": 0}], sort_keys=True)
    for each in _worlds:
        if each.key == key and all(port.robot != made.robot for port in each.ports):
            return each
    shared = Shared(key, made)
    _worlds.add(shared)
    return shared


class Serial(SerialBase):  # type: ignore[misc]
    """One robot's host end. Speed, parity and control lines have no meaning here and are ignored."""

    is_open: bool

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.framing = "tcp"
        """What the bytes are: "tcp", "cpx-uart" or "stamps"."""
        self.robot = 0
        """Its number in the world."""
        self.world: World | None = None
        """Set when opened, and kept after closing: its truth and its counters."""
        self.reader: threading.Thread | None = None
        """Thread that has read last."""
        self._shared: Shared | None = None
        self._pace = "real"
        self._cancelled = False
        self._was_connected = False
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """LocalError when the URL cannot be used."""
        if self._port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        made = scenario.from_url(self._port)
        with _opening:
            self._shared = share(made)
            self.robot = made.robot
            self._shared.ports.add(self)
        self.world = self._shared.world
        self.framing = FRAMINGS[made.robots[made.robot].wire]
        self.reader = None
        self._pace = made.pace
        self._cancelled = self._was_connected = False
        self._end.read()  # what a port before this one had left
        self._end.connect()
        self.is_open = True

    def close(self) -> None:
        """The robot sees the host go. The world ends with its last port."""
        shared, self._shared = getattr(self, "_shared", None), None
        if not self.is_open or shared is None:
            return
        self.is_open = False
        with _opening:
            shared.ports.discard(self)
            if not shared.ports:
                _worlds.discard(shared)
        with shared.changed:
            if not shared.world.closed:
                shared.world.robots[self.robot].disconnect()
                if not shared.ports:
                    shared.world.land()
            shared.changed.notify_all()

    def clock_ns(self) -> int:
        """True time of this port's world."""
        if self.world is None:
            raise PortNotOpenError
        return self.world.now_ns

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read now."""
        shared = self._open()
        if not self._end.available:
            self._run(shared, None, 1, LOOK_NS)
        return self._end.available

    def read(self, size: int = 1) -> bytes:
        """As many bytes, or fewer after `timeout` simulated seconds, cancel_read or close."""
        return self._read(size, size, size)

    def read_some(self, wanted: int) -> bytes:
        """What is there once something is; for `wanted` bytes it waits GATHER_NS more, at most."""
        return self._read(1, None, wanted)

    def _read(self, size: int, most: int | None, wanted: int) -> bytes:
        shared = self._open()
        self.reader = threading.current_thread()
        deadline_ns = self._deadline_ns(shared, self._timeout)
        out = bytearray()
        while True:
            with shared.changed:
                got = self._end.read(None if most is None else most - len(out))
                if got:
                    out += got
                    shared.changed.notify_all()
            if len(out) >= size or self._cancelled or not self.is_open:
                break
            if not got and self._gone():
                if out:
                    break
                raise SerialException(GONE)
            if deadline_ns is not None and shared.world.now_ns >= deadline_ns:
                break
            self._run(shared, deadline_ns, wanted - len(out), STEP_NS if wanted == size else GATHER_NS)
        self._cancelled = False
        return bytes(out)

    def write(self, data: bytes) -> int:
        """All of it, or after `write_timeout` simulated seconds as much as was taken; if that is nothing,
        SerialTimeoutException."""
        shared = self._open()
        data = to_bytes(data)
        deadline_ns = self._deadline_ns(shared, self._write_timeout)
        sent = self._end.write(data)
        while sent < len(data):
            if self._gone():
                raise SerialException(GONE)
            if deadline_ns is not None and shared.world.now_ns >= deadline_ns:
                if sent:
                    return sent
                raise SerialTimeoutException("Write timeout")
            self._run(shared, None, 0, LOOK_NS)
            sent += self._end.write(data[sent:])
        return sent

    def reset_input_buffer(self) -> None:
        """Throws away what has come and was not read."""
        self._open()
        self._end.read()

    def reset_output_buffer(self) -> None:
        """Nothing: what was written has left."""
        self._open()

    def flush(self) -> None:
        """Likewise."""
        self._open()

    def cancel_read(self) -> None:
        """Ends a read under way in another thread, or the next one."""
        self._cancelled = True

    def _reconfigure_port(self) -> None:
        """pyserial calls it after each change of a setting."""

    def _update_rts_state(self) -> None:
        """Likewise, and the next two."""

    def _update_dtr_state(self) -> None:
        pass

    def _update_break_state(self) -> None:
        pass

    def is_behind(self) -> bool:
        """A thread reads here, and has left much unread."""
        alive = self.is_open and self.reader is not None and self.reader.is_alive()
        return alive and self._end.available > AHEAD_BYTES

    @property
    def _end(self) -> Robot:
        if self.world is None:
            raise PortNotOpenError
        return self.world.robots[self.robot]

    def _open(self) -> Shared:
        if not self.is_open or self._shared is None:
            raise PortNotOpenError
        return self._shared

    def _gone(self) -> bool:
        connected = self._end.connected
        self._was_connected |= connected
        return self._was_connected and not connected

    def _deadline_ns(self, shared: Shared, timeout: float | None) -> int | None:
        if timeout is None:
            return None
        now_ns = shared.world.now_ns
        # A caller that was away for long does not count the time that the world has to catch up.
        return (max(now_ns, shared.allowed_ns()) if self._pace == "real" else now_ns) + round(timeout * NS)

    def _run(self, shared: Shared, until_ns: int | None, size: int, step_ns: int) -> None:
        """Lets some time pass, or waits until it may; ends early when `size` bytes are there (0: never)."""
        if self._pace == "max":
            self._wait_for_others(shared)
            if size and self._end.available:
                return
        with shared.changed:
            now_ns = shared.world.now_ns
            target_ns = now_ns + step_ns
            if until_ns is not None:
                target_ns = min(target_ns, until_ns)
            if self._pace == "real":
                target_ns = min(target_ns, shared.allowed_ns())
            if target_ns > now_ns:
                wanted = min(size, AHEAD_BYTES)
                shared.world.run_until(target_ns, self.robot if wanted else -1, max(wanted, 1))
                shared.changed.notify_all()
                return
        time.sleep(SLEEP_S)

    def _wait_for_others(self, shared: Shared) -> None:
        """So that a thread that reads one robot does not leave behind the thread that reads another."""
        own = threading.current_thread()
        with shared.changed:
            for other in list(shared.ports):
                if other.reader in (None, own):
                    continue
                waited_s = 0.0
                # Whoever has something to read goes and reads it: no two wait for each other.
                while other.is_behind() and not self._end.available:
                    if waited_s >= AHEAD_S:
                        other.reader = None  # until it reads again
                        break
                    shared.changed.wait(LOOK_S)
                    waited_s += LOOK_S
