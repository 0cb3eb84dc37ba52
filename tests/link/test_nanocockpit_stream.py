"""NanoCockpit's stream: recognised by its first image, split by its own length rule, whatever stands around it."""

import struct
import zlib

import pytest
from made_streams import (
    GAP8_TO_HOST_CONSOLE,
    STATE,
    bodies,
    causes,
    comparable,
    nanocockpit,
    nanocockpit_packet,
    packet,
    paper,
    pixels,
    received,
    stock,
)

from host.link.frame import Frame, LostFrame
from host.link.records import Console, Event, Garbage, Packet
from host.link.session import Session
from host.protocol.errors import LocalError
from host.protocol.packets import CameraSettings

A, B, C = (pixels(12, 7, seed) for seed in (1, 2, 3))
LARGE = pixels(160, 160, 4)
PIECE = 180
"""Small packets: the metadata has to be in the first."""


def small(body: bytes, frame_id: int, **more: object) -> list[bytes]:
    return nanocockpit(body, 12, 7, frame_id, piece=PIECE, **more)  # type: ignore[arg-type]


def mixed() -> bytes:
    """The tail of an image, an image, a console packet in another, garbage, an image cut short, one more."""
    tail = small(C, 1)[1:]
    second = small(B, 3)
    hello = nanocockpit_packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE)
    cut = small(C, 4)[:-1]
    return b"".join([*tail, *small(A, 2), second[0], hello, *second[1:], b"\xaa\xbb\xcc", *cut, *small(A, 5)])


def frames(events: list[Event]) -> list[Frame]:
    return [event for event in events if isinstance(event, Frame)]


def test_the_bytes_of_a_packet() -> None:
    """As the firmware lays it out: length without the route, 63 06, BEGIN, metadata version 10."""
    first = nanocockpit(LARGE, 160, 160, 9)[0]
    assert first[:8].hex() == "f80f6306" + "10019464"
    assert first[16:24].hex() == "0aa000a000010009"
    assert len(first) == 4092


def test_a_frame() -> None:
    stream = b"".join(nanocockpit(LARGE, 160, 160, 9, gap8_us=2**32 - 5, reply=(2**32 - 10, 30)))
    for dialect in ("auto", "nanocockpit"):
        (frame,) = frames(received(stream, dialect=dialect)[0])
        header = frame.nanocockpit
        assert header is not None
        assert frame.dialect == "nanocockpit"
        assert (frame.width, frame.height, frame.depth, frame.encoding) == (160, 160, 1, "raw")
        assert frame.pixels.tobytes() == LARGE
        assert frame.frame_stm32_us is None
        assert (header.frame_id, header.checked, header.frame_gap8_us) == (9, True, 2**32 - 5)
        assert (header.state_gap8_us, header.state.stm32_time) == (4000, 7000)
        assert (header.state.x_mm, header.state.y_mm, header.state.z_mm) == (500, -1250, 1000)
        assert header.round_trip_us == 40
        assert (header.ranges, header.inference) == ((), (0, 0, 0, 0))


def test_what_a_mixed_stream_gives() -> None:
    events, session = received(mixed(), dialect="auto")
    assert bodies(events) == [A, B, A]
    assert causes(events) == ["cut_short"]
    assert [event.text for event in events if isinstance(event, Console)] == ["hello\n"]
    assert sum(event.size for event in events if isinstance(event, Garbage)) == len(small(C, 1)[1]) + 3
    assert session.spoken == "nanocockpit"
    counters = session.counters
    assert counters.frames_lost["cut_short"] == 1
    assert counters.frames_lost["unexplained"] == 0  # the one that was cut explains the gap
    assert counters.packets["streamer"] == 2 + 2 + 1 + 2
    assert session.data_to_send() == b""


def test_with_its_rule_set_the_tail_is_no_garbage() -> None:
    events, session = received(mixed(), dialect="nanocockpit")
    assert bodies(events) == [A, B, A]
    assert session.counters.garbage_bytes == 3
    assert session.counters.stray_packets == 1


@pytest.mark.parametrize("dialect", ["auto", "nanocockpit"])
def test_every_cut_gives_the_same(dialect: str) -> None:
    stream = mixed()
    whole = comparable(received(stream, dialect=dialect)[0])
    for cut in range(1, len(stream)):
        assert comparable(received(stream, [cut], dialect=dialect)[0]) == whole, f"cut at {cut}"
    events, session = received(stream, range(1, len(stream)), dialect=dialect)
    assert comparable(events) == whole
    assert session.counters == received(stream, dialect=dialect)[1].counters


def test_large_packets_at_many_cuts() -> None:
    stream = b"".join(nanocockpit(LARGE, 160, 160, 1) + nanocockpit(LARGE, 160, 160, 2))
    for size in (1, 7, 1000, 4091, 4092, 4093, 9000):
        events, _ = received(stream, range(size, len(stream), size), dialect="auto")
        assert bodies(events) == [LARGE, LARGE], size


@pytest.mark.parametrize("dialect", ["auto", "nanocockpit"])
def test_every_truncation_keeps_what_was_whole(dialect: str) -> None:
    one = b"".join(small(A, 1))
    stream = one + b"".join(small(B, 2))
    for size in range(0, len(stream), 3):
        events, _ = received(stream[:size], dialect=dialect)
        assert bodies(events) == [A, B][: size // len(one)], size
        # It has begun once its first packet is there.
        assert causes(events) == (["disconnected"] if size % len(one) >= 4 + PIECE else []), size


@pytest.mark.parametrize("place", range(0, 500, 7))
def test_garbage_costs_the_frame_that_it_hits(place: int) -> None:
    packets = [small(body, number) for number, body in enumerate((A, B, C, A))]
    stream = b"".join(b"".join(each) for each in packets)
    damaged = stream[:place] + b"\x00\xff\x63" + stream[place:]
    events, _ = received(damaged, dialect="auto")
    hit = place // len(b"".join(packets[0])) if place % len(b"".join(packets[0])) else None
    left = [body for number, body in enumerate((A, B, C, A)) if number != hit]
    found = bodies(events)
    assert found == left, place


def test_other_robots_are_not_mistaken_for_it() -> None:
    """With the rule still open, the streams of the other dialects give what they give without."""
    for packets in (stock(A, 12, 7, piece=17), paper(A, 12, 7, 5)):
        stream = packet(b"boot\0", GAP8_TO_HOST_CONSOLE) + b"".join(packets) * 2 + b"\xaa\xbb" + b"".join(packets)
        assert comparable(received(stream, dialect="auto")[0]) == comparable(received(stream)[0])


def test_an_image_that_holds_an_image_of_it() -> None:
    """Where packets follow each other nobody looks inside them."""
    inside = b"".join(small(A, 1))
    body = inside + bytes(1000 - len(inside))
    stream = b"".join(stock(body, 100, 10, piece=300)) * 2
    events, session = received(stream, dialect="auto")
    assert bodies(events) == [body, body]
    assert session.spoken == "stock"


def test_a_rule_that_was_set_stays() -> None:
    stream = b"".join(small(A, 1) + small(B, 2))
    assert bodies(received(stream, dialect="paper")[0]) == []
    assert bodies(received(stream, dialect="stock")[0]) == [A, B]
    other = b"".join(stock(A, 12, 7) + stock(B, 12, 7))
    assert bodies(received(other, dialect="nanocockpit")[0]) == []


def test_small_images_whose_packets_cpx_could_read_too() -> None:
    """Both length rules allow the length of such a packet; what it begins decides."""
    for side in range(1, 25):
        body = pixels(side, side, side)
        stream = b"".join(nanocockpit(body, side, side, 3) + nanocockpit(body, side, side, 4))
        assert bodies(received(stream, dialect="auto")[0]) == [body, body], side


@pytest.mark.parametrize("size", range(1, 9))
def test_padding_of_the_last_packet(size: int) -> None:
    body = pixels(size, 1, 5)
    stream = b"".join(nanocockpit(body, size, 1, 1))
    assert len(stream) % 4 == 0
    assert bodies(received(stream, dialect="auto")[0]) == [body]


def test_more_than_padding_is_too_much() -> None:
    packets = small(A, 1)
    packets[-1] = nanocockpit_packet(packets[-1][4:] + bytes(4))
    events, session = received(b"".join(packets) + b"".join(small(B, 2)), dialect="auto")
    assert bodies(events) == [B]
    assert causes(events) == ["overrun"]
    assert session.counters.frames_lost["unexplained"] == 0


# Checks


def test_a_check_that_does_not_match() -> None:
    events, session = received(b"".join(small(A, 1, check=1) + small(B, 2)), dialect="auto")
    assert bodies(events) == [B]
    assert causes(events) == ["bad_crc"]
    assert session.counters.frames_lost["bad_crc"] == 1


@pytest.mark.parametrize("place", [16 + 9, 16 + 60, 16 + 150])
def test_the_check_covers_metadata_and_pixels(place: int) -> None:
    stream = bytearray(b"".join(small(A, 1)))
    stream[place] ^= 1
    assert causes(received(bytes(stream), dialect="auto")[0]) == ["bad_crc"]


def test_without_a_check_all_is_good() -> None:
    stream = bytearray(b"".join(small(A, 1, check=0)))
    stream[16 + 150] ^= 1
    (frame,) = frames(received(bytes(stream), dialect="auto")[0])
    assert frame.nanocockpit is not None
    assert not frame.nanocockpit.checked


def test_a_computed_nought_comes_as_all_ones() -> None:
    """A state's time chosen so that the CRC-32 of the buffer is 0."""
    for_zero = buffer_with_crc_zero()
    metadata, body = for_zero[:148], for_zero[148:]
    begin = struct.pack("<BBII2x", 0x10, 1, len(for_zero), 0xFFFFFFFF)
    assert zlib.crc32(for_zero) == 0
    (frame,) = frames(received(nanocockpit_packet(begin + metadata + body), dialect="auto")[0])
    assert frame.nanocockpit is not None
    assert frame.nanocockpit.checked
    assert frame.body.tobytes() == body


def buffer_with_crc_zero() -> bytes:
    """The last four pixels make up for the rest: a CRC is linear in them."""
    head = nanocockpit(bytes(8), 8, 1, 1)[0][16:]
    base = zlib.crc32(head[:-4] + bytes(4))
    rows = [(zlib.crc32(head[:-4] + (1 << bit).to_bytes(4, "little")) ^ base, 1 << bit) for bit in range(32)]
    value, target = 0, base
    for bit in range(32):
        pivot = next(row for row in rows if row[0] >> bit & 1)
        rows = [
            (row[0] ^ pivot[0], row[1] ^ pivot[1]) if row is not pivot and row[0] >> bit & 1 else row
            for row in rows
            if row is not pivot
        ]
        if target >> bit & 1:
            target ^= pivot[0]
            value ^= pivot[1]
    return head[:-4] + value.to_bytes(4, "little")


# Numbers


def test_gaps_of_its_counter() -> None:
    ids = [250, 251, 255, 0, 4, 4 + 255 - 256]
    stream = b"".join(b"".join(small(A, number)) for number in ids)
    _, session = received(stream, dialect="auto")
    assert session.counters.frames == 6
    assert session.counters.frames_lost["unexplained"] == 3 + 3 + 254


def test_a_lost_frame_explains_its_gap() -> None:
    stream = b"".join(small(A, 7) + small(B, 8, check=1) + small(C, 10))
    _, session = received(stream, dialect="auto")
    lost = session.counters.frames_lost
    assert (lost["bad_crc"], lost["unexplained"]) == (1, 1)


# What is sent


def test_each_frame_is_answered_when_asked_for() -> None:
    stream = b"".join(small(A, 7, gap8_us=0x01020304))
    _, session = received(stream, dialect="nanocockpit", finish=False)
    buffer = bytes.fromhex("04030201 07") + bytes(20)
    begin = struct.pack("<BBII2x", 0x10, 0xF0, 25, zlib.crc32(buffer))
    assert session.data_to_send() == bytes.fromhex("2500 5c06") + begin + buffer
    assert session.data_to_send() == b""


def test_answers_that_nobody_fetches_do_not_pile_up() -> None:
    stream = b"".join(b"".join(small(A, number % 256)) for number in range(100))
    _, session = received(stream, dialect="nanocockpit")
    assert len(session.data_to_send()) == 16 * (4 + 37)


def test_what_it_cannot_do_is_said() -> None:
    with pytest.raises(LocalError, match="no CPX over UART"):
        Session("cpx-uart", "nanocockpit")
    with pytest.raises(LocalError, match="compiled into it"):
        Session(dialect="nanocockpit").request_camera(CameraSettings())


@pytest.mark.parametrize(
    "damage",
    [
        (16, 11),  # another version of the metadata
        (21, 0),  # no bytes per pixel
        (6, 99),  # the size is not that of the picture
    ],
)
def test_a_beginning_that_is_none(damage: tuple[int, int]) -> None:
    """It is reported as a packet, or searched over; the next image is whole."""
    place, value = damage
    bad = bytearray(b"".join(small(A, 1)))
    bad[place] = value
    for dialect in ("auto", "nanocockpit"):
        events, session = received(bytes(bad) + b"".join(small(B, 2)), dialect=dialect)
        assert bodies(events) == [B]
        assert [event for event in events if isinstance(event, LostFrame)] == []
        if dialect == "nanocockpit":
            assert session.counters.bad_messages == 1
            assert [event.function for event in events if isinstance(event, Packet)] == [6]


def test_a_state_unpacks() -> None:
    """z and w equal: what the last bits lose."""
    quat = 2 << 30 | 0 << 20 | 0 << 10 | 511
    state = STATE[:22] + struct.pack("<I", quat) + STATE[26:]
    (frame,) = frames(received(b"".join(small(A, 1, state=state)), dialect="auto")[0])
    assert frame.nanocockpit is not None
    assert frame.nanocockpit.state.quaternion == pytest.approx((0, 0, 0.7071068, 0.7071068))
