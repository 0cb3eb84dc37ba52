"""CPX over UART2 in the STM32's place, and the stamps on UART1."""

from __future__ import annotations

import struct

from made_streams import GAP8_TO_HOST_CONSOLE, bodies, causes, comparable, native, pixels, received, stock, uart
from made_streams import uart_pieces as pieces

from host.link.frame import Frame
from host.link.records import Console, Garbage, Stamp
from host.link.session import Session
from host.protocol.packets import CameraSettings

BODY = pixels(60, 50, 1)
CREDIT = b"\xff\x00"


def on_uart(packets: list[bytes]) -> list[bytes]:
    return [piece for each in packets for piece in pieces(each)]


STOCK = on_uart(stock(BODY, 60, 50))
NATIVE = [on_uart(native(number, BODY, 60, 50)) for number in range(4)]


def test_frames_of_both_dialects() -> None:
    stream = b"".join(STOCK) + b"".join(b"".join(each) for each in NATIVE)
    events, session = received(stream, framing="cpx-uart")
    assert bodies(events) == [BODY] * 5
    assert [each.native.frame for each in events if isinstance(each, Frame) and each.native] == [0, 1, 2, 3]
    assert session.counters.garbage_bytes == 0
    assert not any(session.counters.frames_lost.values())


def test_byte_by_byte_gives_the_same() -> None:
    stream = b"".join(STOCK) + uart(b"hi\0", GAP8_TO_HOST_CONSOLE) + b"\x01\x02\x03" + b"".join(NATIVE[0])
    whole, _ = received(stream, framing="cpx-uart")
    assert comparable(received(stream, range(1, len(stream)), framing="cpx-uart")[0]) == comparable(whole)
    (garbage,) = [event for event in whole if isinstance(event, Garbage)]
    assert (garbage.offset, garbage.size) == (stream.index(b"\x01\x02\x03"), 3)


def test_other_packets_between_the_pieces_of_one() -> None:
    console = uart(b"between\0", GAP8_TO_HOST_CONSOLE)
    events, _ = received(console.join(NATIVE[0]), framing="cpx-uart")
    assert bodies(events) == [BODY]
    assert len([event for event in events if isinstance(event, Console)]) == len(NATIVE[0]) - 1


def test_a_lost_piece_costs_the_frame_it_belongs_to() -> None:
    for missing in range(2, len(NATIVE[1])):
        parts = NATIVE[0] + NATIVE[1][:missing] + NATIVE[1][missing + 1 :] + NATIVE[2] + NATIVE[3]
        events, session = received(b"".join(parts), framing="cpx-uart")
        got = [event.native.frame for event in events if isinstance(event, Frame) and event.native]
        assert {0, 3} <= set(got), f"piece {missing}"
        # Without its final piece a packet runs into the next one, which may be the next frame's header.
        assert 2 in got or missing == len(NATIVE[1]) - 1, f"piece {missing}"
        assert sum(session.counters.frames_lost.values()) == 4 - len(got), f"piece {missing}"


def test_a_damaged_piece_is_counted_and_costs_one_frame() -> None:
    for damaged in range(2, len(NATIVE[1])):
        parts = [*NATIVE[1][:damaged], NATIVE[1][damaged][:-1] + b"\xaa", *NATIVE[1][damaged + 1 :]]
        if NATIVE[1][damaged].endswith(b"\xaa"):
            continue
        events, session = received(b"".join(NATIVE[0] + parts + NATIVE[2] + NATIVE[3]), framing="cpx-uart")
        got = [event.native.frame for event in events if isinstance(event, Frame) and event.native]
        assert got == [0, 2, 3], f"piece {damaged}"
        assert session.counters.bad_check >= 1  # more if a start byte lay inside it
        assert session.counters.frames_lost["missing_data"] + session.counters.frames_lost["bad_crc"] == 1


def test_a_stock_frame_that_lost_a_piece_is_cut_short() -> None:
    for missing in range(1, len(STOCK)):
        stream = b"".join([*STOCK[:missing], *STOCK[missing + 1 :], *STOCK])
        events, _ = received(stream, framing="cpx-uart")
        assert causes(events) == ["cut_short"]
        assert bodies(events) == [BODY]


def test_credits_are_given_in_every_dialect_and_repeated_in_silence() -> None:
    session = Session("cpx-uart", "stock")
    assert session.data_to_send() == CREDIT
    assert session.data_to_send() == b""
    session.receive(uart(b"x\0", GAP8_TO_HOST_CONSOLE), 1000)
    assert session.data_to_send() == CREDIT
    session.tick(1000 + 250_000_000)
    assert session.data_to_send() == CREDIT


def test_credits_are_repeated_while_only_credits_come() -> None:
    session = Session("cpx-uart", "stock")
    sent = b""
    for now in range(0, 1_000_000_000, 100_000_000):
        session.receive(CREDIT, now)
        sent += session.data_to_send()
    assert len(sent) // 2 >= 8


def test_a_late_reader_does_not_give_up_a_packet() -> None:
    session = Session("cpx-uart", "stock")
    console = uart(b"slow\0", GAP8_TO_HOST_CONSOLE)
    assert session.receive(console[:4], 0) == []
    (event,) = session.receive(console[4:], 10**10)  # ten seconds later, but no read came back empty
    assert isinstance(event, Console)
    assert session.receive(console[:4], 10**10) == []
    session.tick(2 * 10**10)
    assert [type(each) for each in session.receive(console, 2 * 10**10)] == [Garbage, Console]
    assert session.counters.gaps == 1


def test_requests_wait_for_a_credit() -> None:
    session = Session("cpx-uart", "stock")
    session.data_to_send()
    for _ in range(2):
        session.request_camera(CameraSettings())
    assert session.data_to_send() == b""
    session.receive(CREDIT, 1)
    first = session.data_to_send()
    assert first[:6] == bytes.fromhex("ff105c054e11")
    assert len(first) == 19
    assert session.data_to_send() == b""
    session.receive(CREDIT, 2)
    assert session.data_to_send() == first


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    crc = 0xFFFF
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def stamp(sequence: int, stm32_us: int, epoch: int) -> bytes:
    inner = struct.pack("<IQB", sequence, stm32_us, epoch)
    return b"\xd5\x2a" + inner + struct.pack("<H", crc16(inner))


def test_stamps_with_noise_between_them_at_every_cut() -> None:
    stream = stamp(1, 10_000, 0) + b"\xd5\x2a\x00" + stamp(2, 20_000, 0) + stamp(3, 1 << 40, 7)[:-1] + stamp(4, 5, 7)
    whole, session = received(stream, framing="stamps")
    got = [(event.sequence, event.stm32_us, event.epoch) for event in whole if isinstance(event, Stamp)]
    assert got == [(1, 10_000, 0), (2, 20_000, 0), (4, 5, 7)]
    assert (session.counters.stamps, session.counters.garbage_bytes) == (3, 3 + 16)
    assert session.counters.bad_check >= 2
    for cut in range(1, len(stream)):
        assert comparable(received(stream, [cut], framing="stamps")[0]) == comparable(whole)


def test_reading_no_more_than_is_wanted_never_waits_for_what_is_not_sent() -> None:
    """A peer that waits for its credit sends nothing more: the next `bytes_wanted` must all be under way."""
    parts = [CREDIT, uart(b"hi\0", GAP8_TO_HOST_CONSOLE), *NATIVE[0], CREDIT]
    session = Session("cpx-uart", "stock")
    got = []
    reads = 0
    for part in parts:
        at = 0
        while at < len(part):
            wanted = session.bytes_wanted
            assert 1 <= wanted <= len(part) - at
            got += session.receive(part[at : at + wanted], 1)
            at += wanted
            reads += 1
    assert bodies(got) == [BODY]
    assert reads <= 2 * len(parts)
