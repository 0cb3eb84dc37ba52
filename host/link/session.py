"""One connection without the connection: bytes and times in, events and bytes to send out. No sockets, no clock."""

from __future__ import annotations

from collections import Counter, deque
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..native import ffi, lib
from ..protocol.codec import (
    encode_camera_request,
    encode_cpx_tcp,
    encode_nanocockpit,
    encode_nanocockpit_reply,
    encode_paper_camera,
    encode_stream_request,
)
from ..protocol.errors import LocalError
from ..protocol.packets import CameraSettings, CpxPacket, Route, StreamRequest
from . import assemble
from .counters import LOSS_CAUSES, SessionCounters
from .dialects import SPOKEN, Asking, Dialect, FrameIds, FrameNumbers
from .expected import Expected
from .frame import Frame, LostFrame
from .pairs import Pairs
from .records import Announced, Event, Garbage

Framing = Literal["tcp", "cpx-uart", "stamps"]

FRAMINGS = {"tcp": lib.STREAM_TCP, "cpx-uart": lib.STREAM_CPX_UART, "stamps": lib.STREAM_STAMPS}
STAMPS: dict[int, Dialect] = {
    lib.UART1_STAMP: "native",
    lib.UART1_PAPER: "paper",
    lib.UART1_NANOCOCKPIT: "nanocockpit",
}
"""By uart1_message_t.kind."""
SEND_PACKETS = 16
"""Waiting for the line, at most."""
LINE_OUT_MAX = 512
"""Bytes for a UART that the caller has not fetched, about."""
ASKED = (lib.CPX_GAP8, lib.CPX_ESP32, lib.CPX_STM32)
"""The GAP8 for native frames, the ESP32 for its counters, the STM32 for those of its log."""

BODY_NEEDED, FRAME, LOST, NATIVE = lib.STREAM_BODY_NEEDED, lib.STREAM_FRAME, lib.STREAM_LOST, lib.STREAM_NATIVE


class Session:
    """Decodes what one robot sends. Its times are those that the caller gives: any clock, as long as it is one."""

    def __init__(self, framing: Framing = "tcp", dialect: Dialect = "auto", first_index: int = 0) -> None:
        """`first_index`: of the first frame, for a session that goes on where another one ended."""
        if framing not in FRAMINGS:
            raise LocalError(f"framing {framing!r}: choose {', '.join(FRAMINGS)}")
        if dialect not in get_args(Dialect):
            raise LocalError(f"dialect {dialect!r}: choose {', '.join(get_args(Dialect))}")
        if dialect == "nanocockpit" and framing == "cpx-uart":
            raise LocalError("nanocockpit has no CPX over UART: use its TCP port, or --framing stamps on UART1")
        self.framing = framing
        self.dialect = dialect
        self.spoken: Dialect | None = None
        """What the last frame was, whole or not."""
        self._stream = ffi.new("stream_t *")
        lib.stream_init(self._stream, FRAMINGS[framing])
        if dialect not in ("auto", "stock"):
            rule = lib.STREAM_NANOCOCKPIT if dialect == "nanocockpit" else lib.STREAM_CPX
            lib.stream_set_rule(self._stream, rule)
        self._reported = [self._stream.events[i] for i in range(lib.STREAM_EVENTS)]
        self._closed = self._stream.closed
        self._body: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._body_pointer: Any = None
        self._first_index = self._frames = first_index
        self._lost: Counter[str] = Counter()
        self._numbers = FrameNumbers()
        self._ids = FrameIds()
        self._asking = {
            target: Asking("stock" if framing == "stamps" else dialect)
            for target in ASKED
            if framing != "cpx-uart" or target != lib.CPX_STM32  # there the host sits in its place
        }
        self._to_send: deque[CpxPacket] = deque()
        self._heard_ns: int | None = None
        self._line_us = 0
        self._line_out = b""
        self._pairs = Pairs()
        self._finished = False
        self._cut_bytes = 0
        changes_rule = framing == "tcp" and dialect not in ("auto", "stock")
        self.expected = Expected(dialect, Session(framing, "stock") if changes_rule else None)

    def receive(self, data: bytes | memoryview, arrival_host_ns: int) -> list[Event]:
        """The events that these bytes complete, in their order. LocalError after finish()."""
        self._judge_open()
        events: list[Event] = []
        stream, size = self._stream, len(data)
        # Bytes in the middle of a packet may have waited for this read: that is no silence on the line.
        self._pass_time(arrival_host_ns, stream.uart.rx_fill == stream.uart.rx_taken)
        if self.framing == "cpx-uart" and len(self._line_out) < LINE_OUT_MAX:
            self._line_out += self._uart_to_send()  # what fell due before these bytes came
        source = ffi.from_buffer("uint8_t[]", data)
        while lib.stream_push(stream, source, size, self._line_us):
            self._collect(events, arrival_host_ns)
        self._collect(events, arrival_host_ns)
        self.expected.receive(data, arrival_host_ns)
        self._ask(arrival_host_ns)
        return events

    def tick(self, now_ns: int) -> None:
        """Nothing has come until now. Lets requests and credits be repeated, and packets that stopped half-way be
        given up: call it after each read that timed out."""
        self._pass_time(now_ns, True)
        self._ask(now_ns)

    def finish(self, arrival_host_ns: int | None = None) -> list[Event]:
        """The stream has ended: the last events. The session takes no more bytes, and does not end again."""
        self._judge_open()
        self._finished = True
        arrival = arrival_host_ns if arrival_host_ns is not None else self._heard_ns or 0
        events: list[Event] = []
        stream = self._stream
        on_line = stream.uart.rx_fill - stream.uart.rx_taken + stream.stamps.fill
        garbage_bytes, hunting = stream.garbage_bytes, stream.hunting
        while lib.stream_finish(stream):
            self._collect(events, arrival)
        self._collect(events, arrival)
        if self.framing != "tcp":
            self._cut_bytes = on_line
        elif not hunting:
            self._cut_bytes = stream.garbage_bytes - garbage_bytes
        return events

    def request_camera(self, settings: CameraSettings) -> None:
        """Asks the GAP8 for these settings; a Reply says whether it took them. The paper's firmware has a message of
        its own, which nothing answers."""
        spoken = self.spoken if self.dialect in ("auto", "stock") else self.dialect
        if spoken == "nanocockpit":
            raise LocalError("NanoCockpit takes no camera settings: they are compiled into it")
        encode = encode_paper_camera if spoken == "paper" else encode_camera_request
        self.send(lib.CPX_GAP8, lib.CPX_APP, encode(settings))

    def send(self, destination: int, function: int, data: bytes) -> None:
        """A packet from the host, after those that wait."""
        if self.framing == "stamps":
            raise LocalError("this port only listens to UART1: open the robot's other port to send to it")
        if len(self._to_send) >= SEND_PACKETS:
            raise LocalError("requests come faster than the robot takes them: wait for its replies")
        self._to_send.append(CpxPacket(Route(destination, lib.CPX_HOST, function, last_packet=True), data))

    def data_to_send(self) -> bytes:
        """What is to be written now, maybe nothing. On CPX over UART that includes credits, in every dialect: they
        are part of the framing, and a robot without them falls silent."""
        self._ask(None)
        if self.framing == "cpx-uart":
            out, self._line_out = self._line_out + self._uart_to_send(), b""
            return out
        if not self._to_send:
            return b""
        encode = encode_nanocockpit if self._stream.rule == lib.STREAM_NANOCOCKPIT else encode_cpx_tcp
        out = b"".join(encode(packet) for packet in self._to_send)
        self._to_send.clear()
        return out

    @property
    def reads_cpx(self) -> bool:
        """Packets of CPX, or else NanoCockpit's: as chosen, or as recognised so far."""
        return bool(self._stream.rule == lib.STREAM_CPX)

    @property
    def bytes_received(self) -> int:
        """counters.bytes, at less cost."""
        return int(self._stream.bytes)

    @property
    def bytes_wanted(self) -> int:
        """Nothing under way is complete before so many more bytes have come: what a port may wait for, but on TCP
        not for long, as another packet may overtake a frame."""
        stream = self._stream
        if self.framing == "cpx-uart":
            uart = stream.uart
            waiting = uart.rx_fill - uart.rx_taken
            size = 2 if waiting < 2 else 3 + uart.rx[uart.rx_taken + 1]  # a credit; start, length, check and the rest
            return int(max(1, size - waiting))
        if self.framing == "stamps":
            # A longer message of another firmware may be under way.
            return int(max(1, lib.STAMP_BYTES - stream.stamps.fill))
        if not stream.in_frame:
            return 1
        unjudged = stream.window_fill - stream.at
        return int(max(1, stream.open.size - stream.open.received - unjudged))

    @property
    def frame_progress(self) -> int:
        """Bytes of the frame under way, or -1: while it changes a slow line is not a silent camera."""
        return int(self._stream.open.received) if self._stream.in_frame else -1

    @property
    def packets_received(self) -> int:
        """Of every function, and stamp messages and credits: whatever shows that the framing is right."""
        stream = self._stream
        return int(sum(stream.packets) + stream.stamps.received + stream.uart.credits_in)

    @property
    def counters(self) -> SessionCounters:
        """What was counted so far."""
        counters = assemble.counters(self._stream)
        counters.frames = self._frames - self._first_index
        counters.cut_bytes = self._cut_bytes
        lost = self._lost + self._numbers.lost + self._ids.lost
        counters.frames_lost = {cause: lost[cause] for cause in LOSS_CAUSES}
        counters.renumbered = self._numbers.renumbered
        counters.pairs = self._pairs.received
        counters.pairs_lost = self._pairs.lost
        return counters

    def _judge_open(self) -> None:
        if self._finished:
            raise LocalError("this session has ended with finish(): make a new one for a new connection")

    def _pass_time(self, now_ns: int, on_line: bool) -> None:
        if on_line and self._heard_ns is not None:
            self._line_us += max(0, now_ns - self._heard_ns) // 1000
        self._heard_ns = now_ns

    def _collect(self, events: list[Event], arrival_host_ns: int) -> None:
        for event in self._reported[: self._stream.event_count]:
            kind = event.kind
            if kind == BODY_NEEDED:
                self._body = np.empty(event.size, np.uint8)
                self._stream.body = self._body_pointer = ffi.from_buffer("uint8_t[]", self._body)
            elif kind == FRAME:
                events.append(self._whole_frame(arrival_host_ns))
            else:
                self._collect_other(kind, event, events, arrival_host_ns)

    def _collect_other(self, kind: int, event: Any, events: list[Event], arrival_host_ns: int) -> None:
        if kind == LOST:
            events.append(self._lost_frame(assemble.CAUSES[event.cause], arrival_host_ns))
        elif kind == lib.STREAM_GARBAGE:
            events.append(Garbage(arrival_host_ns, event.offset, event.size))
        elif kind == lib.STREAM_STAMP:
            self.expected.heard(STAMPS[event.message.kind])
            events.append(assemble.stamp(event.message, arrival_host_ns))
        elif kind == lib.STREAM_ANNOUNCED:
            for asking in self._asking.values():
                asking.announced()
            self.expected.heard("native")
            events.append(Announced(arrival_host_ns))
        else:
            data = bytes(ffi.buffer(self._stream.data + event.data_at, event.size))
            if kind == NATIVE:
                self._native_message(data, events, arrival_host_ns)
            else:
                events.append(assemble.packet(event.route, data, arrival_host_ns))

    def _whole_frame(self, arrival_host_ns: int) -> Frame | LostFrame:
        closed = self._closed
        dialect = closed.dialect
        if dialect or closed.type:
            cause = assemble.fault(closed, self._body)
            if cause is not None:
                return self._lost_frame(cause, arrival_host_ns)
        frame = Frame(
            self._frames,
            arrival_host_ns,
            closed.width,
            closed.height,
            closed.depth,
            assemble.encoding(closed) if closed.type else "raw",
            self._body,
        )
        self._frames += 1
        self.spoken = SPOKEN[dialect]
        self.expected.heard(self.spoken)
        if dialect != lib.DIALECT_NATIVE:
            self._numbers.stock_came()
        if dialect == lib.DIALECT_NATIVE:
            frame.native = assemble.native_header(closed.header)
            frame.pairs = self._pairs.give()
            self._asking[lib.CPX_GAP8].arrived()
            self._numbers.came(closed.header.frame, closed.header.frames_unsent, closed.headless)
        elif dialect == lib.DIALECT_PAPER:
            frame.paper = assemble.paper_header(closed.paper)
        elif dialect == lib.DIALECT_NANOCOCKPIT:
            frame.nanocockpit = assemble.nanocockpit_header(closed)
            self._ids.came(closed.nanocockpit.frame_id)
            if self.dialect == "nanocockpit" and len(self._to_send) < SEND_PACKETS:
                reply = encode_nanocockpit_reply(closed.nanocockpit.frame_gap8_us, closed.nanocockpit.frame_id)
                self.send(lib.CPX_GAP8, lib.CPX_STREAMER, reply)
        return frame

    def _lost_frame(self, cause: str, arrival_host_ns: int) -> LostFrame:
        closed = self._closed
        self._lost[cause] += 1
        self.spoken = SPOKEN[closed.dialect]
        native = closed.dialect == lib.DIALECT_NATIVE
        if native:
            self._numbers.failed()
        else:
            self._numbers.stock_came()
        if closed.dialect == lib.DIALECT_NANOCOCKPIT:
            self._ids.failed()
        return LostFrame(
            arrival_host_ns,
            cause,
            closed.received,
            closed.size,
            self._body,
            closed.header.frame if native else None,
        )

    def _native_message(self, data: bytes, events: list[Event], arrival_host_ns: int) -> None:
        if data[1] == lib.NATIVE_STATUS:
            status = assemble.status(data, arrival_host_ns)
            self._asking[lib.CPX_ESP32].arrived()
            self._numbers.esp32_says(status.counters["frames_dropped"])
            events.append(status)
        elif data[1] == lib.NATIVE_LOG:
            events.append(assemble.log_status(data, arrival_host_ns))
            if lib.CPX_STM32 in self._asking:
                self._asking[lib.CPX_STM32].arrived_again(arrival_host_ns)
        elif data[1] == lib.NATIVE_REPLY:
            events.append(assemble.reply(data, arrival_host_ns))
        else:
            self._pairs.take(data)

    def _ask(self, now_ns: int | None) -> None:
        if self._to_send:
            return
        for target, asking in self._asking.items():
            if asking.due(now_ns):
                self.send(target, lib.CPX_APP, encode_stream_request(StreamRequest(native=True)))

    def _uart_to_send(self) -> bytes:
        out = ffi.new("uint8_t[]", 2 * lib.CPX_UART_FRAME_MAX)
        if self._to_send and self._uart_takes(self._to_send[0]):
            self._to_send.popleft()
        size = lib.stream_transmit(self._stream, out, len(out), self._line_us)
        return bytes(ffi.buffer(out, size))

    def _uart_takes(self, packet: CpxPacket) -> bool:
        data, route = ffi.from_buffer("uint8_t[]", packet.data), packet.route
        wire = ((route.destination, route.source, route.function, route.version, route.last_packet, route.reserved),)
        made = ffi.new("cpx_packet_t *", (*wire, (data, len(data))))
        return bool(lib.cpx_uart_send(ffi.addressof(self._stream.uart), made))
