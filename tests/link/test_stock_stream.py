"""Stock frames, and everything that can stand between, inside and instead of them, at every cut of the stream."""

import struct

import numpy as np
import pytest
from made_streams import (
    ANNOUNCING,
    GAP8_TO_HOST_CONSOLE,
    bodies,
    causes,
    comparable,
    native,
    packet,
    pixels,
    received,
    reply,
    stock,
)

from host.link.frame import Frame, LostFrame, decode_jpeg
from host.link.records import Announced, Console, Garbage, Packet, Reply
from host.link.session import Session
from host.protocol.errors import LocalError, PeerError

A, B, C = (pixels(8, 5, seed) for seed in (1, 2, 3))
FRAME_A, FRAME_B, FRAME_C = (b"".join(stock(body, 8, 5, piece=17)) for body in (A, B, C))
HELLO = packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE)


def mixed() -> bytes:
    """A console packet inside a frame, an unknown function, a wrong version, garbage, a frame cut short."""
    first = stock(A, 8, 5, piece=17)
    unknown = packet(b"?" * 30, bytes([0x63, 0x09]))
    version_1 = packet(b"!" * 30, bytes([0x63, 0x45]))
    cut = b"".join(stock(B, 8, 5, piece=17)[:-1])
    return b"".join(
        [*first[:2], HELLO, *first[2:], unknown, FRAME_B, version_1, FRAME_C, b"\xaa\xbb\xcc", cut, HELLO, FRAME_A]
    )


def test_official_bytes_of_a_qvga_header() -> None:
    header = bytes.fromhex("0d006305bc4401f4000100d0340100")
    body = pixels(324, 244, 4)
    events, _ = received(header + b"".join(stock(body, 324, 244)[1:]))
    (frame,) = events
    assert isinstance(frame, Frame)
    assert (frame.width, frame.height, frame.depth, frame.encoding) == (324, 244, 1, "raw")
    assert frame.pixels.shape == (244, 324)
    assert frame.pixels.tobytes() == body
    assert frame.native is None
    assert frame.frame_stm32_us is None
    assert frame.pairs is None


def test_what_a_mixed_stream_gives() -> None:
    events, session = received(mixed())
    assert bodies(events) == [A, B, C, A]
    assert causes(events) == ["cut_short"]
    assert [event.text for event in events if isinstance(event, Console)] == ["hello\n", "hello\n"]
    garbage = [event for event in events if isinstance(event, Garbage)]
    assert [(event.offset, event.size) for event in garbage] == [(mixed().index(b"\xaa\xbb\xcc"), 3)]
    counters = session.counters
    assert counters.bytes == len(mixed())
    assert (counters.unknown_function, counters.bad_version, counters.garbage_bytes) == (1, 1, 3)
    assert (counters.frames, counters.frames_lost["cut_short"]) == (4, 1)
    assert counters.packets["console"] == 2
    assert [event.index for event in events if isinstance(event, Frame)] == [0, 1, 2, 3]


def test_every_cut_gives_the_same() -> None:
    whole = comparable(received(mixed())[0])
    for cut in range(1, len(mixed())):
        assert comparable(received(mixed(), [cut])[0]) == whole, f"cut at {cut}"


def test_byte_by_byte_gives_the_same() -> None:
    events, session = received(mixed(), range(1, len(mixed())))
    assert comparable(events) == comparable(received(mixed())[0])
    assert session.counters == received(mixed())[1].counters


def test_every_truncation_keeps_what_was_whole() -> None:
    stream = FRAME_A + FRAME_B
    for size in range(len(stream)):
        events, session = received(stream[:size])
        whole = [A, B][: size // len(FRAME_A)]
        assert bodies(events) == whole
        inside = size % len(FRAME_A)
        assert causes(events) == (["disconnected"] if inside >= 15 else [])
        packets_end = {0, 15, 36, 57}  # a packet that is not whole is left over
        left = min(inside - end for end in packets_end if end <= inside)
        assert session.counters.garbage_bytes == left


def test_a_lost_frame_keeps_what_came_and_zeros() -> None:
    events, _ = received(b"".join(stock(A, 8, 5, piece=17)[:2]))
    (lost,) = events
    assert isinstance(lost, LostFrame)
    assert (lost.received_bytes, lost.expected_bytes, lost.frame) == (17, 40, None)
    assert lost.body.tobytes() == A[:17] + bytes(23)


@pytest.mark.parametrize("size", [0, 1, 1023, 65535])
def test_impossible_lengths_are_garbage(size: int) -> None:
    damaged = struct.pack("<H", size) + bytes([0x63, 0x05]) + b"\x00" * 20
    events, session = received(FRAME_A + damaged + FRAME_B)
    assert bodies(events) == [A, B]
    assert session.counters.garbage_bytes == len(damaged)


@pytest.mark.parametrize("route", [0x03, 0x60, 0x6B + 0x05, 0x7B])
def test_impossible_addresses_are_garbage(route: int) -> None:
    source, destination = route >> 3 & 7, route & 7
    assert not (1 <= source <= 4 and 1 <= destination <= 4)
    damaged = packet(b"\x00" * 20, bytes([route, 0x05]))
    events, session = received(FRAME_A + damaged + FRAME_B)
    assert bodies(events) == [A, B]
    assert session.counters.garbage_bytes == len(damaged)


def test_longer_body_than_announced_is_an_overrun() -> None:
    packets = stock(A, 8, 5, piece=17)
    events, session = received(b"".join(packets[:-1]) + packet(A[34:] + b"more") + FRAME_B)
    assert causes(events) == ["overrun"]
    assert bodies(events) == [B]
    assert session.counters.garbage_bytes == 0


def test_the_rest_of_a_lost_frame_is_not_handed_out() -> None:
    packets = stock(A, 8, 5, piece=4)
    events, session = received(b"".join(packets[:3]) + b"\xaa\xbb\xcc" + b"".join(packets[3:]) + FRAME_B)
    assert causes(events) == ["garbage"]
    assert bodies(events) == [B]
    assert not [event for event in events if isinstance(event, Packet)]
    assert session.counters.stray_packets == len(packets) - 3


def test_an_app_packet_between_frames_is_handed_out() -> None:
    events, _ = received(FRAME_A + packet(b"\x07") + FRAME_B)
    (between,) = [event for event in events if isinstance(event, Packet)]
    assert (between.source, between.destination, between.function, between.data) == (4, 3, 5, b"\x07")


def test_empty_packets_are_nothing() -> None:
    events, _ = received(FRAME_A + packet(b"") + FRAME_B)
    assert bodies(events) == [A, B]
    assert len(events) == 2


def test_a_reply_inside_a_stock_body_is_not_a_pixel() -> None:
    packets = stock(A, 8, 5, piece=17)
    events, _ = received(b"".join([*packets[:2], reply(16, 0), *packets[2:]]))
    assert bodies(events) == [A]
    assert [(event.request, event.status) for event in events if isinstance(event, Reply)] == [(16, 0)]


def test_last_piece_that_looks_like_a_header_is_the_last_piece() -> None:
    inner = struct.pack("<BHHBBI", 0xBC, 8, 5, 1, 0, 40)
    body = A[:29] + inner
    packets = stock(body, 8, 5, piece=29)
    assert len(packets[-1]) == 15
    events, _ = received(b"".join(packets) + FRAME_B)
    assert bodies(events) == [body, B]


def test_native_frame_in_the_middle_of_a_stock_frame() -> None:
    body = pixels(40, 30, 5)
    cut = b"".join(stock(body, 40, 30)[:-1])
    events, _ = received(cut + b"".join(native(1, A, 8, 5)))
    assert causes(events) == ["cut_short"]
    assert bodies(events) == [A]


def test_announcement_is_reported_once() -> None:
    announcing = b"".join(stock(A, 8, 5, route=ANNOUNCING))
    events, _ = received(announcing * 3)
    assert bodies(events) == [A] * 3
    assert len([event for event in events if isinstance(event, Announced)]) == 1


MARKERS_ONLY = b"\xff\xd8" + bytes(36) + b"\xff\xd9"


@pytest.mark.parametrize("body", [MARKERS_ONLY[:-1] + b"\x00", b"\x00" + MARKERS_ONLY[1:], b"\xff\xd8\xd9"])
def test_a_broken_jpeg_is_kept_aside(body: bytes) -> None:
    events, session = received(b"".join(stock(body, 8, 5, kind=1)) + FRAME_A)
    assert causes(events) == ["bad_jpeg"]
    assert bodies(events) == [A]
    assert session.counters.frames_lost["bad_jpeg"] == 1
    (lost,) = [event for event in events if isinstance(event, LostFrame)]
    assert lost.body.tobytes() == body


def test_a_jpeg_in_parts() -> None:
    import io

    from PIL import Image

    out = io.BytesIO()
    picture = np.tile(np.arange(64, dtype=np.uint8) * 4, (48, 1))
    Image.fromarray(picture).save(out, "JPEG", quality=90)
    body = out.getvalue()
    header = packet(struct.pack("<BHHBBI", 0xBC, 64, 48, 1, 1, len(body)))
    parts = [body[:300], body[300:-2], body[-2:]]
    (frame,) = received(header + b"".join(packet(part) for part in parts))[0]
    assert isinstance(frame, Frame)
    assert frame.encoding == "jpeg"
    assert np.abs(frame.pixels.astype(int) - picture).mean() < 4


# A JPEG of 65500 x 65500 pixels, if one believes it: Pillow refuses it in its own way.
HUGE_JPEG = bytes.fromhex("ffd8 ffc0000b08ffdcffdc01011100") + MARKERS_ONLY[2:]


@pytest.mark.parametrize("body", [MARKERS_ONLY, HUGE_JPEG])
def test_a_jpeg_that_only_looks_whole_is_never_shown_as_good(body: bytes) -> None:
    (lost,), _ = received(b"".join(stock(body, 8, 5, kind=1)))
    assert isinstance(lost, LostFrame)
    assert lost.cause == "bad_jpeg"
    assert lost.body.tobytes() == body
    with pytest.raises(PeerError, match="JPEG"):
        decode_jpeg(lost.body, 8, 5)


def test_a_body_belongs_to_the_caller() -> None:
    events, _ = received(FRAME_A + FRAME_B)
    first, second = events
    assert isinstance(first, Frame)
    assert isinstance(second, Frame)
    first.body[:] = 0
    assert second.body.tobytes() == B


def test_a_session_that_has_ended_takes_nothing_more() -> None:
    session = Session()
    session.receive(FRAME_A, 1)
    session.finish()
    bytes_before = session.bytes_received
    with pytest.raises(LocalError, match="make a new one"):
        session.receive(FRAME_B, 2)
    with pytest.raises(LocalError, match="make a new one"):
        session.finish()
    assert session.bytes_received == bytes_before
