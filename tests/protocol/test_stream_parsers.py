"""Packets out of streams with garbage in them, against a few lines of Python that say what should come out.

Each model tries the specification at every byte: what it accepts is taken, anything else costs one byte. The parsers
must find the same packets however the bytes arrive, and account for every byte.
"""

from collections.abc import Iterable
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from wire_format import Values
from wire_formats import BY_NAME
from wire_packets import ROUTES, read_packet

from host.native import ffi, lib
from host.protocol.spec import cpx, cpx_link

seeded = settings(derandomize=True, deadline=None, max_examples=150)

UART, LINK, STAMP = BY_NAME["CPX over UART"], BY_NAME["CPX over TCP and SPI"], BY_NAME["stamp message"]
FILLER = bytes(103)
"""At the end of a stream: no message is longer, so all before it is judged."""


def greedy(parse: Any, stream: bytes) -> list[Values]:
    found, at = [], 0
    while at < len(stream):
        one = parse(stream[at : at + 103])
        found += [one[0]] if one else []
        at += one[1] if one else 1
    return found


# UART2


def uart_packets(stream: bytes) -> list[Values]:
    """Credits give no packet, and wrong versions are dropped."""
    return [values for values in greedy(UART.parse, stream) if values and values["route"]["version"] == 0]


def receive_uart(stream: Iterable[int], gap_before: dict[int, int] | None = None) -> tuple[list[Values], Any]:
    """Byte by byte, 17 us apart, with longer silences before the given places."""
    line, packet, found = ffi.new("cpx_uart_t *"), ffi.new("cpx_packet_t *"), []
    now_us = 0
    lib.cpx_uart_init(line, now_us)
    for place, byte in enumerate(stream):
        now_us += 17 + (gap_before or {}).get(place, 0)
        if lib.cpx_uart_receive(line, byte, now_us, packet):
            found.append(read_packet([packet], 0))
            lib.cpx_uart_accept(line)
    return found, line


def streams(valid: st.SearchStrategy[bytes], near: bytes) -> st.SearchStrategy[bytes]:
    """Messages, damaged ones, halves of them, and garbage that likes their first bytes."""
    damaged = st.tuples(valid, st.integers(0, 200), st.integers(1, 255)).map(
        lambda parts: bytes(
            byte ^ (parts[2] if place == parts[1] % len(parts[0]) else 0) for place, byte in enumerate(parts[0])
        )
    )
    half = st.tuples(valid, st.integers(1, 20)).map(lambda both: both[0][: both[1]])
    garbage = st.lists(st.sampled_from(near) | st.integers(0, 255), max_size=12).map(bytes)
    return st.lists(st.one_of(valid, valid, damaged, half, garbage), max_size=8).map(b"".join)


SMALL_UART = st.fixed_dictionaries({"route": ROUTES, "data": st.binary(max_size=20)}).map(UART.build)


@given(streams(SMALL_UART | st.just(b"\xff\x00"), b"\xff\x00\x02\x04\x64"))
@seeded
def test_uart_finds_what_the_model_finds(stream: bytes) -> None:
    found, line = receive_uart(stream + FILLER)
    assert found == uart_packets(stream + FILLER)
    everything = [UART.parse(UART.build(values)) for values in greedy(UART.parse, stream + FILLER) if values]
    in_packets = sum(one[1] for one in everything if one)
    left = line.rx_fill - line.rx_taken
    assert in_packets + 2 * line.credits_in + line.garbage_bytes + left == len(stream + FILLER)
    assert line.packets_in == len(found)


def test_uart_keeps_all_packets_around_garbage() -> None:
    first, second = bytes.fromhex("ff040a042001d4"), bytes.fromhex("ff04510432019d")
    stream = b"\x00garbage" + first + b"\xff\x01\xff\xc8" + second + b"\xff\xff" + first + b"\xff\x00" + FILLER
    found, line = receive_uart(stream)
    assert [values["data"].hex() for values in found] == ["2001", "3201", "2001"]
    assert line.bad_length == 4  # FF 01, FF C8, FF FF, FF FF
    assert line.credits_in == 1
    assert line.garbage_bytes == 8 + 4 + 2 + len(FILLER)


def test_uart_gives_up_half_a_frame_after_silence() -> None:
    """Without the silence the second frame is eaten by the first, which asks for 100 bytes."""
    half, whole = bytes.fromhex("ff640a0420"), bytes.fromhex("ff040a042001d4")
    assert receive_uart(half + whole)[0] == []
    assert receive_uart(half + whole, {len(half): lib.CPX_UART_GAP_US - 18})[0] == []
    found, line = receive_uart(half + whole, {len(half): lib.CPX_UART_GAP_US})
    assert [values["data"].hex() for values in found] == ["2001"]
    assert line.gaps == 1


# UART1


def receive_stamps(stream: bytes) -> tuple[list[Values], Any]:
    parser, message, found = ffi.new("uart1_rx_t *"), ffi.new("uart1_message_t *"), []
    lib.uart1_rx_init(parser, lib.UART1_STAMP)
    for byte in stream:
        lib.uart1_rx_put(parser, byte)
        if lib.uart1_rx_take(parser, message):
            found.append(STAMP.read([message.stamp], 17))
    return found, parser


@given(streams(STAMP.values.map(STAMP.build), b"\xd5\x2a"))
@seeded
def test_stamps_are_what_the_model_finds(stream: bytes) -> None:
    found, parser = receive_stamps(stream + FILLER)
    assert found == greedy(STAMP.parse, stream + FILLER)
    assert parser.received == len(found)
    assert 17 * parser.received + parser.garbage_bytes + parser.fill == len(stream + FILLER)


@pytest.mark.parametrize("size", range(1, 17))
def test_a_stamp_cut_short_does_not_cost_the_next(size: int) -> None:
    wire = STAMP.build({"sequence": 1, "stm32_us": 0x2AD52AD52AD5, "epoch": 2})
    found, parser = receive_stamps(wire[:size] + wire + FILLER)
    assert [values["sequence"] for values in found] == [1]
    assert parser.bad_check >= 1 or size < 2


# TCP


def tcp_packets(stream: bytes) -> list[Values]:
    found, at = [], 0
    while at + 4 <= len(stream):
        length = int.from_bytes(stream[at : at + 2], "little")
        if not (2 <= length <= 1022 and cpx.forwardable(cpx.ROUTE.parse(stream[at + 2 : at + 4]))):
            at += 1
        elif at + 2 + length > len(stream):
            break
        else:
            one = LINK.parse(stream[at:])
            assert one is not None
            found.append(one[0])
            at += 2 + length
    return found


def receive_tcp(blocks: Iterable[bytes]) -> tuple[list[Values], Any]:
    parser, packet, found = ffi.new("cpx_tcp_rx_t *"), ffi.new("cpx_packet_t *"), []
    lib.cpx_tcp_rx_init(parser)
    for block in blocks:
        memory = ffi.new("uint8_t[]", len(block))
        ffi.buffer(memory)[:] = block
        view = ffi.new("bytes_t *", (memory, len(block)))
        while lib.cpx_tcp_rx(parser, view, packet):
            found.append(read_packet([packet], 0))
        assert view.size == 0
    return found, parser


TARGETS = st.integers(1, 4)
GOOD_ROUTES = ROUTES.flatmap(
    lambda route: st.tuples(TARGETS, TARGETS).map(
        lambda ends: route | {"version": 0, "source": ends[0], "destination": ends[1]}
    )
)
SMALL_LINK = st.fixed_dictionaries({"route": GOOD_ROUTES, "data": st.binary(max_size=20)}).map(cpx_link.FRAME.build)


@given(streams(SMALL_LINK, b"\x00\x02\x04\x19\x63\xff"))
@settings(seeded, max_examples=50)
def test_tcp_finds_the_same_at_every_split_point(stream: bytes) -> None:
    expected = tcp_packets(stream)
    whole, parser = receive_tcp([stream])
    assert whole == expected
    used = sum(4 + len(values["data"]) for values in whole)
    assert used + parser.skipped_bytes + parser.rx_fill == len(stream)
    assert parser.packets_in == len(whole)
    assert receive_tcp(stream[at : at + 1] for at in range(len(stream)))[0] == expected
    for at in range(len(stream) + 1):
        assert receive_tcp([stream[:at], stream[at:]])[0] == expected


def test_tcp_finds_its_place_again() -> None:
    bridge = bytes.fromhex("040019012101")
    found, parser = receive_tcp([b"\xff" * 5 + bridge + b"\x00\x00\xff\xff" + bridge])
    assert [values["data"].hex() for values in found] == ["2101", "2101"]
    assert parser.skipped_bytes == 9


def test_tcp_takes_the_longest_packet_and_no_longer() -> None:
    route = {"destination": 1, "source": 3, "function": 1, "version": 0, "last_packet": False, "reserved": False}
    longest = cpx_link.FRAME.build({"route": route, "data": bytes(1020)})
    assert [len(values["data"]) for values in receive_tcp([longest])[0]] == [1020]
    too_long = (1023).to_bytes(2, "little") + longest[2:]
    found, parser = receive_tcp([too_long[:4]])
    assert (found, parser.skipped_bytes) == ([], 1)
