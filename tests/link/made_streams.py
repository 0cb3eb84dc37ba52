"""Streams made byte by byte, apart from the codecs that are under test, and a way to compare what came of them."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import operator
import struct
import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np

from host.link.frame import Frame, LostFrame
from host.link.records import Event
from host.link.session import Dialect, Framing, Session

GAP8_TO_HOST_APP = bytes([0x63, 0x05])
GAP8_TO_HOST_CONSOLE = bytes([0x63, 0x02])
ANNOUNCING = bytes([0xE3, 0x05])
ESP32_TO_HOST_APP = bytes([0x53, 0x05])
STM32_TO_HOST_APP = bytes([0x0B, 0x05])
GAP8_TO_HOST_STREAMER = bytes([0x63, 0x06])


def packet(data: bytes, route: bytes = GAP8_TO_HOST_APP) -> bytes:
    """CPX over TCP."""
    return struct.pack("<H", len(data) + 2) + route + data


def pixels(width: int, height: int, seed: int) -> bytes:
    return np.random.default_rng(seed).integers(0, 256, width * height, np.uint8).tobytes()


def stock(
    body: bytes, width: int, height: int, kind: int = 0, piece: int = 1020, route: bytes = GAP8_TO_HOST_APP
) -> list[bytes]:
    """The packets of one stock frame."""
    header = packet(struct.pack("<BHHBBI", 0xBC, width, height, 1, kind, len(body)), route)
    return [header, *(packet(body[at : at + piece]) for at in range(0, len(body), piece))]


def sealed(message: bytes) -> bytes:
    return message + struct.pack("<I", zlib.crc32(message))


def native_header(frame: int, body: bytes, width: int, height: int, **values: int) -> bytes:
    """The data of a native frame header; `values` by field name, 0 where not given."""
    given = {"flags": 3, "crc": zlib.crc32(body), "gap8_us": 1000 * frame, "stm32_us": 1000 * frame + 7, "bound_us": 9}
    given.update(values)
    message = struct.pack(
        "<BBHIHHBBHIIQQIBBBBIIIIIIIIIIIII",
        *(0x4E, 1, 104, frame, width, height, 1, given.get("kind", 0), given["flags"], len(body), given["crc"]),
        *(given["gap8_us"], given["stm32_us"], given["bound_us"], given.get("epoch", 0), 1, 64, 1, 100, 125_333),
        *(given.get("stamp_sequence", 0), given.get("stamp_age_us", 0), 0, 0, 0, 0, 0, 0),
        *(given.get("frames_unsent", 0), 0, 0),
    )
    return sealed(message)


def native(frame: int, body: bytes, width: int, height: int, piece: int = 1012, **values: int) -> list[bytes]:
    """The packets of one native frame."""
    return [
        packet(native_header(frame, body, width, height, **values)),
        *(
            packet(struct.pack("<BBHI", 0x4E, 2, frame & 0xFFFF, at) + body[at : at + piece])
            for at in range(0, len(body), piece)
        ),
    ]


def pairs(rows: Iterable[tuple[int, int, int, int]], lost: int = 0) -> bytes:
    rows = list(rows)
    listed = b"".join(struct.pack("<IQQB", *row) for row in rows)
    return packet(sealed(struct.pack("<BBHI", 0x4E, 3, len(rows), lost) + listed))


def status(dropped: int, up_us: int = 5) -> bytes:
    return packet(sealed(struct.pack("<BBHQ12I", 0x4E, 4, 0, up_us, 0, dropped, *([0] * 10))), ESP32_TO_HOST_APP)


def log_status(dropped: int = 0, state: int = 2) -> bytes:
    counters = 1000, 1000 - dropped, dropped, 250_000, 40, 0, 6
    return packet(sealed(struct.pack("<BBBBQ9I", 0x4E, 6, state, 3, 2**33, 1, 0xCAFE, *counters)), STM32_TO_HOST_APP)


def reply(request: int, code: int) -> bytes:
    return packet(bytes([0x4E, 5, request, code]))


def uart(data: bytes, route: bytes = GAP8_TO_HOST_APP) -> bytes:
    """One frame of CPX over UART."""
    frame = bytes([0xFF, len(data) + 2]) + route + data
    check = 0
    for byte in frame:
        check ^= byte
    return frame + bytes([check])


def uart_pieces(tcp_packet: bytes) -> list[bytes]:
    """A packet as the ESP32's router splits it for the UART: all pieces but the final one with lastPacket = 0."""
    route, data = tcp_packet[2:4], tcp_packet[4:]
    middle = bytes([route[0] & ~0x40, route[1]])
    starts = range(0, len(data), 98)
    return [uart(data[at : at + 98], route if at + 98 >= len(data) else middle) for at in starts]


POSE = (0.5, -1.25, 1.0, 0.0, 0.0, 0.5, 0.75)


def paper(
    body: bytes,
    width: int,
    height: int,
    frame_ms: int,
    pose: tuple[float, ...] = POSE,
    kind: int = 0,
    piece: int = 1020,
) -> list[bytes]:
    """The packets of one frame from the paper's firmware."""
    header = struct.pack("<BHHBBII7f", 0xBC, width, height, 1, kind, len(body), frame_ms, *pose)
    return [packet(header), *(packet(body[at : at + piece]) for at in range(0, len(body), piece))]


def paper_stamp(stm32_us: int, pose: tuple[float, ...] = POSE) -> bytes:
    payload = struct.pack("<BQ7f", 1, stm32_us, *pose)
    return b"\xbc\x25" + payload + bytes([functools.reduce(operator.xor, payload)])


def nanocockpit_packet(data: bytes, route: bytes = GAP8_TO_HOST_STREAMER) -> bytes:
    """Its length leaves out the route."""
    return struct.pack("<H", len(data)) + route + data


STATE = struct.pack("<I9hI3h", 7000, 500, -1250, 1000, 1, 2, 3, 4, 5, 6, 0xC0000000, 7, 8, 9)
"""Ticks, position, velocity, acceleration, no rotation, rates."""


def state_message(state: bytes = STATE) -> bytes:
    return b"!STA" + state + struct.pack("<I", zlib.crc32(b"!STA" + state))


def nanocockpit(
    body: bytes,
    width: int,
    height: int,
    frame_id: int,
    *,
    check: int | None = None,
    piece: int = 4088,
    gap8_us: int = 5000,
    reply: tuple[int, int] = (0, 0),
    state: bytes = STATE,
) -> list[bytes]:
    """The packets of one image buffer, each of `piece` bytes of data; `check` as sent, by default the right one."""
    metadata = struct.pack("<BHHBBBII", 10, width, height, 1, 0, frame_id, gap8_us, 4000) + state
    metadata += struct.pack("<IB3x64B", 0, 0, *bytes(64)) + struct.pack("<III4f", *reply, 0, 0, 0, 0, 0)
    buffer = metadata + body
    check = (zlib.crc32(buffer) or 0xFFFFFFFF) if check is None else check
    padded = buffer + bytes(-len(buffer) % 4)
    first = piece - 12
    packets = [nanocockpit_packet(struct.pack("<BBII2x", 0x10, 1, len(buffer), check) + padded[:first])]
    for at in range(first, len(padded), piece - 4):
        packets.append(nanocockpit_packet(b"\x11\0\0\0" + padded[at : at + piece - 4]))
    return packets


def received(
    stream: bytes,
    cuts: Iterable[int] = (),
    framing: Framing = "tcp",
    finish: bool = True,
    dialect: Dialect = "stock",
) -> tuple[list[Event], Session]:
    """Everything that a session makes of a stream that comes in pieces."""
    session = Session(framing, dialect)
    events: list[Event] = []
    places = [0, *cuts, len(stream)]
    for start, end in itertools.pairwise(places):
        events += session.receive(stream[start:end], arrival_host_ns=1)
    if finish:
        events += session.finish(1)
    return events, session


def comparable(events: Iterable[Event]) -> list[Any]:
    """Plain values: two lists of them can be compared with ==."""
    return [
        (type(event).__name__, *(flat(getattr(event, field.name)) for field in dataclasses.fields(event)))
        for event in events
    ]


def flat(value: Any) -> Any:
    return value.tobytes() if isinstance(value, np.ndarray) else value


def bodies(events: Iterable[Event]) -> list[bytes]:
    """Of the good frames."""
    return [event.body.tobytes() for event in events if isinstance(event, Frame)]


def causes(events: Iterable[Event]) -> list[str]:
    return [event.cause for event in events if isinstance(event, LostFrame)]
