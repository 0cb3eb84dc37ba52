"""The apps as the paper's firmware: its messages to the byte, its rule for times, and each part of it set right."""

import functools
import operator
import struct

import pytest
from board import APP, GAP8, HOST, STM32, App, cpx, link
from c_memory import POISONS
from esp32_rig import esp32, from_tcp, give, give_all
from gap8_rig import CONNECTED, GAP8_PAPER, RAW, capture, gap8, picture, sent

from host.native import lib

POSE = (0.5, -1.25, 1.0, 0.0, 0.0, 0.5, 0.75)
NOTHING = (0.0,) * 7
POSE_FIELDS = dict(zip(("x_m", "y_m", "z_m", "qx", "qy", "qz", "qw"), POSE, strict=True))
UNFLOORED, FIRST_BYTE, MIDDLE, OVERLAP = 1, 2, 4, 8


def message(stm32_us: int, pose: tuple[float, ...] = POSE) -> bytes:
    payload = struct.pack("<BQ7f", 1, stm32_us, *pose)
    return b"\xbc\x25" + payload + bytes([functools.reduce(operator.xor, payload)])


def header(body: bytes, ms: int, pose: tuple[float, ...] = POSE, width: int = 60, height: int = 40) -> bytes:
    return cpx(GAP8, HOST, APP, struct.pack("<BHHBBII7f", 0xBC, width, height, 1, RAW, len(body), ms, *pose))


def paper(**config: int) -> App:
    return gap8(firmware=GAP8_PAPER, **config)


# STM32


@pytest.mark.parametrize("poison", POISONS)
def test_time_messages_to_the_byte(poison: int) -> None:
    app = App("stm32", poison, stamp_format=lib.STM32_PAPER, pose=POSE_FIELDS)
    wire = app.uart_bytes("UART1", 0, most=40)
    assert wire == message(0)
    assert app.transmit("UART1", 9_999) == b""
    first = app.transmit("UART1", 10_000, 123_456_789_012)
    assert first + app.uart_bytes("UART1", 11_000, most=39) == message(123_456_789_012)
    assert app.stamps_sent == 2


def test_the_robot_sways() -> None:
    """Half a metre to and fro in four seconds, on both sides of where it hovers."""
    app = App("stm32", stamp_format=lib.STM32_PAPER, pose=POSE_FIELDS, sway_m=0.5)
    places = []
    for up_us in range(0, 5_000_000, 500_000):
        wire = app.uart_bytes("UART1", up_us, most=40)
        places.append(struct.unpack_from("<f", wire, 11)[0])
    assert places == [0.25, 0.375, 0.5, 0.625, 0.75, 0.625, 0.5, 0.375, 0.25, 0.375]


def test_a_quaternion_of_zeros_is_no_rotation() -> None:
    app = App("stm32", stamp_format=lib.STM32_PAPER)
    assert app.uart_bytes("UART1", 0, most=40) == message(0, (0.0,) * 6 + (1.0,))


def test_no_such_format() -> None:
    with pytest.raises(ValueError, match=str(lib.ERR_VALUE)):
        App("stm32", stamp_format=lib.STM32_NANOCOCKPIT_US + 1)


# GAP8


def test_a_frame_to_the_byte() -> None:
    app = paper()
    body = picture(2400)
    app.receive("UART1", message(5_000_999), 0, 20_000)
    capture(app, body, 0, stamp_us=33_000)
    pieces = [cpx(GAP8, HOST, APP, body[at : at + 1020]) for at in range(0, 2400, 1020)]
    assert sent(app) == [header(body, 5_000 + 13), *pieces]


@pytest.mark.parametrize(
    ("right", "ms"),
    [
        (0, 5_000 + 13),
        (UNFLOORED, 5_014),  # 5000.999 + 13
        (FIRST_BYTE, 5_000 + 16),
        (UNFLOORED | FIRST_BYTE, 5_017),  # 5000.999 + 13 + 3.472
        (MIDDLE, 5_000 + 8),  # 40 rows and 100 lines of exposure of 62.7 us, half of it: 4.389
        (UNFLOORED | FIRST_BYTE | MIDDLE, 5_013),  # 13.082 of 5000 on
    ],
)
def test_each_part_of_the_rule_can_be_set_right(right: int, ms: int) -> None:
    app = paper(paper=right)
    body = picture(2400)
    app.receive("UART1", message(5_000_999), 0, 20_000)
    capture(app, body, 0, stamp_us=33_000)
    assert sent(app)[0] == header(body, ms)


def test_before_the_first_message_the_time_is_its_own() -> None:
    app = paper(paper=FIRST_BYTE)
    body = picture(2400)
    capture(app, body, 0, stamp_us=77_999)
    assert sent(app)[0] == header(body, 77, NOTHING)


def test_an_old_message_is_used_without_a_word() -> None:
    """And across a wrap of the GAP8's clock and of the field."""
    app = paper(stamp_bits=32)
    body = picture(2400)
    app.receive("UART1", message((2**32 - 2) * 1000), 0, 2**32 - 1_000)
    capture(app, body, 0, stamp_us=4_000)
    assert sent(app)[0] == header(body, 3)


def test_damaged_messages_are_counted_and_leave_the_last_one() -> None:
    app = paper()
    app.receive("UART1", message(1_000_000), 0, 0)
    damaged = bytearray(message(9_000_000))
    damaged[20] ^= 1
    app.receive("UART1", bytes(damaged) + b"\xd5\x2a" + bytes(15), 0, 0)
    body = picture(2400)
    capture(app, body, 0, stamp_us=5_000)
    assert sent(app)[0] == header(body, 1_005)
    assert (app.stamp_rx.received, app.stamp_rx.bad_check, app.stamp_rx.garbage_bytes) == (1, 1, 40 + 17)


def test_a_burst_is_taken_then_sent_then_the_next_is_taken() -> None:
    app = paper(camera={"burst": 3})
    bodies = [picture(2400, seed) for seed in range(3)]
    for number, body in enumerate(bodies):
        assert app.transmit("SPI", number * 1000) == b""
        capture(app, body, number * 1000)
    assert app.transmit("CAMERA", 3000) == b"", "the burst before is not sent yet"
    packets = sent(app)
    assert b"".join(packet[2:] for packet in packets if len(packet) != 45) == b"".join(bodies)
    assert len(app.transmit("CAMERA", 4000)) == 8


def test_without_taking_turns_frames_go_as_they_come() -> None:
    app = paper(camera={"burst": 3}, paper=OVERLAP)
    capture(app, picture(2400))
    assert len(sent(app)) == 4
    capture(app, picture(2400))
    assert len(sent(app)) == 4


def settings(*values: int, size: int = 8) -> bytes:
    return struct.pack("<BBBBHBB", *values)[:size].ljust(size, b"\0")


@pytest.mark.parametrize("source", [STM32, HOST])
@pytest.mark.parametrize(("lines", "taken"), [(50, 50), (0, 2), (1, 2), (532, 532), (533, 532), (65535, 532)])
def test_camera_settings(source: int, lines: int, taken: int) -> None:
    app = paper(camera={"frame_period_us": 7000})
    app.receive("SPI", link(cpx(source, GAP8, APP, settings(0, 1, 8, 3, lines, 2, RAW))), 0)
    assert app.transmit("SPI", 0) == b"", "nothing answers them"
    assert app.transmit("CAMERA", 0)[1:] == struct.pack("<BBBBBH", RAW, 1, 8, 3, 0, taken)
    assert (app.camera.burst, app.camera.frame_period_us) == (2, 7000)


@pytest.mark.parametrize(
    "bad", [(0, 2, 8, 3, 50, 1, 0), (0, 0, 3, 3, 50, 1, 0), (0, 0, 8, 0, 50, 1, 0), (0, 0, 8, 3, 50, 4, 0)]
)
def test_camera_settings_out_of_range_change_nothing(bad: tuple[int, ...]) -> None:
    app = paper()
    app.receive("SPI", link(cpx(STM32, GAP8, APP, settings(*bad))), 0)
    assert app.requests_refused == 1
    assert (app.camera_next.analog_gain, app.camera_next.exposure_lines) == (1, 100)


def test_what_it_does_not_know() -> None:
    """Native requests among it."""
    app = paper()
    before = app.packets_unknown
    for data in (b"\x4e\x10\x01\0\0\0", settings(1, 0, 8, 3, 50, 1, 0), settings(0, 0, 8, 3, 50, 1, 0, size=7)):
        app.receive("SPI", link(cpx(HOST, GAP8, APP, data)), 0)
    assert app.packets_unknown == before + 3
    assert app.transmit("SPI", 0) == b""


def test_it_streams_for_a_client_only() -> None:
    app = gap8(firmware=GAP8_PAPER, connect=False)
    assert app.transmit("CAMERA", 0) == b""
    app.receive("SPI", CONNECTED, 0)
    assert len(app.transmit("CAMERA", 0)) == 8


# ESP32


def frame(seed: int) -> list[bytes]:
    body = picture(2400, seed)
    return [header(body, seed), *(cpx(GAP8, HOST, APP, body[at : at + 1020]) for at in range(0, 2400, 1020))]


def test_the_router_takes_whole_frames_of_it() -> None:
    app = esp32()
    give_all(app, frame(1) + frame(2))
    assert from_tcp(app) == frame(1) + frame(2)
    assert app.frames_forwarded == 2


def test_the_router_drops_whole_frames_of_it() -> None:
    app = esp32()
    sent_frames = [frame(seed) for seed in range(60)]
    for each in sent_frames:
        give_all(app, each)
    taken = lib.ESP32_IMAGE_BYTES // sum(len(packet) + 2 for packet in frame(0))
    assert (app.frames_forwarded, app.frames_dropped) == (taken, 60 - taken)
    assert from_tcp(app) == [packet for each in sent_frames[:taken] for packet in each]


def test_the_router_begins_anew_at_its_header() -> None:
    app = esp32()
    give_all(app, frame(1)[:2])
    give_all(app, frame(2))
    give(app, "SPI", cpx(GAP8, HOST, 2, b"hello\0"))
    assert from_tcp(app) == [cpx(GAP8, HOST, 2, b"hello\0"), *frame(1)[:2], *frame(2)]
    assert app.frames_cut == 1
