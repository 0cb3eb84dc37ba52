"""Damage of a stream costs the frames that it hits and no others, wherever it is and however reads cut the stream.

Stock frames carry no check: a frame that damage hits may be lost, or come with wrong pixels if only its last packet
was hit; then a Garbage event follows it. What is claimed here is about the frames that were not hit. One kind of
damage cannot be seen: a length that is wrong and yet ends where another packet starts.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from made_streams import (
    GAP8_TO_HOST_CONSOLE,
    bodies,
    causes,
    comparable,
    native,
    packet,
    pixels,
    received,
    stock,
)

FRAMES = 5


@dataclass(frozen=True)
class Sent:
    """A stream of frames, and where each of them lies in it."""

    stream: bytes
    bodies: list[bytes]
    spans: list[tuple[int, int]]
    starts: dict[int, int]
    """Of packets: place and length field; and the end of the stream."""


def sent(kind: str, width: int, height: int, piece: int) -> Sent:
    stream, all_bodies, spans = b"", [], []
    for number in range(FRAMES):
        body = pixels(width, height, 100 + number)
        packets = (
            stock(body, width, height, piece=piece) if kind == "stock" else native(number, body, width, height, piece)
        )
        stream += packet(b"tick\0", GAP8_TO_HOST_CONSOLE)
        spans.append((len(stream), len(stream) + sum(map(len, packets))))
        stream += b"".join(packets)
        all_bodies.append(body)
    starts, at = {len(stream): 0}, 0
    while at < len(stream):
        starts[at] = struct.unpack_from("<H", stream, at)[0]
        at += 2 + starts[at]
    return Sent(stream, all_bodies, spans, starts)


SENT = {
    (kind, size): sent(kind, *shape)
    for kind in ("stock", "native")
    for size, shape in {"small": (8, 5, 17), "large": (60, 50, 1000)}.items()
}


def insert(stream: bytes, place: int, garbage: bytes) -> tuple[bytes, int]:
    """The damaged stream, and how many of the bytes that were sent it touches."""
    return stream[:place] + garbage + stream[place:], 0


def overwrite(stream: bytes, place: int, garbage: bytes) -> tuple[bytes, int]:
    return stream[:place] + garbage + stream[place + len(garbage) :], len(garbage)


def delete(stream: bytes, place: int, garbage: bytes) -> tuple[bytes, int]:
    return stream[:place] + stream[place + len(garbage) :], len(garbage)


def not_hit(of: Sent, place: int, touched: int) -> list[bytes]:
    return [
        body
        for body, (start, end) in zip(of.bodies, of.spans, strict=True)
        if not (place < end and place + max(touched, 1) > start and (touched > 0 or place > start))
    ]


def lands_on_a_packet(of: Sent, stream: bytes, place: int, size: int) -> bool:
    """Does a header that damage has made end where another packet starts, so that nothing looks wrong?"""
    shift = len(stream) - len(of.stream)
    starts = {start + (shift if start >= place + (size if shift <= 0 else 0) else 0): length
              for start, length in of.starts.items()}  # fmt: skip
    for at in range(max(0, place - 3), min(place + size, len(stream) - 3)):
        length, route = struct.unpack_from("<HB", stream, at)
        believed = 2 <= length <= 1022 and 1 <= route & 7 <= 4 and 1 <= route >> 3 & 7 <= 4
        if believed and starts.get(at) != length and at + 2 + length in starts:
            return True
    return False


def is_subsequence(wanted: list[bytes], got: list[bytes]) -> bool:
    rest = iter(got)
    return all(any(each == other for other in rest) for each in wanted)


@pytest.mark.parametrize("damage", [insert, overwrite, delete])
@pytest.mark.parametrize("kind", ["stock", "native"])
@pytest.mark.parametrize("garbage", [b"\xaa\xbb\xcc", b"\x00\x00\x00", b"\xff\xff\xff", b"\x0d\x00\x63"])
def test_three_bytes_at_every_place(damage, kind, garbage) -> None:  # type: ignore[no-untyped-def]
    of = SENT[kind, "small"]
    for place in range(len(of.stream) - 2):
        stream, touched = damage(of.stream, place, garbage)
        got = bodies(received(stream)[0])
        assert is_subsequence(not_hit(of, place, touched), got), f"at {place}"
        assert len(got) >= FRAMES - 1, f"at {place}"
        if kind == "native":
            assert set(got) <= set(of.bodies), f"at {place}: a wrong frame was shown as good"


@settings(max_examples=300, deadline=None, print_blob=True)
@given(
    st.sampled_from(sorted(SENT)),
    st.sampled_from([insert, overwrite, delete]),
    st.floats(0, 1),
    st.binary(min_size=1, max_size=3),
)
def test_up_to_three_bytes_anywhere(which, damage, where, garbage) -> None:  # type: ignore[no-untyped-def]
    of = SENT[which]
    place = int(where * (len(of.stream) - len(garbage)))
    stream, touched = damage(of.stream, place, garbage)
    assume(not lands_on_a_packet(of, stream, place, len(garbage)))
    events, session = received(stream)
    assert is_subsequence(not_hit(of, place, touched), bodies(events))
    assert sum(session.counters.frames_lost.values()) <= 2
    assert len(bodies(events)) + len(causes(events)) <= FRAMES + 1


@settings(max_examples=150, deadline=None, print_blob=True)
@given(
    st.sampled_from([("stock", "small"), ("native", "small")]),
    st.lists(st.tuples(st.floats(0, 1), st.binary(min_size=1, max_size=40)), max_size=4),
    st.lists(st.floats(0, 1), max_size=30),
)
def test_cuts_never_matter(which, damages, cuts) -> None:  # type: ignore[no-untyped-def]
    stream = SENT[which].stream
    for where, garbage in damages:
        place = int(where * len(stream))
        stream = stream[:place] + garbage + stream[place:]
    places = sorted(int(cut * len(stream)) for cut in cuts)
    whole, whole_session = received(stream)
    cut, cut_session = received(stream, places)
    assert comparable(cut) == comparable(whole)
    assert cut_session.counters == whole_session.counters


@settings(max_examples=300, deadline=None, print_blob=True)
@given(st.binary(max_size=4000), st.sampled_from(["tcp", "cpx-uart", "stamps"]))
def test_any_bytes_are_counted_and_never_crash(stream, framing) -> None:  # type: ignore[no-untyped-def]
    _, session = received(stream, framing=framing)
    counters = session.counters
    assert counters.bytes == len(stream)
    assert counters.garbage_bytes <= len(stream)


@pytest.mark.parametrize("seed", range(100))
def test_frames_behind_noise_come(seed: int) -> None:
    random = np.random.default_rng(seed)
    noise = random.bytes(int(random.integers(1, 100_000)))
    of = SENT["stock", "small"]
    events, session = received(noise + of.stream)
    assert bodies(events) == of.bodies
    assert len(noise) - 2 * 1024 < session.counters.garbage_bytes <= len(noise) + 9  # and maybe the console packet


def test_wrong_header_that_swallows_the_next_frames_header() -> None:
    of = SENT["stock", "small"]
    start = of.spans[2][0]
    swallowing = struct.pack("<H", 400) + bytes([0x63, 0x02])
    events, session = received(of.stream[:start] + swallowing + of.stream[start:])
    assert bodies(events) == of.bodies
    assert session.counters.garbage_bytes == len(swallowing)


def test_nothing_is_released_while_it_is_not_known_where_packets_start() -> None:
    console = packet(b"x", GAP8_TO_HOST_CONSOLE)
    noise = b"\xff" * 10
    assert [type(event).__name__ for event in received(noise + console * 2)[0]] == ["Garbage"]
    names = [type(event).__name__ for event in received(noise + console * 3)[0]]
    assert names == ["Garbage", "Console", "Console", "Console"]


def test_memory_is_bounded_by_the_struct() -> None:
    from host.native import ffi, lib

    assert ffi.sizeof("stream_t") < 40_000
    stream = ffi.new("stream_t *")
    lib.stream_init(stream, lib.STREAM_TCP)
    waiting = packet(bytes(1020), GAP8_TO_HOST_CONSOLE)[:-1]
    for size in (1, 7, 500, 4096):
        noise = (b"\xff" * 5 + waiting + packet(bytes(1000), bytes([0x63, 0x09]))) * 50
        for at in range(0, len(noise), size):
            part = noise[at : at + size]
            while lib.stream_push(stream, part, len(part), 0):
                pass
            assert stream.window_fill < lib.STREAM_LOOKAHEAD
