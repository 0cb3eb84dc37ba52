"""Frames and time messages of the dataset paper's firmware: the bytes alone say that they are its."""

import math
import random
import struct

import pytest
from made_streams import (
    GAP8_TO_HOST_CONSOLE,
    POSE,
    bodies,
    causes,
    comparable,
    native,
    packet,
    paper,
    paper_stamp,
    pixels,
    received,
    state_message,
    stock,
    uart_pieces,
)

from host.link.frame import Frame
from host.link.headers import Pose
from host.link.records import Garbage, NanocockpitStamp, PaperStamp, Stamp
from host.link.session import Session
from host.protocol.errors import LocalError
from host.protocol.packets import CameraSettings

A, B, C = (pixels(8, 5, seed) for seed in (1, 2, 3))
HELLO = packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE)


def burst() -> bytes:
    """Three frames one after another, a console packet in the second, then a frame that is cut, then one more."""
    first, second, third = (paper(body, 8, 5, ms, piece=17) for body, ms in ((A, 1000), (B, 1067), (C, 2**32 - 1)))
    cut = paper(B, 8, 5, 77, piece=17)[:-1]
    return b"".join(
        [*first, second[0], HELLO, *second[1:], *third, b"\xaa\xbb\xcc", *cut, *paper(A, 8, 5, 99, piece=17)]
    )


def frames(events: list[object]) -> list[Frame]:
    return [event for event in events if isinstance(event, Frame)]


def test_the_bytes_of_a_header() -> None:
    """As the firmware lays it out: stock's eleven bytes, u32 ms, x y z, qx qy qz qw."""
    wire = bytes.fromhex("2d006305 bc 0800 0500 01 00 28000000 39300000 0000003f 0000a0bf 0000803f")
    wire += bytes.fromhex("00000000 00000000 0000003f 0000403f")
    (frame,) = frames(received(wire + packet(A))[0])
    assert frame.dialect == "paper"
    assert frame.paper is not None
    assert (frame.paper.frame_ms, frame.frame_stm32_us, frame.paper.heard) == (12345, 12_345_000, True)
    assert frame.paper.pose == Pose(*POSE)
    assert (frame.native, frame.nanocockpit, frame.pairs) == (None, None, None)
    assert frame.pixels.tobytes() == A


def test_what_a_burst_gives() -> None:
    events, session = received(burst())
    assert bodies(events) == [A, B, C, A]
    assert [frame.frame_stm32_us for frame in frames(events)] == [1_000_000, 1_067_000, (2**32 - 1) * 1000, 99_000]
    assert causes(events) == ["cut_short"]
    assert [event.size for event in events if isinstance(event, Garbage)] == [3]
    assert session.spoken == "paper"


@pytest.mark.parametrize("dialect", ["auto", "paper", "stock", "native"])
def test_every_cut_gives_the_same(dialect: str) -> None:
    stream = burst()
    whole = comparable(received(stream, dialect=dialect)[0])
    assert whole == comparable(received(stream)[0])
    for cut in range(1, len(stream)):
        assert comparable(received(stream, [cut], dialect=dialect)[0]) == whole, f"cut at {cut}"
    assert comparable(received(stream, range(1, len(stream)), dialect=dialect)[0]) == whole


@pytest.mark.parametrize("dialect", ["auto", "paper", "stock"])
def test_nothing_is_transmitted(dialect: str) -> None:
    _, session = received(burst(), dialect=dialect)
    session.tick(10**10)
    assert session.data_to_send() == b""


def test_dialects_may_follow_each_other() -> None:
    """As after another firmware was started; each frame says what it is."""
    parts = [stock(A, 8, 5), paper(B, 8, 5, 5), native(7, C, 8, 5), paper(A, 8, 5, 6), stock(B, 8, 5)]
    found = frames(received(b"".join(b"".join(part) for part in parts))[0])
    assert [frame.dialect for frame in found] == ["stock", "paper", "native", "paper", "stock"]
    assert [frame.body.tobytes() for frame in found] == [A, B, C, A, B]


def test_a_body_of_43_bytes_that_looks_like_a_header() -> None:
    """Its size says that it is the body."""
    body = paper(A, 8, 5, 1)[0][4:]
    assert bodies(received(b"".join(stock(body, 43, 1)))[0]) == [body]
    assert bodies(received(b"".join(paper(body, 43, 1, 5)))[0]) == [body]


@pytest.mark.parametrize(
    ("pose", "heard", "kept"),
    [
        ((0.0,) * 7, False, False),
        ((1.0, 2.0, 3.0, 0.0, 0.0, 0.0, -0.0), False, False),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), True, True),
        ((math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0), True, False),
        ((0.0, 0.0, 0.0, math.nan, math.nan, math.nan, math.nan), True, False),
        ((0.0, math.inf, 0.0, 0.0, 0.0, 0.0, 1.0), True, False),
    ],
)
def test_a_pose_is_numbers_or_nothing(pose: tuple[float, ...], heard: bool, kept: bool) -> None:
    """Without a quaternion the GAP8 had heard nothing: then its time is its own."""
    (frame,) = frames(received(b"".join(paper(A, 8, 5, 44, pose)))[0])
    assert frame.paper is not None
    assert (frame.paper.heard, frame.paper.pose is not None) == (heard, kept)
    assert frame.frame_stm32_us == (44_000 if heard else None)


def test_a_damaged_header_is_no_header() -> None:
    header = bytearray(paper(A, 8, 5, 1)[0])
    header[4 + 5] = 9  # bytes per pixel
    events, _ = received(bytes(header) + packet(A) + b"".join(paper(B, 8, 5, 2)))
    assert bodies(events) == [B]


def test_on_cpx_over_uart() -> None:
    line = b"".join(b"".join(uart_pieces(each)) for each in paper(A, 8, 5, 31, piece=17))
    for cuts in ([], range(1, len(line))):
        (frame,) = frames(received(line, cuts, "cpx-uart")[0])
        assert (frame.body.tobytes(), frame.frame_stm32_us) == (A, 31_000)


def test_camera_settings_go_in_its_own_message() -> None:
    settings = CameraSettings(False, 8, 1, 2, "jpeg", exposure_lines=50)
    for session in (Session(dialect="paper"), received(b"".join(paper(A, 8, 5, 1)), dialect="auto")[1]):
        session.request_camera(settings)
        assert session.data_to_send().hex() == "0a005c05" + "0000080132000201"
    session = Session(dialect="paper")
    with pytest.raises(LocalError, match=r"exposure_lines is 533: give 2\.\.532"):
        session.request_camera(CameraSettings(exposure_lines=533))
    with pytest.raises(LocalError, match="frame_period_us is 1: give 0: the paper's firmware has no frame rate"):
        session.request_camera(CameraSettings(frame_period_us=1))
    with pytest.raises(LocalError, match="analog_gain is 3"):
        session.request_camera(CameraSettings(analog_gain=3))


# UART1

NATIVE_STAMP = bytes.fromhex("d52a40e2010074f3c8f4e5000000036f5d")


def heard(stream: bytes, cuts: object = ()) -> tuple[list[object], Session]:
    events, session = received(stream, cuts, "stamps")  # type: ignore[arg-type]
    return list(events), session


def test_messages_of_all_firmwares_on_one_wire() -> None:
    noise = b"!RNG" + bytes(4)
    noise += struct.pack("<I", __import__("zlib").crc32(noise))
    stream = NATIVE_STAMP + paper_stamp(123_456_789_012) + noise + state_message() + b"\xbc" + paper_stamp(5)
    events, session = heard(stream)
    assert [type(event) for event in events] == [Stamp, PaperStamp, NanocockpitStamp, Garbage, PaperStamp]
    stamp, paper_one, state, garbage, last = events
    assert isinstance(stamp, Stamp)
    assert isinstance(paper_one, PaperStamp)
    assert isinstance(state, NanocockpitStamp)
    assert isinstance(last, PaperStamp)
    assert (stamp.stm32_us, paper_one.stm32_us, last.stm32_us) == (987654321012, 123_456_789_012, 5)
    assert paper_one.pose == Pose(*POSE)
    assert (state.state.stm32_time, state.state.x_mm, state.state.yaw_mrad_s) == (7000, 500, 9)
    assert state.state.quaternion == (0, 0, 0, 1)
    assert isinstance(garbage, Garbage)
    assert (garbage.offset, garbage.size) == (17 + 40 + 12 + 40, 1)
    assert session.counters.stamps == 5
    whole = comparable(events)  # type: ignore[arg-type]
    for cut in range(1, len(stream)):
        assert comparable(heard(stream, [cut])[0]) == whole  # type: ignore[arg-type]
    assert comparable(heard(stream, range(1, len(stream)))[0]) == whole  # type: ignore[arg-type]


@pytest.mark.parametrize("start", [b"!", b"!STA", b"!TOF", b"!RNG12345", b"\xbc\x25\x01", b"\xbc\x25", b"\xd5\x2a"])
def test_a_false_start_costs_nothing(start: bytes) -> None:
    """The longest swallows 76 bytes at first: all messages in them are found."""
    sent = [paper_stamp(n) for n in range(3)]
    events, session = heard(start + b"".join(sent) + NATIVE_STAMP * 2 + state_message())
    times = [event.stm32_us for event in events if isinstance(event, PaperStamp)]
    assert times == [0, 1, 2]
    assert sum(isinstance(event, Stamp) for event in events) == 2
    assert sum(isinstance(event, NanocockpitStamp) for event in events) == 1
    assert session.counters.garbage_bytes == len(start)


@pytest.mark.parametrize("seed", range(10))
def test_noise_costs_only_what_it_hits(seed: int) -> None:
    rng = random.Random(seed)
    stream, sent = b"", 0
    for number in range(100):
        stream += rng.choice([b"", b"", rng.randbytes(rng.randrange(6))])
        stream += rng.choice([paper_stamp(number), state_message(), NATIVE_STAMP])
        sent += 1
    events, session = heard(stream)
    found = [event for event in events if not isinstance(event, Garbage)]
    assert len(found) == sent, f"seed {seed}"
    assert session.counters.garbage_bytes == sum(event.size for event in events if isinstance(event, Garbage))
