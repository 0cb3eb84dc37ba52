"""The native dialect and the requests that a host may make."""

import struct
import zlib

import pytest
from board import APP, BOOTLOADER, CONSOLE, ESP32, GAP8, HOST, STM32, TEST, WIFI_CTRL, cpx, link
from gap8_rig import (
    CONNECTED,
    GAP8_STOCK,
    GONE,
    NONE_YET,
    RAW,
    ask_native,
    camera_request,
    capture,
    data_messages,
    frame_message,
    gap8,
    pairs_message,
    picture,
    request,
    sent,
    stamp,
    stock,
)


def test_a_native_frame_says_all_about_itself() -> None:
    app = gap8(camera={"analog_gain": 4, "digital_gain": 99, "burst": 1, "exposure_lines": 300})
    ask_native(app)
    app.receive("UART1", b"\xd5\x2a" + stamp(7, 5_000_000, 3) + stamp(9, 5_020_000, 3), 0, 1_000_000)
    body = picture(2400)
    capture(app, body, 0, 1_004_321)
    packets = sent(app)
    header = frame_message(packets[0])
    expected = {
        "frame": 0, "width": 60, "height": 40, "depth": 1, "encoding": RAW, "flags": 512 | 4,
        "body_bytes": 2400, "body_crc32": zlib.crc32(body), "frame_gap8_us": 1_004_321,
        "frame_stm32_us": 0, "bound_us": NONE_YET, "epoch": 3, "analog_gain": 4, "digital_gain": 99,
        "burst": 1, "exposure_lines": 300, "line_time_ns": 62_700, "stamp_sequence": 9, "stamp_age_us": 4321,
        "stamps_received": 2, "stamps_missed": 1, "stamps_bad": app.stamp_rx.bad_check + app.stamp_rx.garbage_bytes,
        "pairs_lost": 0, "captures_failed": 0, "captures_late": 0, "frames_unsent": 0, "spi_errors": 0,
        "packets_dropped": 0,
    }  # fmt: skip
    assert {name: getattr(header, name) for name in expected} == expected
    assert header.stamps_bad > 0
    pairs = [(7, 5_000_000, 1_000_000, 3), (9, 5_020_000, 1_000_000, 3)]
    assert pairs_message(packets[1]) == (pairs, 0)
    assert [len(packet) for packet in packets[2:]] == [1022, 1022, 2 + 8 + 376]
    assert data_messages(packets[2:], 0) == body


@pytest.mark.parametrize("data_max", [144, 145, 512, 1019, 1020])
def test_native_packets_are_as_small_as_the_host_wants(data_max: int) -> None:
    app = gap8()
    ask_native(app, data_max)
    for n in range(60):
        app.receive("UART1", stamp(n, n), 0)
    body = picture(2400)
    capture(app, body)
    packets = sent(app)
    assert max(map(len, packets)) <= 2 + data_max
    frame_message(packets[0])
    per_packet = min(48, (data_max - 12) // 21)
    pairs_end = 1 + -(-60 // per_packet)
    pairs = [pair for packet in packets[1:pairs_end] for pair in pairs_message(packet)[0]]
    assert [pair[0] for pair in pairs] == list(range(60))
    assert data_messages(packets[pairs_end:], 0) == body
    assert all(len(packet) == 2 + data_max for packet in packets[pairs_end:-1])


@pytest.mark.parametrize("count", [0, 1, 48, 49, 511, 512, 513, 700])
def test_every_pair_is_reported_or_counted_as_lost(count: int) -> None:
    app = gap8()
    ask_native(app)
    for n in range(count):
        app.receive("UART1", stamp(n, 10_000 * n), 0, 10_000 * n + 1480)
    capture(app, bytes(2400))
    packets = sent(app)
    lost = max(0, count - 512)
    assert frame_message(packets[0]).pairs_lost == lost
    messages = [pairs_message(packet) for packet in packets[1:-3]]
    assert {message[1] for message in messages} <= {lost}
    pairs = [pair for message in messages for pair in message[0]]
    assert pairs == [(n, 10_000 * n, 10_000 * n + 1480, 0) for n in range(lost, count)]
    assert len(messages) == -(-min(count, 512) // 48)
    capture(app, bytes(2400))
    assert len(sent(app)) == 1 + 3, "no pair is reported twice"


def test_pairs_that_come_while_a_frame_is_sent_go_with_the_next() -> None:
    app = gap8()
    ask_native(app)
    app.receive("UART1", stamp(0, 0), 0)
    capture(app, bytes(2400))
    app.transmit("SPI", 0)
    app.receive("UART1", stamp(1, 10_000), 0)
    assert pairs_message(sent(app)[0])[0] == [(0, 0, 0, 0)]
    capture(app, bytes(2400))
    assert pairs_message(sent(app)[1])[0] == [(1, 10_000, 0, 0)]


def test_a_frame_keeps_the_dialect_in_which_it_began() -> None:
    app = gap8()
    body = picture(2400)
    capture(app, body)
    packets = [app.transmit("SPI", 0)[2:]]
    ask_native(app)  # the reply goes before the next packet of the frame
    assert packets + sent(app) == stock(60, 40, RAW, [body])
    capture(app, body)
    packets = [app.transmit("SPI", 0)[2:]]
    assert frame_message(packets[0]).frame == 1
    app.receive("SPI", request(16, struct.pack("<BBH", 0, 0, 0)), 0)
    assert app.transmit("SPI", 0)[4:] == b"\x4e\x05\x10\x00"
    assert data_messages(sent(app), 1) == body
    capture(app, body)
    assert sent(app) == stock(60, 40, RAW, [body])


def test_the_next_client_gets_stock_again() -> None:
    app = gap8()
    ask_native(app)
    app.receive("SPI", GONE, 0)
    app.receive("SPI", CONNECTED, 0)
    body = picture(2400)
    capture(app, body)
    assert sent(app) == stock(60, 40, RAW, [body])


@pytest.mark.parametrize(
    ("dialect", "data_max", "status"), [(2, 0, 1), (255, 9, 1), (1, 143, 2), (1, 1021, 2), (0, 1, 2), (1, 144, 0)]
)
def test_a_stream_request_out_of_range_is_refused_by_its_field(dialect: int, data_max: int, status: int) -> None:
    app = gap8()
    app.receive("SPI", request(16, struct.pack("<BBH", dialect, 0, data_max)), 0)
    assert sent(app) == [cpx(GAP8, HOST, APP, bytes([0x4E, 5, 16, status]))]
    assert app.requests_refused == (status > 0)
    assert app.stream.dialect == (1 if status == 0 else 0)


@pytest.mark.parametrize("source", [HOST, STM32])
def test_camera_settings_come_into_force_with_the_next_burst(source: int) -> None:
    app = gap8(camera={"burst": 2})
    app.transmit("CAMERA", 0)
    app.receive("SPI", camera_request(source), 0)
    assert sent(app) == [cpx(GAP8, source, APP, b"\x4e\x05\x11\x00")]
    app.receive("CAMERA", bytes(2400), 10)
    assert capture(app, bytes(2400), 20)[3] == 1  # second of the old burst
    sent(app)
    assert capture(app, bytes(2400), 30) == bytes([0, RAW, 0, 2, 128, 0, 500 & 255, 500 >> 8])
    capture(app, bytes(2400), 40)
    assert app.transmit("CAMERA", 60) == b""
    assert app.deadline() > 60


def test_a_shorter_period_need_not_wait_for_the_end_of_a_long_one() -> None:
    app = gap8(camera={"frame_period_us": 10_000_000})
    capture(app, bytes(2400), 0)
    app.receive("SPI", camera_request(burst=1), 5000)
    sent(app)
    assert app.deadline() == 25_000
    assert app.transmit("CAMERA", 25_000) != b""


@pytest.mark.parametrize(
    ("field", "value", "status"),
    [
        ("auto_exposure", 2, 1),
        ("analog_gain", 3, 2),
        ("digital_gain", 0, 3),
        ("burst", 0, 4),
        ("burst", 4, 4),
        ("encoding", 2, 5),
        ("exposure_lines", 1, 6),
        ("period", 10_000_001, 7),
    ],
)
def test_camera_settings_out_of_range_are_refused_by_their_field(field: str, value: int, status: int) -> None:
    app = gap8()
    app.receive("SPI", camera_request(**{field: value}), 0)
    assert sent(app) == [cpx(GAP8, HOST, APP, bytes([0x4E, 5, 17, status]))]
    assert app.requests_refused == 1
    assert capture(app, bytes(2400))[3] == 1, "nothing was changed"


@pytest.mark.parametrize(
    "window",
    [
        request(16, struct.pack("<BBH", 1, 0, 0), STM32),
        request(16, struct.pack("<BBH", 1, 0, 0), ESP32),
        camera_request(ESP32),
        request(16, b"\x01"),
        request(17, b"\x01"),
        request(1, bytes(98)),
        request(99, b""),
        link(cpx(HOST, GAP8, APP, b"")),
        link(cpx(HOST, GAP8, CONSOLE, b"?\0")),
        link(cpx(HOST, STM32, TEST, b"\x01")),
        link(cpx(HOST, GAP8, TEST, b"\x02")),
        link(cpx(HOST, GAP8, TEST, b"\x01", version=1)),
        link(cpx(ESP32, GAP8, WIFI_CTRL, b"\x32")),
        link(cpx(ESP32, GAP8, BOOTLOADER, b"\x00")),
    ],
    ids=bytes.hex,
)
def test_what_means_nothing_is_counted_and_changes_nothing(window: bytes) -> None:
    app = gap8()
    app.receive("SPI", window, 0)
    assert app.packets_unknown == 1
    assert sent(app) == []
    assert app.stream.dialect == 0


def test_stock_firmware_knows_no_requests() -> None:
    app = gap8(firmware=GAP8_STOCK)
    app.receive("SPI", request(16, struct.pack("<BBH", 1, 0, 0)), 0)
    app.receive("SPI", camera_request(), 0)
    assert app.packets_unknown == 2
    assert sent(app) == []
