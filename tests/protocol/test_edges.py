"""The last value that is accepted and the first that is not, for every range of every format."""

from collections.abc import Iterator

import pytest
from wire_format import decode, encode
from wire_formats import BY_NAME
from wire_repairs import (
    repair_crc16,
    repair_frame,
    repair_log,
    repair_pairs,
    repair_paper,
    repair_state,
    repair_status,
    repair_uart,
)

Case = tuple[str, bytes, bool]
MEGABYTE = 1 << 20


def pictures(name: str, encoding: str, size: str) -> Iterator[Case]:
    """The C encoders write what they are told: so they make the refused messages too."""

    def case(accepted: bool, kind: int, width: int, height: int, depth: int, body: int) -> Case:
        picture = {"width": width, "height": height, "depth": depth, encoding: kind, size: body}
        if name == "paper header":
            picture |= dict.fromkeys(("frame_stm32_ms", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), 0)
        return name, encode(BY_NAME[name], picture, 0), accepted

    for side, accepted in ((0, False), (1, True), (1024, True), (1025, False)):
        yield case(accepted, 1, side, 8, 1, 50)
        yield case(accepted, 1, 8, side, 1, 50)
        yield case(accepted, 0, side, 8, 1, side * 8)
        yield case(accepted, 0, 8, side, 1, side * 8)
    for depth, accepted in ((0, False), (1, True), (4, True), (5, False)):
        yield case(accepted, 1, 8, 8, depth, 50)
        yield case(accepted, 0, 8, 8, depth, 64 * depth)
    for body, accepted in ((0, False), (1, True), (MEGABYTE, True), (MEGABYTE + 1, False)):
        yield case(accepted, 1, 8, 8, 1, body)
    for body, accepted in ((63, False), (64, True), (65, False)):
        yield case(accepted, 0, 8, 8, 1, body)
    yield case(True, 0, 1024, 1024, 1, MEGABYTE)
    yield case(False, 0, 1024, 1024, 2, 2 * MEGABYTE)
    yield case(False, 2, 8, 8, 1, 64)


def starts(name: str, wire: bytes, size: int) -> Iterator[Case]:
    """No bit of the first bytes may be another."""
    yield name, wire, True
    for bit in range(8 * size):
        changed = bytearray(wire)
        changed[bit // 8] ^= 1 << bit % 8
        yield name, bytes(changed), False


def cases() -> Iterator[Case]:
    yield from pictures("stock header", "type", "size")
    yield from pictures("native frame", "encoding", "body_bytes")
    stock = bytes.fromhex("bc4401f4000100d0340100")
    yield from starts("stock header", stock, 1)
    yield "stock header", stock + b"\0", False

    frame = encode(BY_NAME["native frame"], {"width": 1, "height": 1, "depth": 1, "body_bytes": 1}, 0)
    yield from starts("native frame", frame, 144)
    short = ((103, 0, False), (104, 0, True), (127, 0, True))
    for header_bytes, more, accepted in (
        *short,
        (128, 5, True),
        (143, 0, True),
        (144, 0, True),
        (145, 0, False),
        (145, 1, True),
    ):
        wire = repair_frame(frame[:2] + bytes([header_bytes, 0]) + frame[4:])
        yield "native frame", wire + bytes(more), accepted

    for count, accepted in ((0, False), (1, True), (48, True), (49, False), (255, False)):
        yield "native pairs", repair_pairs(bytes([0x4E, 3, count]) + bytes(9 + 21 * 255)), accepted
    yield from starts("native pairs", repair_pairs(bytes([0x4E, 3, 1]) + bytes(9 + 21)), 2 + 1 + 1 + 4 + 21 + 4)
    yield from starts("echo question", repair_crc16(bytes.fromhex("d52b070000")), 5)
    yield from starts("echo answer", repair_crc16(bytes.fromhex("d52c") + bytes(15)), 17)
    yield from starts("native data", bytes([0x4E, 2]) + bytes(7), 2)
    yield from starts("native status", repair_status(bytes([0x4E, 4]) + bytes(62)), 64)
    yield from starts("native log", repair_log(bytes([0x4E, 6]) + bytes(50)), 52)
    for state, accepted in ((0, True), (9, True), (10, False), (255, False)):
        yield "native log", repair_log(bytes([0x4E, 6, state]) + bytes(49)), accepted
    yield from starts("native reply", bytes([0x4E, 5]) + bytes(2), 2)
    yield from starts("native camera", bytes([0x4E, 17]) + bytes(12), 2)
    spare_used = repair_status(bytes([0x4E, 4, 1, 2]) + bytes(60))
    yield "native status", spare_used + b"\0", True

    yield from starts("native stream", bytes([0x4E, 16]) + bytes(4), 2)
    for dialect, accepted in ((1, True), (2, False), (255, False)):
        yield "native stream", bytes([0x4E, 16, dialect, 9, 0, 0]), accepted
    for data_max, accepted in ((1, False), (143, False), (144, True), (1020, True), (1021, False), (65535, False)):
        yield "native stream", bytes([0x4E, 16, 1, 0]) + data_max.to_bytes(2, "little"), accepted

    for length, accepted in ((0, True), (1, False), (2, True), (100, True), (101, False), (255, False)):
        yield "CPX over UART", repair_uart(bytes([0xFF, length]) + bytes(260)), accepted
    yield from starts("CPX over UART", bytes.fromhex("ff030a0420d2"), 6)
    for length, accepted in ((0, True), (1, False), (2, True), (1022, True), (1023, False), (65535, False)):
        yield "CPX over TCP and SPI", length.to_bytes(2, "little") + bytes(65535), accepted
    yield from starts("stamp message", bytes.fromhex("d52a40e2010074f3c8f4e5000000036f5d"), 17)
    for head in (0xD2, 0xD6, 0xDE, 0xD3, 0xC2, 0x92):
        yield "beacon", bytes([head, 0x62]) + bytes(12), head & 0xF3 == 0xD2
    for wire, accepted in ((b"\xd2\x62", True), (b"\xd2\x63", False)):
        yield "beacon", wire + bytes(12), accepted
        yield "beacon", wire + bytes(11), False
    yield from dialects()


def dialects() -> Iterator[Case]:
    yield from pictures("paper header", "type", "size")
    header = bytes.fromhex("bc4401f4000100d0340100") + bytes(32)
    yield from starts("paper header", header, 1)
    for cut, accepted in ((1, False), (0, True)):
        yield "paper header", header[: len(header) - cut], accepted
    yield "paper header", header + b"\0", False
    yield from starts("paper stamp", repair_paper(bytes.fromhex("bc2501") + bytes(37)), 40)
    yield "paper stamp", bytes.fromhex("bc2501") + bytes(36) + b"\x02", False
    for size, accepted in ((7, False), (8, True), (9, False)):
        yield "paper camera", bytes(size), accepted
    yield "paper camera", b"\1" + bytes(7), False

    yield from starts("nanocockpit state", repair_state(b"!STA" + bytes(36)), 40)
    for sign in (b"!RNG", b"!TOF", b"!STB"):
        yield "nanocockpit state", sign + bytes(90), False
    for length, accepted in ((0, True), (1, True), (4088, True), (4089, False), (65535, False)):
        yield "nanocockpit frame", length.to_bytes(2, "little") + bytes(65537), accepted
    yield from starts("nanocockpit begin", b"\x10" + bytes(11), 1)
    metadata = bytes.fromhex("0a 0600 0400 01 00") + bytes(141)
    yield from starts("nanocockpit metadata", metadata, 1)
    for place, value, accepted in (
        *((1, side, ok) for side, ok in ((0, False), (1, True), (1024, True), (1025, False))),
        *((3, side, ok) for side, ok in ((0, False), (1, True), (1024, True), (1025, False))),
        *((5, depth, ok) for depth, ok in ((0, False), (1, True), (4, True), (5, False))),
        *((6, format_, ok) for format_, ok in ((0, True), (1, False))),
    ):
        wide = 2 if place < 5 else 1
        changed = metadata[:place] + value.to_bytes(wide, "little") + metadata[place + wide :]
        yield "nanocockpit metadata", changed, accepted
    for size, accepted in ((24, False), (25, True), (26, False)):
        yield "nanocockpit reply", bytes(size), accepted


@pytest.mark.parametrize("name", BY_NAME)
def test_edges(name: str) -> None:
    for format_name, wire, accepted in cases():
        if format_name == name:
            assert (decode(BY_NAME[name], wire) is not None) == accepted, wire[:120].hex(" ")
            assert (BY_NAME[name].parse(wire) is not None) == accepted, wire[:120].hex(" ")
