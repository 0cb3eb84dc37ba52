"""A port and a session together: what `host.open` returns. Reads, decodes, answers, notices silence, connects again."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Protocol

from ..protocol.errors import LocalError, NotThereError, PeerError, PeerSilentError
from ..protocol.packets import CameraSettings
from .counters import SessionCounters
from .dialects import Dialect
from .expected import GARBAGE_MOST
from .frame import Frame, LostFrame
from .ports import ALONE, BAUD, POLL_S, AbsentPort, Port, SocketPort, framing_of, open_port
from .records import Event, NanocockpitStamp, PaperStamp, Stamp, State
from .session import Session
from .state import Backoff, Watch

ALIVE = (Frame, LostFrame, Stamp, PaperStamp, NanocockpitStamp)
"""What a robot is there for: without any of these it is called silent, whatever else it sends."""
OLD_BAUD = 115_200
"""Of UART2 before mid-2022."""

Connection = tuple[Port, Session]


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
        self._before: SessionCounters | None = None
        """Of the sessions before this one."""
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
        """What has come within POLL_S, maybe nothing. None: the connection has ended, port.ended says why. PeerError
        when the robot does not speak the dialect that was chosen."""
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
        if self.port.seam:
            return self._begin_anew(now)
        if data is None:
            session.tick(now)
        elif len(data) > 0:
            if self.tap is not None:
                self.tap.received(data, now)
            events = session.receive(data, now)
            if session.expected.other is not None:
                raise PeerError(f"{self.port.url}: {session.expected.contradiction()}")
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
        return self._session.counters if self._before is None else self._before + self._session.counters

    @property
    def reads_cpx(self) -> bool:
        """Packets of CPX, or else NanoCockpit's: as chosen, or as recognised so far."""
        return self._session.reads_cpx

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
            first, self._before = isinstance(self.port, AbsentPort), self.counters
            self.port, self._session = port, session
            self.reconnects += not first
            self._ended = False
            if self.tap is not None and not first:
                self.tap.connected_again(port.clock_ns())
        self._alive_ns = None
        yield self.watch.connected(port.clock_ns())

    def _begin_anew(self, now_ns: int) -> list[Event]:
        """A replay has come to a seam. Where the robot was connected again, the same is lost as then; where a recording
        begins again, what it breaks off with was not lost by anybody."""
        events: list[Event] = []
        if self.port.seam == "connection":
            reason = "the recorded connection ended"
            events = [*self._session.finish(now_ns), self.watch.disconnected(now_ns, reason)]
            events.append(self.watch.connected(now_ns))
            self.reconnects += 1
            self._alive_ns = None
        self._before = self.counters
        self._session = Session(self._session.framing, self._session.dialect, self._before.frames)
        if self.tap is not None:
            self.tap.connected_again(now_ns)
        return events

    def _judge_silence(self, events: list[Event]) -> None:
        now_ns = self._now_ns
        if self._alive_ns is None or any(type(event) in ALIVE for event in events):
            if self._alive_ns is not None:
                self._backoff.reset()
            self._alive_ns = now_ns
            self._alive_bytes = self._session.bytes_received
        elif not self._ended and self._timeout_ns is not None and now_ns - self._alive_ns > self._timeout_ns:
            suspicion = self._session.expected.suspicion()
            if suspicion:
                raise PeerError(f"{self.port.url}: {suspicion}")
            raise PeerSilentError(f"{self.port.url}: {self._who_is_silent((now_ns - self._alive_ns) * 1e-9)}")

    def _who_is_silent(self, seconds: float) -> str:
        counters = self._session.counters  # of this connection
        packets = sum(counters.packets.values()) + counters.stamps
        if counters.bytes == 0:
            where = ALONE if isinstance(self.port, SocketPort) else "Is the robot on, is the wire the right one?"
            return f"not a byte in {seconds:.1f} s. {where}"
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
        others = [rate for rate in dict.fromkeys((BAUD[self.port.framing], OLD_BAUD)) if rate != self.port.baud]
        usual = f"; {self.port.framing} may have {' or '.join(map(str, others))}" if others else ""
        return f"wrong baud rate? It is {self.port.baud}{usual}. Or the wrong framing?"


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
    "native" asks at once. With "paper", "nanocockpit" or "native" a robot that speaks another one is a PeerError.
    `baud` and `framing` as open_port. `reconnect`: when the connection has ended, or the robot was silent for
    `timeout`, it is made again, for ever; a robot that is not there yet is waited for likewise. Whatever waiting does
    not mend (no such address, no permission, busy) is a LocalError at once.
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
    if not reconnect:
        return Stream(*connect_session(0), timeout)
    try:
        first = connect_session(0)
    except NotThereError as error:
        session = Session(framing_of(port, framing), dialect)
        first = AbsentPort(port, session.framing, str(error)), session
    return Stream(*first, timeout, connect_session)
