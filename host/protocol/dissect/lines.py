"""The two UARTs: what goes over them has a start and a check."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

from construct import ConstructError

from ..spec import cpx_uart, tables
from ..spec.checks import crc16, crc32, xor8
from .piece import Piece


def uart_piece(data: bytes, at: int) -> Piece | str:
    """What begins here on UART2, or why nothing does."""
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


class Message(NamedTuple):
    """One on UART1."""

    layout: str
    """Its table in docs/PROTOCOL.md."""
    start: bytes
    size: int
    check: str
    check_bytes: int
    covered_from: int
    compute: Callable[[bytes], int]


MESSAGES = (
    Message("stamp", b"\xd5\x2a", 17, "CRC-16", 2, 2, crc16),
    Message("echo question", b"\xd5\x2b", 5, "CRC-16", 2, 2, crc16),
    Message("echo answer", b"\xd5\x2c", 17, "CRC-16", 2, 2, crc16),
    Message("paper stamp", b"\xbc\x25\x01", 40, "check byte", 1, 2, xor8),
    Message("nanocockpit state", b"!STA", 40, "CRC-32", 4, 0, crc32),
    Message("nanocockpit noise", b"!RNG", 12, "CRC-32", 4, 0, crc32),
    Message("nanocockpit ranges", b"!TOF", 76, "CRC-32", 4, 0, crc32),
)


def stamp_piece(data: bytes, at: int) -> Piece | str:
    """What begins here on UART1, of any firmware, or why nothing does."""
    left = len(data) - at
    for message in MESSAGES:
        if data[at : at + len(message.start)] == message.start[:left]:
            return message_piece(message, data, at)
    return f"0x{data[at]:02X} is no start"


def message_piece(message: Message, data: bytes, at: int) -> Piece | str:
    """Behind its start."""
    left, name = len(data) - at, message.layout + " message"
    if left < message.size:
        return Piece(at, left, "truncated", f"the capture ends after {left} of {message.size} bytes of a {name}")
    raw = data[at : at + message.size]
    try:
        content = tables.LAYOUTS[message.layout].parse(raw).covered.value
    except ConstructError:
        end, digits = message.size - message.check_bytes, 2 * message.check_bytes
        is_, should = int.from_bytes(raw[end:], "little"), message.compute(raw[message.covered_from : end])
        return f"{message.check} of a {name} is 0x{is_:0{digits}X}, should be 0x{should:0{digits}X}"
    return Piece(at, message.size, "stamp", content=content, layout=message.layout)


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
