"""Where bytes come from: the only I/O and the only wall clock of this package. A port reads and writes; a Stream is a
port and a session, and what `host.open` returns.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, Protocol, cast
from urllib.parse import quote, urlsplit

from ..protocol.errors import LocalError, PeerSilentError
from ..protocol.packets import CameraSettings
from .access import why
from .dialects import Dialect
from .records import Event, Frame, LostFrame, NanocockpitStamp, PaperStamp, SessionCounters, Stamp, State
from .session import FRAMINGS, Framing, Session
from .state import Backoff, Watch

POLL_S = 0.1
"""A read waits this long at most, so that Ctrl-C, close() and repeated requests are never held up."""
CONNECT_S = 5.0
RECEIVE_BYTES = 1 << 18
TCP_PORT = 5000
ALIVE = (Frame, LostFrame, Stamp, PaperStamp, NanocockpitStamp)
"""What a robot is there for: without any of these it is called silent, whatever else it sends."""
HANDLERS = ("sim.serial", "host.link.serial")
"""Where pyserial finds sim:// and replay://."""
GARBAGE_MOST = 0.5
"""Of the bytes: with more, what looks like packets is chance."""
BAUD: dict[str, int] = {"cpx-uart": 576_000, "stamps": 115_200, "tcp": 576_000}


class Port(Protocol):
    """One open connection."""

    url: str
    framing: Framing
    world: Any
    """The simulated world behind it, or None."""
    robot: Any
    """Which robot of that world."""
    baud: int | None
    """Of a serial line; None: there is none in between that could be wrong."""
    ended: str
    """Why the last read said that it was the end; empty when a recording is over."""

    def read(self, wanted: int) -> bytes | memoryview | None:
        """What has come: valid until the next read. None: nothing for POLL_S. Empty: nothing ever will again.
        A slow line waits until there are `wanted` bytes, or less after POLL_S; more are taken if they are there."""

    def write(self, data: bytes) -> None:
        """Sends, or keeps what the line does not take now until the next call."""

    def clock_ns(self) -> int:
        """Monotonic; of a simulated port its true time."""

    def close(self) -> None:
        """At once, and for good."""


class Tap(Protocol):
    """Is shown everything that passes, in its order, by the thread that reads."""

    def received(self, data: bytes | memoryview, arrival_host_ns: int) -> None:
        """What one read gave: valid until this returns."""

    def sent(self, data: bytes, now_ns: int) -> None:
        """What was handed to the port."""

    def event(self, event: Event) -> None:
        """What the session made of it."""

    def connected_again(self, now_ns: int) -> None:
        """What is received from here on is of a new connection."""


class SocketPort:
    """The robot's TCP server. Reads go into one buffer that is used again: no allocation, and it stays in the cache."""

    world = None
    robot = None
    baud: int | None = None

    def __init__(self, url: str) -> None:
        self.url = url
        self.framing: Framing = "tcp"
        self.ended = ""
        self._socket = connect(url)
        self._buffer = memoryview(bytearray(RECEIVE_BYTES))
        self._unsent = b""

    def read(self, wanted: int) -> memoryview | None:
        try:
            size = self._socket.recv_into(self._buffer)
        except TimeoutError:
            return None
        except OSError as error:
            self.ended = f"the connection broke: {error.strerror}"
            return self._buffer[:0]
        if not size:
            self.ended = "closed by the robot"
        return self._buffer[:size]

    def write(self, data: bytes) -> None:
        self._unsent += data
        try:
            self._unsent = self._unsent[self._socket.send(self._unsent) :]
        except TimeoutError:
            return
        except OSError:
            # A broken connection is the next read's news, behind what has come before it broke.
            self._unsent = b""

    def clock_ns(self) -> int:
        return time.monotonic_ns()

    def close(self) -> None:
        self._socket.close()


class SerialPort:
    """Whatever pyserial opens, simulated robots included."""

    def __init__(self, url: str, port: Any, framing: Framing, baud: int) -> None:
        self.url = url
        self.framing = framing
        self.ended = ""
        self.world = getattr(port, "world", None)
        self.baud: int | None = None if hasattr(port, "clock_ns") else baud
        self.robot = getattr(port, "robot", None)
        self.epoch_ns: int | None = getattr(port, "epoch_ns", None)
        """Of a replay: what its recording added to clock_ns() to get dates."""
        self.dialect: Dialect = getattr(port, "dialect", "auto")
        """Of a replay: the one that it was recorded with."""
        self.clock_ns: Callable[[], int] = getattr(port, "clock_ns", time.monotonic_ns)
        self._port = port
        self._unsent = b""

    def read(self, wanted: int) -> bytes | None:
        from serial import SerialException

        try:
            data: bytes = self._port.read(wanted)
            waiting = self._port.in_waiting if data else 0
            if waiting:
                data += self._port.read(waiting)
        except (SerialException, OSError) as error:
            self.ended = "" if getattr(self._port, "over", False) else str(error)
            return b""
        return data or None

    def write(self, data: bytes) -> None:
        from serial import SerialException, SerialTimeoutException

        self._unsent += data
        try:
            sent = self._port.write(self._unsent)
            self._unsent = self._unsent[len(self._unsent) if sent is None else sent :]
        except SerialTimeoutException:
            return
        except (SerialException, OSError):
            # As on a socket: the next read says so.
            self._unsent = b""

    def close(self) -> None:
        self._port.close()


Connection = tuple[Port, Session]


def connect(url: str) -> socket.socket:
    """A TCP connection to what a socket:// URL names."""
    try:
        parts = urlsplit(url)
        address = (parts.hostname or "", parts.port or TCP_PORT)
    except ValueError as error:
        raise LocalError(f"{url}: {error}; write socket://ADDRESS:PORT") from error
    if not address[0] or parts.path not in ("", "/") or parts.query:
        raise LocalError(f"{url}: write socket://ADDRESS:PORT")
    try:
        made = socket.create_connection(address, timeout=CONNECT_S)
    except ConnectionRefusedError as error:
        raise LocalError(
            f"{url}: connection refused: something is at {address[0]}, and nothing listens on port {address[1]}. "
            "Is the AI-deck's Wi-Fi firmware running?"
        ) from error
    except socket.gaierror as error:
        raise LocalError(f"{url}: no such address: {error.strerror}") from error
    except (TimeoutError, OSError) as error:
        raise LocalError(
            f"{url}: {address[0]} cannot be reached ({error.strerror or error}). "
            "Is the robot on, and is this computer in its Wi-Fi network?"
        ) from error
    made.settimeout(POLL_S)
    made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return made


def open_port(url: str, baud: int | None = None, framing: str | None = None, camera: str | None = None) -> Port:
    """Opens any pyserial URL, or socket://ADDRESS:PORT with our own reading. LocalError says why it cannot be.

    What the bytes are follows from the port: TCP's framing on socket://, CPX over UART on serial ports, what a
    simulated port says of itself; `framing` overrides. `camera` is for the simulator: pictures for it to see.
    """
    if framing is not None and framing not in FRAMINGS:
        raise LocalError(f"framing {framing!r}: choose {', '.join(FRAMINGS)}")
    scheme = url.partition("://")[0].lower() if "://" in url else ""
    if camera is not None:
        if scheme != "sim":
            raise LocalError(f"{url}: only a simulated robot (sim://…) can be given pictures to see")
        url += f"{'&' if '?' in url else '?'}camera_path={quote(camera, safe='/')}"
    if scheme == "socket":
        port = SocketPort(url)
        port.framing = cast(Framing, framing or "tcp")
        return port
    chosen = framing or "cpx-uart"
    baud = baud or BAUD[chosen]
    opened = open_serial(url, scheme, baud)
    own = getattr(opened, "framing", None)
    if own is not None and framing is not None and own != framing:
        opened.close()
        raise LocalError(f"{url} carries {own}, not {framing}: leave the framing out")
    return SerialPort(url, opened, cast(Framing, own or chosen), baud)


def open_serial(url: str, scheme: str, baud: int) -> Any:
    """Through pyserial, with errors that say what to do."""
    import serial

    for package in HANDLERS:
        if package not in serial.protocol_handler_packages:
            serial.protocol_handler_packages.append(package)
    # Two readers on one device would each get half of the bytes.
    alone = {} if scheme or sys.platform == "win32" else {"exclusive": True}
    try:
        return serial.serial_for_url(url, baudrate=baud, timeout=POLL_S, write_timeout=POLL_S, **alone)
    except serial.SerialException as error:
        raise LocalError(f"{url}: {why(error, url)}") from error
    except OSError as error:
        raise LocalError(f"{url}: {why(error, url)}") from error
    except ValueError as error:
        if "not known" not in str(error):
            raise LocalError(f"{url}: {error}") from error
        if scheme == "sim":
            raise LocalError(
                f"{url}: the simulator cannot be loaded; this says why: python -c 'import sim.serial.protocol_sim'"
            ) from error
        raise LocalError(
            f"{url}: {scheme}:// is not known. Use socket://ADDRESS:PORT, sim://SCENARIO, replay://FILE, "
            "rfc2217://ADDRESS:PORT, or a serial device such as /dev/ttyUSB0 or COM3"
        ) from error


class Stream:
    """A robot's frames: iterate over it, or over events() for everything. Close it, or use it in a `with`."""

    def __init__(
        self, port: Port, session: Session, timeout: float | None, reopen: Callable[[int], Connection] | None = None
    ) -> None:
        """`reopen` makes the connection again when it has ended, for a session with this first index."""
        self.port = port
        self.tap: Tap | None = None
        self.watch = Watch()
        self.watch.connected(port.clock_ns())
        self.reconnects = 0
        self.waited_ns = 0
        """For bytes, in poll; the rest of the time nobody polled, or events were made."""
        self._session = session
        self._reopen = reopen
        self._backoff = Backoff()
        self._before = SessionCounters()
        self._timeout_ns = None if timeout is None else int(timeout * 1e9)
        self._alive_ns: int | None = None
        self._alive_bytes = 0
        self._now_ns = 0
        self._reading = threading.Lock()
        self._closed = False
        self._ended = False

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        """Complete frames, as they come, until the connection ends. PeerSilentError when none comes for `timeout`."""
        for event in self.events():
            if isinstance(event, Frame):
                yield event

    def events(self, states: bool = False) -> Iterator[Event]:
        """Everything that comes, in its order; otherwise as iteration over frames. With `states` also a State whenever
        that changes, and at each try to connect again."""
        for event in self._everything():
            if isinstance(event, State):
                if states:
                    yield event
                continue
            if self.tap is not None:
                self.tap.event(event)
            yield event

    def _everything(self) -> Iterator[Event]:
        while (events := self.poll()) is not None:
            yield from events
            try:
                self._judge_silence(events)
            except PeerSilentError as error:
                if self._reopen is None:
                    raise
                yield from self._end(str(error))
            if self._ended and self._reopen is not None and self.port.ended:
                yield from self._connect_again()

    def poll(self) -> list[Event] | None:
        """What has come within POLL_S, maybe nothing. None: the connection has ended, port.ended says why."""
        session = self._session
        self._send()
        with self._reading:
            if self._closed or self._ended:
                return None
            before_ns = time.monotonic_ns()
            data = self.port.read(session.bytes_wanted)
            self.waited_ns += time.monotonic_ns() - before_ns
            now = self._now_ns = self.port.clock_ns()
        events: list[Event] = []
        if data is None:
            session.tick(now)
        elif len(data) > 0:
            if self.tap is not None:
                self.tap.received(data, now)
            events = session.receive(data, now)
        else:
            return self._end(self.port.ended)
        self._send()
        changed = self.watch.look(session, events, now)
        return [changed, *events] if changed else events

    @property
    def lost(self) -> str:
        """Why the connection has ended by itself; empty when it has not, when a recording is over, or after close()."""
        return self.port.ended if self._ended and not self._closed else ""

    @property
    def counters(self) -> SessionCounters:
        """A copy of what was counted so far."""
        return self._before + self._session.counters if self.reconnects else self._session.counters

    def send_camera(self, settings: CameraSettings) -> None:
        """Asks for camera settings; sent while frames are read, answered by a Reply among the events()."""
        self._session.request_camera(settings)

    def send(self, destination: int, function: int, data: bytes) -> None:
        """A packet, sent while something reads. Numbers as in host.native: CPX_ESP32, CPX_TEST."""
        self._session.send(destination, function, data)

    def close(self) -> None:
        """From any thread; an iteration that waits for bytes ends within POLL_S."""
        self._closed = True
        with self._reading:
            self.port.close()

    def _send(self) -> None:
        data = self._session.data_to_send()
        if data:
            with self._reading:
                if not self._closed and not self._ended:
                    self.port.write(data)
                    if self.tap is not None:
                        self.tap.sent(data, self.port.clock_ns())

    def _end(self, reason: str) -> list[Event]:
        """The last events of this connection. A recording ends without a reason."""
        with self._reading:
            self._ended = True
            self.port.ended = reason
            self.port.close()
        now = self.port.clock_ns()
        events = self._session.finish(now)
        return [*events, self.watch.disconnected(now, reason)] if reason else events

    def _connect_again(self) -> Iterator[Event]:
        """Tries until there is a connection, or until this stream is closed."""
        assert self._reopen is not None
        first_index = self.counters.frames
        while True:
            until_ns = self.port.clock_ns() + int(self._backoff.next_s() * 1e9)
            while (left_ns := until_ns - self.port.clock_ns()) > 0:
                if self._closed:
                    return
                time.sleep(min(left_ns * 1e-9, POLL_S))
            try:
                port, session = self._reopen(first_index)
                break
            except LocalError as error:
                yield self.watch.disconnected(self.port.clock_ns(), str(error))
        with self._reading:
            if self._closed:
                port.close()
                return
            self._before += self._session.counters
            self.port, self._session = port, session
            self.reconnects += 1
            self._ended = False
            if self.tap is not None:
                self.tap.connected_again(port.clock_ns())
        self._alive_ns = None
        yield self.watch.connected(port.clock_ns())

    def _judge_silence(self, events: list[Event]) -> None:
        now_ns = self._now_ns
        if self._alive_ns is None or any(type(event) in ALIVE for event in events):
            if self._alive_ns is not None:
                self._backoff.reset()
            self._alive_ns = now_ns
            self._alive_bytes = self._session.bytes_received
        elif not self._ended and self._timeout_ns is not None and now_ns - self._alive_ns > self._timeout_ns:
            raise PeerSilentError(f"{self.port.url}: {self._who_is_silent((now_ns - self._alive_ns) * 1e-9)}")

    def _who_is_silent(self, seconds: float) -> str:
        counters = self._session.counters  # of this connection
        packets = sum(counters.packets.values()) + counters.stamps
        if counters.bytes == 0:
            return f"not a byte in {seconds:.1f} s: is the robot on, is the wire the right one?"
        if packets == 0 and counters.credits > 0:
            return f"the ESP32 is there ({counters.credits} credits), and not one packet in {seconds:.1f} s"
        garbage = counters.garbage_bytes / counters.bytes
        if packets == 0 or garbage > GARBAGE_MOST:
            share = f"{garbage:.0%} garbage" if packets else "no packet in them"
            return f"{counters.bytes} bytes and {share}: {self._why_garbage()}"
        if counters.bytes == self._alive_bytes:
            return f"nothing for {seconds:.1f} s: the robot has gone silent, or the link has broken"
        kinds = ", ".join(f"{count} {name}" for name, count in counters.packets.items() if count)
        return f"packets but no image for {seconds:.1f} s ({kinds} so far): the camera or the GAP8 is silent"

    def _why_garbage(self) -> str:
        if self.port.baud is None:
            return f"wrong framing, or no robot's port? They were read as {self.port.framing}"
        usual = f"{self.port.framing} has {BAUD[self.port.framing]}, before mid-2022 115200"
        return f"wrong baud rate? It is {self.port.baud}; {usual}. Or the wrong framing?"


def open_stream(
    port: str,
    *,
    baud: int | None = None,
    framing: str | None = None,
    dialect: Dialect = "auto",
    timeout: float | None = 10.0,
    camera: str | None = None,
    reconnect: bool = False,
) -> Stream:
    """Opens a robot, a serial adapter or the simulator.

    `timeout`: seconds without any image (or stamp message) after which iteration raises PeerSilentError; None: never.
    With dialect "auto" nothing is sent until the robot has announced that it speaks native; "stock" never sends,
    "native" asks at once. `baud` and `framing` as open_port. `reconnect`: when the connection has ended, or the robot
    was silent for `timeout`, it is made again, for ever; the first one must succeed.
    """
    if timeout is not None and not timeout > 0:
        raise LocalError(f"timeout {timeout}: give seconds above 0, or None to wait for ever")
    if reconnect and port.startswith(("sim://", "replay://")):
        raise LocalError(f"{port}: reconnecting is for sockets and serial ports; 'host sim serve' makes a socket")

    def connect_session(first_index: int) -> Connection:
        opened = open_port(port, baud, framing, camera)
        own: Dialect = getattr(opened, "dialect", "auto")
        return opened, Session(opened.framing, own if dialect == "auto" else dialect, first_index)

    Session("tcp", dialect)  # judges the dialect before anything is opened
    return Stream(*connect_session(0), timeout, connect_session if reconnect else None)
