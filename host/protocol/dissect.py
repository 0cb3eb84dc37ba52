"""Captured bytes, piece by piece, from the specification alone: construct decodes, nothing of the C is used.

Every byte of the capture is in exactly one piece, whatever the bytes are. Where a piece begins is found as the
receivers of docs/PROTOCOL.md find it; since a capture is all there, a place is only believed when what follows fits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from construct import ConstructError

from .spec import cpx, cpx_link, cpx_uart, image, native, stamp
from .spec.checks import crc16, xor8

Framing = Literal["tcp", "cpx-uart", "stamps", "spi"]
Kind = Literal["packet", "credit", "idle", "stamp", "garbage", "truncated"]

CHAIN = 3
"""So many packets in a row are no accident."""
GUESS_BYTES = 1 << 15
TARGETS = {target.number for target in cpx.TARGETS}
FUNCTIONS = {function.number for function in cpx.FUNCTIONS}
GAP8_TO_HOST, APP = 0x23, 0x05
NATIVE_MAGIC = 0x4E
NATIVE_KINDS = {kind.number for kind in native.KINDS if kind.number < 16}
"""Those that the robot sends."""


@dataclass(frozen=True, slots=True)
class Piece:
    """One thing on the wire."""

    offset: int
    """In the capture."""
    size: int
    kind: Kind
    about: str = ""
    """Of garbage and of a truncated piece: what is wrong."""
    content: Any = None
    """What construct made of a packet or a stamp message."""


def split(data: bytes, framing: Framing) -> Iterator[Piece]:
    """The pieces in their order, without a gap."""
    return SPLITTERS[framing](data)


def guess(data: bytes) -> tuple[Framing, float]:
    """The framing that explains most of the first bytes, and what part of them it explains."""
    head = data[:GUESS_BYTES]
    explained: dict[Framing, int] = {
        framing: sum(piece.size for piece in split(head, framing) if piece.kind in ("packet", "credit", "stamp"))
        for framing in SPLITTERS
    }
    best = max(explained, key=lambda framing: explained[framing])  # the first of equals
    return best, explained[best] / max(1, len(head))


# CPX over TCP and over SPI -------------------------------------------------------------------------------------------


@lru_cache(1 << 16)
def route_fault(route: bytes) -> str:
    """Why no router would pass this route on, or nothing."""
    parsed = cpx.ROUTE.parse(route)
    for name in ("source", "destination"):
        if parsed[name] not in TARGETS:
            return f"{name} {parsed[name]} is none of {min(TARGETS)}..{max(TARGETS)}"
    return ""


@lru_cache(1 << 16)
def oddity(route: bytes) -> str:
    """What existing firmware would never send, though it could be routed, or nothing."""
    parsed = cpx.ROUTE.parse(route)
    if parsed.version != cpx.VERSION:
        return f"version {parsed.version}, which every receiver drops"
    return "" if parsed.function in FUNCTIONS else f"function {parsed.function} is not known"


def link_size(data: bytes, at: int) -> tuple[int, str]:
    """(bytes of the packet that this header announces, "") or (0, what is wrong with it)."""
    left = len(data) - at
    if left < 4:
        return 0, f"{left} of the 4 bytes of a header"
    length = int.from_bytes(data[at : at + 2], "little")
    if not 2 <= length <= 1022:
        return 0, f"length {length}: 2..1022 is possible"
    fault = route_fault(bytes(data[at + 2 : at + 4]))
    return (0, fault) if fault else (2 + length, "")


def padded(size: int) -> int:
    """Bytes that a packet takes on SPI, at least: the window is a multiple of four, and never shorter than eight."""
    return cpx_link.window_bytes(size, size)


def begins(data: bytes, at: int, stride: Callable[[int], int]) -> bool:
    """Do packets that firmware would send lie here in a row, CHAIN of them or up to the end of the capture?"""
    for number in range(CHAIN):
        size, _ = link_size(data, at)
        if size == 0 or oddity(bytes(data[at + 2 : at + 4])):
            return False
        if number == 0 and unmistakable(data[at : at + size], size):
            return True
        at += stride(size)
        if at >= len(data):
            return at == len(data)
    return True


def unmistakable(packet: bytes, size: int) -> bool:
    """Is this packet so particular that it needs no others behind it?"""
    if len(packet) < size or packet[2] & 0x3F != GAP8_TO_HOST or packet[3] != APP:
        return False
    if size > 5 and packet[4] == NATIVE_MAGIC:
        return packet[5] in NATIVE_KINDS
    try:
        image.STOCK_HEADER.parse(packet[4:])
    except ConstructError:
        return False
    return True


def believable(data: bytes, at: int, size: int) -> str:
    """What speaks against the packet here, whose header is possible; or nothing."""
    end = at + size
    odd = oddity(bytes(data[at + 2 : at + 4]))
    if odd and end != len(data) and link_size(data, end)[0] == 0:
        return f"{odd}, and no header behind it"
    return ""


def split_tcp(data: bytes) -> Iterator[Piece]:
    """A packet is held back until what follows it has been seen: its length may be wrong."""
    at, held = 0, None
    while at < len(data):
        size, fault = link_size(data, at)
        if size and at + size <= len(data):
            fault = believable(data, at, size)
            if not fault:
                if held is not None:
                    yield held
                held = Piece(at, size, "packet", content=cpx_link.FRAME.parse(data[at : at + size]))
                at += size
                continue
        start = next_start(data, at + 1 if held is None else held.offset + 1, lambda size: size)
        if held is not None and start is not None and start < at:
            length = held.size - 2
            yield Piece(held.offset, start - held.offset, "garbage", f"length {length} leads to no header ({fault})")
        else:
            if held is not None:
                yield held
            end = len(data) if start is None else start
            yield cut_off(data, at, size, fault) if start is None else Piece(at, end - at, "garbage", fault or CUT)
        held = None
        at = len(data) if start is None else start
    if held is not None:
        yield held


CUT = "a packet that ends in the middle"


def cut_off(data: bytes, at: int, size: int, fault: str) -> Piece:
    """What lies at the end of the capture and is followed by nothing."""
    left = len(data) - at
    if size > left:
        return Piece(at, left, "truncated", f"the capture ends after {left} of {size} bytes of a packet")
    if left < 4:
        return Piece(at, left, "truncated", f"the capture ends after {fault}")
    return Piece(at, left, "garbage", fault)


def next_start(data: bytes, at: int, stride: Callable[[int], int]) -> int | None:
    """Where packets begin again."""
    return next((place for place in range(at, len(data)) if begins(data, place, stride)), None)


def split_spi(data: bytes) -> Iterator[Piece]:
    """One direction. What a side sends beyond its packet means nothing: it counts as a part of that window."""
    at = 0
    while at < len(data):
        if data[at : at + 2] == b"\0\0":
            end = at + 4
            while data[end : end + 4] == b"\0\0\0\0":
                end += 4
            end = min(end, len(data))
            yield Piece(at, end - at, "idle")
            at = end
            continue
        size, fault = link_size(data, at)
        if size and at + size <= len(data) and not oddity(bytes(data[at + 2 : at + 4])):
            end = min(at + padded(size), len(data))
            yield Piece(at, end - at, "packet", content=cpx_link.FRAME.parse(data[at : at + size]))
            at = end
            continue
        start = next_window(data, at + 1)
        end = len(data) if start is None else start
        yield cut_off(data, at, size, fault) if start is None else Piece(at, end - at, "garbage", fault or CUT)
        at = end


def next_window(data: bytes, at: int) -> int | None:
    """Where a window begins again: an idle one, or packets in a row."""
    for place in range(at, len(data)):
        if data[place : place + 8] == bytes(8) or begins(data, place, padded):
            return place
    return None


# CPX over UART and stamp messages: each has a start and a check ------------------------------------------------------


def uart_piece(data: bytes, at: int) -> Piece | str:
    """What begins here, or why nothing does."""
    if data[at] != 0xFF:
        return f"0x{data[at]:02X} is no start"
    if at + 2 > len(data):
        return Piece(at, 1, "truncated", "the capture ends after a start")
    length = data[at + 1]
    if length == 0:
        return Piece(at, 2, "credit")
    if not 2 <= length <= 100:
        return f"length {length}: 0 and 2..100 are possible"
    size, left = length + 3, len(data) - at
    if size > left:
        return Piece(at, left, "truncated", f"the capture ends after {left} of {size} bytes of a frame")
    frame = data[at : at + size]
    try:
        return Piece(at, size, "packet", content=cpx_uart.FRAME.parse(frame).covered.value)
    except ConstructError:
        return f"check byte of {size} bytes is 0x{frame[-1]:02X}, should be 0x{xor8(frame[:-1]):02X}"


def stamp_piece(data: bytes, at: int) -> Piece | str:
    """Likewise."""
    left = len(data) - at
    if data[at : at + 2] != b"\xd5\x2a"[:left]:
        return f"0x{data[at]:02X} is no start"
    if left < 17:
        return Piece(at, left, "truncated", f"the capture ends after {left} of 17 bytes of a stamp message")
    message = data[at : at + 17]
    try:
        return Piece(at, 17, "stamp", content=stamp.STAMP.parse(message).covered.value)
    except ConstructError:
        return f"CRC-16 is 0x{int.from_bytes(message[15:], 'little'):04X}, should be 0x{crc16(message[2:15]):04X}"


def split_checked(data: bytes, piece_at: Callable[[bytes, int], Piece | str]) -> Iterator[Piece]:
    """After an error the search goes on at the next byte: a frame may begin inside a bad one."""
    at = garbage_from = 0
    fault = ""
    while at < len(data):
        found = piece_at(data, at)
        if isinstance(found, Piece) and found.kind == "truncated":
            behind = whole_behind(data, at + 1, piece_at)
            if behind:
                found = f"a frame of which no more than {behind - at} bytes came"
        if isinstance(found, str):
            fault = fault or found
            at += 1
            continue
        if garbage_from < at:
            yield Piece(garbage_from, at - garbage_from, "garbage", fault)
        yield found
        at = garbage_from = at + found.size
        fault = ""
    if garbage_from < at:
        yield Piece(garbage_from, at - garbage_from, "garbage", fault)


def whole_behind(data: bytes, at: int, piece_at: Callable[[bytes, int], Piece | str]) -> int:
    """Where, in the last bytes of a capture, something with a good check begins; 0: nowhere."""
    for place in range(at, len(data)):
        found = piece_at(data, place)
        if isinstance(found, Piece) and found.kind in ("packet", "stamp"):
            return place
    return 0


SPLITTERS: dict[Framing, Callable[[bytes], Iterator[Piece]]] = {
    "tcp": split_tcp,
    "cpx-uart": lambda data: split_checked(data, uart_piece),
    "stamps": lambda data: split_checked(data, stamp_piece),
    "spi": split_spi,
}
