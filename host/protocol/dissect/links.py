"""CPX and NanoCockpit over TCP and over SPI: a length, a route, data, and no check. A header is believed for what it
announces and for what lies behind its packet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from construct import ConstructError

from ..spec import cpx, cpx_link, image, nanocockpit, native, paper
from .piece import Piece

CHAIN = 3
"""So many packets in a row are no accident."""
HEADER_BYTES = 4
TARGETS = {target.number for target in cpx.TARGETS}
FUNCTIONS = {function.number for function in cpx.FUNCTIONS}
HOST_TO_GAP8, GAP8_TO_HOST, APP, STREAMER = 0x1C, 0x23, 0x05, 0x06
NATIVE_MAGIC = 0x4E
NATIVE_KINDS = {kind.number for kind in native.KINDS if kind.number < 16}
"""Those that the robot sends."""
CUT = "a packet that ends in the middle"


@dataclass(frozen=True)
class Rule:
    """How the length of a packet counts, and what is sent by that rule."""

    uncounted: int
    """Bytes of the header that the length leaves out."""
    lengths: range
    functions: frozenset[int]
    frame: Any
    unmistakable: Callable[[bytes], bool]
    """Is this packet so particular that it needs no others behind it?"""

    def size(self, data: bytes, at: int) -> tuple[int, str]:
        """(bytes of the packet that the header here announces, "") or (0, what is wrong with it)."""
        left = len(data) - at
        if left < HEADER_BYTES:
            return 0, f"{left} of the {HEADER_BYTES} bytes of a header"
        length = int.from_bytes(data[at : at + 2], "little")
        if length not in self.lengths:
            return 0, f"length {length}: {self.lengths[0]}..{self.lengths[-1]} is possible"
        fault = route_fault(bytes(data[at + 2 : at + 4]))
        return (0, fault) if fault else (self.uncounted + length, "")

    def oddity(self, data: bytes, at: int) -> str:
        """What existing firmware would never send in the header here, though it could be routed, or nothing."""
        version, function = version_and_function(bytes(data[at + 2 : at + 4]))
        if version != cpx.VERSION:
            return f"version {version}, which every receiver drops"
        return "" if function in self.functions else f"function {function} is not known"

    def packet(self, data: bytes, at: int, size: int, taken: int) -> Piece:
        """The one here, and how many bytes of the capture it takes."""
        return Piece(at, taken, "packet", content=self.frame.parse(data[at : at + size]))


@lru_cache(1 << 16)
def route_fault(route: bytes) -> str:
    """Why no router would pass this route on, or nothing."""
    parsed = cpx.ROUTE.parse(route)
    for name in ("source", "destination"):
        if parsed[name] not in TARGETS:
            return f"{name} {parsed[name]} is none of {min(TARGETS)}..{max(TARGETS)}"
    return ""


@lru_cache(1 << 16)
def version_and_function(route: bytes) -> tuple[int, int]:
    parsed = cpx.ROUTE.parse(route)
    return parsed.version, parsed.function


def parses(struct: Any, data: bytes) -> bool:
    try:
        struct.parse(data)
    except ConstructError:
        return False
    return True


def begins_cpx_image(packet: bytes) -> bool:
    """An image header, or a native message."""
    if packet[2] & 0x3F != GAP8_TO_HOST or packet[3] != APP:
        return False
    if len(packet) > 5 and packet[4] == NATIVE_MAGIC:
        return packet[5] in NATIVE_KINDS
    return parses(image.STOCK_HEADER, packet[4:]) or parses(paper.HEADER, packet[4:])


def begins_buffer(packet: bytes) -> bool:
    """An image, or the host's answer to one."""
    if packet[2] & 0x3F not in (HOST_TO_GAP8, GAP8_TO_HOST) or packet[3] != STREAMER:
        return False
    kinds = {0x01: nanocockpit.METADATA, 0xF0: nanocockpit.REPLY}
    known = parses(nanocockpit.BEGIN, packet[4:]) and packet[5] in kinds
    return known and parses(kinds[packet[5]], packet[4 + nanocockpit.BEGIN.sizeof() :])


CPX = Rule(2, range(2, 1023), frozenset(FUNCTIONS - {STREAMER}), cpx_link.FRAME, begins_cpx_image)
NANOCOCKPIT = Rule(4, range(1, 4089), frozenset(FUNCTIONS), nanocockpit.FRAME, begins_buffer)


def unpadded(size: int) -> int:
    """Bytes that a packet takes on TCP."""
    return size


def padded(size: int) -> int:
    """Bytes that a packet takes on SPI, at least: the window is a multiple of four, and never shorter than eight."""
    return cpx_link.window_bytes(size, size)


def begins(rule: Rule, data: bytes, at: int, stride: Callable[[int], int]) -> bool:
    """Do packets that firmware would send lie here in a row, CHAIN of them or up to the end of the capture?"""
    for number in range(CHAIN):
        size, _ = rule.size(data, at)
        if size == 0 or rule.oddity(data, at):
            return False
        if number == 0 and at + size <= len(data) and rule.unmistakable(data[at : at + size]):
            return True
        at += stride(size)
        if at >= len(data):
            return at == len(data)
    return True


def believable(rule: Rule, data: bytes, at: int, size: int) -> str:
    """What speaks against the packet here, whose header is possible; or nothing."""
    end = at + size
    odd = rule.oddity(data, at)
    if odd and end != len(data) and rule.size(data, end)[0] == 0:
        return f"{odd}, and no header behind it"
    return ""


def split_tcp(rule: Rule, data: bytes) -> Iterator[Piece]:
    """A packet is held back until what follows it has been seen: its length may be wrong."""
    at, held = 0, None
    while at < len(data):
        size, fault = rule.size(data, at)
        if size and at + size <= len(data):
            fault = believable(rule, data, at, size)
            if not fault:
                if held is not None:
                    yield held
                held = rule.packet(data, at, size, size)
                at += size
                continue
        start = next_start(rule, data, at + 1 if held is None else held.offset + 1)
        if held is not None and start is not None and start < at:
            length = held.size - rule.uncounted
            yield Piece(held.offset, start - held.offset, "garbage", f"length {length} leads to no header ({fault})")
        else:
            if held is not None:
                yield held
            end = len(data) if start is None else start
            yield cut_off(rule, data, at) if start is None else Piece(at, end - at, "garbage", fault or CUT)
        held = None
        at = len(data) if start is None else start
    if held is not None:
        yield held


def cut_off(rule: Rule, data: bytes, at: int) -> Piece:
    """What lies at the end of the capture and is followed by nothing."""
    left = len(data) - at
    size, fault = rule.size(data, at)
    fault = fault or rule.oddity(data, at)
    if size > left and not fault:
        return Piece(at, left, "truncated", f"the capture ends after {left} of {size} bytes of a packet")
    if left < HEADER_BYTES:
        return Piece(at, left, "truncated", f"the capture ends after {fault}")
    return Piece(at, left, "garbage", fault)


def next_start(rule: Rule, data: bytes, at: int) -> int | None:
    """Where packets begin again."""
    return next((place for place in range(at, len(data)) if begins(rule, data, place, unpadded)), None)


def split_spi(rule: Rule, data: bytes) -> Iterator[Piece]:
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
        size, fault = rule.size(data, at)
        if size and at + size <= len(data) and not rule.oddity(data, at):
            end = min(at + padded(size), len(data))
            yield rule.packet(data, at, size, end - at)
            at = end
            continue
        start = next_window(rule, data, at + 1)
        end = len(data) if start is None else start
        yield cut_off(rule, data, at) if start is None else Piece(at, end - at, "garbage", fault or CUT)
        at = end


def next_window(rule: Rule, data: bytes, at: int) -> int | None:
    """Where a window begins again: an idle one, or packets in a row."""
    for place in range(at, len(data)):
        if data[place : place + 8] == bytes(8) or begins(rule, data, place, padded):
            return place
    return None
