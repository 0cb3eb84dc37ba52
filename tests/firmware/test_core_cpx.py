"""The CPX route, and packets over SPI and TCP."""

import random
from typing import Any

import pytest
from c_memory import POISONS, Bytes, Room, poisoned, seen, untouched

from host.native import ffi, lib

# Bytes of real links, and what they mean: destination, source, function, version, last packet, reserved, data.
SPI_START_GAP8 = bytes.fromhex("03 00 54 0f 06")
TCP_BRIDGE_ON = bytes.fromhex("04 00 19 01 21 01")
TCP_IMAGE_HEADER = bytes.fromhex("0d 00 63 05 bc 44 01 f4 00 01 00 d0 34 01 00")
VECTORS = [
    (SPI_START_GAP8, (4, 2, 15, 0, True, False), "06"),
    (TCP_BRIDGE_ON, (1, 3, 1, 0, False, False), "21 01"),
    (TCP_IMAGE_HEADER, (3, 4, 5, 0, True, False), "bc 44 01 f4 00 01 00 d0 34 01 00"),
]
Fields = tuple[int, int, int, int, bool, bool]


def route_fields(route: Any) -> Fields:
    return (route.destination, route.source, route.function, route.version, route.last_packet, route.reserved)


def new_route(fields: Fields) -> Any:
    names = ("destination", "source", "function", "version", "last_packet", "reserved")
    return ffi.new("cpx_route_t *", dict(zip(names, fields, strict=True)))


def encode(fields: Fields, data: bytes, room: Room) -> int:
    source = Bytes(data)
    return int(lib.cpx_link_encode(ffi.new("cpx_packet_t *", (new_route(fields)[0], source.view)), room.view))


@pytest.mark.parametrize(("frame", "fields", "data"), VECTORS)
def test_route_vectors(frame: bytes, fields: Fields, data: str) -> None:
    out = ffi.new("uint8_t[2]")
    lib.cpx_route_encode(new_route(fields), out)
    assert bytes(out) == frame[2:4]
    route = ffi.new("cpx_route_t *")
    lib.cpx_route_decode(frame[2:4], route)
    assert route_fields(route) == fields


def test_every_two_bytes_are_a_route_and_come_back() -> None:
    route, out = ffi.new("cpx_route_t *"), ffi.new("uint8_t[2]")
    for value in range(1 << 16):
        wire = value.to_bytes(2, "little")
        lib.cpx_route_decode(wire, route)
        lib.cpx_route_encode(route, out)
        assert bytes(out) == wire
        ends = route.destination in (1, 2, 3, 4) and route.source in (1, 2, 3, 4)
        assert lib.cpx_route_ok(route) == (ends and route.version == 0)


def test_route_fields_too_wide_are_masked() -> None:
    out = ffi.new("uint8_t[2]")
    lib.cpx_route_encode(new_route((0xF9, 0xFA, 0xC1, 0xFC, False, False)), out)
    assert bytes(out) == bytes([0x1 | 0x2 << 3, 0x01])


@pytest.mark.parametrize(("frame", "fields", "data"), VECTORS)
@pytest.mark.parametrize("poison", POISONS)
def test_link_encode(frame: bytes, fields: Fields, data: str, poison: int) -> None:
    room = Room(len(frame) + 4, poison)
    assert encode(fields, bytes.fromhex(data), room) == len(frame)
    assert bytes(room) == frame + bytes([poison]) * 4
    for size in range(len(frame)):
        room = Room(size, poison)
        assert encode(fields, bytes.fromhex(data), room) == 0
        assert bytes(room) == bytes([poison]) * size


@pytest.mark.parametrize(("frame", "fields", "data"), VECTORS)
@pytest.mark.parametrize("tail", [0, 1, 2000])
def test_link_decode(frame: bytes, fields: Fields, data: str, tail: int) -> None:
    packet, wire = ffi.new("cpx_packet_t *"), Bytes(frame + bytes(tail))
    assert lib.cpx_link_decode(wire.view, packet) == len(frame)
    assert route_fields(packet.route) == fields
    assert seen(packet.data) == bytes.fromhex(data)


@pytest.mark.parametrize(
    ("wire", "result"),
    [
        *((TCP_IMAGE_HEADER[:size], "ERR_SHORT") for size in range(len(TCP_IMAGE_HEADER))),
        (b"\x00\x00\x00", "ERR_SHORT"),
        (b"\x01\x00", "ERR_LENGTH"),
        (b"\x01\x00\x63\x05", "ERR_LENGTH"),
        (b"\xff\x03", "ERR_LENGTH"),
        (b"\xff\xff" + bytes(1100), "ERR_LENGTH"),
    ],
)
@pytest.mark.parametrize("poison", POISONS)
def test_link_decode_refuses_and_leaves_the_packet_alone(wire: bytes, result: str, poison: int) -> None:
    packet = poisoned("cpx_packet_t", poison)
    assert lib.cpx_link_decode(Bytes(wire).view, packet) == getattr(lib, result)
    assert untouched(packet, poison)


def test_link_decode_idle_and_longest() -> None:
    packet, wire = poisoned("cpx_packet_t", 0xA5), Bytes(b"\x00\x00\xff\xff")
    assert lib.cpx_link_decode(wire.view, packet) == 4
    assert packet.data.size == 0
    assert route_fields(packet.route) == (0, 0, 0, 0, False, False)

    longest = random.Random(3).randbytes(1020)
    wire = Bytes(b"\xfe\x03\x63\x05" + longest)
    assert lib.cpx_link_decode(wire.view, packet) == 1024
    assert seen(packet.data) == longest


def test_link_encode_refuses_too_much_and_the_header_is_clamped() -> None:
    route: Fields = (3, 4, 5, 0, True, False)
    room = Room(2000)
    assert encode(route, bytes(1021), room) == 0
    assert set(bytes(room)) == {0xA5}
    header = ffi.new("uint8_t[4]")
    lib.cpx_link_header(new_route(route), 70000, header)
    assert bytes(header) == b"\xfe\x03\x63\x05"
    lib.cpx_link_header(new_route(route), 11, header)
    assert bytes(header) == TCP_IMAGE_HEADER[:4]


@pytest.mark.parametrize(
    ("master", "slave", "window"),
    [
        (4, 4, 8),
        (4, 5, 8),
        (5, 4, 8),
        (8, 4, 8),
        (9, 4, 12),
        (4, 9, 12),
        (12, 12, 12),
        (13, 1024, 1024),
        (1021, 4, 1024),
    ],
)
def test_spi_window(master: int, slave: int, window: int) -> None:
    assert lib.cpx_spi_window_bytes(master, slave) == window


class TcpRx:
    def __init__(self) -> None:
        self.state = ffi.new("cpx_tcp_rx_t *")
        lib.cpx_tcp_rx_init(self.state)
        self.packets: list[tuple[int, bytes]] = []

    def take(self, data: bytes) -> None:
        wire = Bytes(data)
        view = ffi.new("bytes_t *", wire.view)
        packet = ffi.new("cpx_packet_t *")
        while lib.cpx_tcp_rx(self.state, view, packet):
            self.packets.append((packet.route.function, seen(packet.data)))
        assert view.size == 0


LONGEST = b"\xfe\x03\x63\x05" + random.Random(4).randbytes(1020)
EMPTY = b"\x02\x00\x19\x01"
STREAM = TCP_BRIDGE_ON + EMPTY + LONGEST + TCP_IMAGE_HEADER
STREAM_PACKETS = [(1, b"\x21\x01"), (1, b""), (5, LONGEST[4:]), (5, TCP_IMAGE_HEADER[4:])]


def test_tcp_rx_at_every_split() -> None:
    for split in range(len(STREAM) + 1):
        rx = TcpRx()
        rx.take(STREAM[:split])
        rx.take(STREAM[split:])
        assert rx.packets == STREAM_PACKETS, split
        assert (rx.state.packets_in, rx.state.skipped_bytes) == (4, 0)


def test_tcp_rx_byte_by_byte() -> None:
    rx = TcpRx()
    for byte in STREAM:
        rx.take(bytes([byte]))
    assert rx.packets == STREAM_PACKETS


@pytest.mark.parametrize(
    "garbage",
    [
        "00",
        "00 00 00 00",
        "ff ff ff ff ff",
        "01 00 19 01",  # length 1
        "ff 03 19 01",  # length 1023
        "04 00 18 01",  # nobody's destination
        "04 00 01 01",  # nobody's source
        "04 00 19 41",  # version 1
        "ff 03 19",  # a header cut off
    ],
)
def test_tcp_rx_skips_to_the_next_plausible_header(garbage: str) -> None:
    wire = bytes.fromhex(garbage)
    rx = TcpRx()
    rx.take(wire + TCP_BRIDGE_ON + TCP_IMAGE_HEADER)
    assert rx.packets == [(1, b"\x21\x01"), (5, TCP_IMAGE_HEADER[4:])]
    assert rx.state.skipped_bytes == len(wire)
