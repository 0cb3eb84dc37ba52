"""The apps as NanoCockpit: states, buffers and the bridge between GAP8 and host, to the byte."""

import random
import struct
import zlib
from typing import Any

import pytest
from board import APP, CONSOLE, GAP8, HOST, NEVER_US, STM32, App, cpx
from c_memory import POISONS
from gap8_rig import GAP8_NANOCOCKPIT, JPEG, capture, picture

from host.native import lib

STREAMER = 6
LARGE = 4092
HOVERS = {"x_m": 0.5, "y_m": -1.25, "z_m": 40.0, "qx": 0.0, "qy": 0.0, "qz": 0.0, "qw": 1.0}


def nano(packet: bytes) -> bytes:
    """Its link: the length leaves out the route."""
    return struct.pack("<H", len(packet) - 2) + packet


def state(time: int, x: int = 500, vx: int = 0, quat: int = 0xC0000000, z: int = 32767) -> bytes:
    return struct.pack("<I9hI3h", time, x, -1250, z, vx, *[0] * 5, quat, 0, 0, 0)


def message(content: bytes, sign: bytes = b"!STA") -> bytes:
    return sign + content + struct.pack("<I", zlib.crc32(sign + content))


def metadata(width: int, height: int, frame_id: int, frame_us: int, state_us: int, last: bytes, *reply: int) -> bytes:
    head = struct.pack("<BHHBBBII", 10, width, height, 1, 0, frame_id, frame_us, state_us)
    return head + last + bytes(72) + struct.pack("<II", *(reply or (0, 0))) + bytes(20)


def packets(buffer: bytes, check: int) -> list[bytes]:
    padded = buffer + bytes(-len(buffer) % 4)
    first = struct.pack("<BBII2x", 0x10, 1, len(buffer), check) + padded[:4076]
    rest = [b"\x11\0\0\0" + padded[at : at + 4084] for at in range(4076, len(padded), 4084)]
    return [nano(cpx(GAP8, HOST, STREAMER, data)) for data in (first, *rest)]


# STM32


@pytest.mark.parametrize(("kind", "time"), [(lib.STM32_NANOCOCKPIT, 12), (lib.STM32_NANOCOCKPIT_US, 0x1E2F)])
@pytest.mark.parametrize("poison", POISONS)
def test_states_to_the_byte(kind: int, time: int, poison: int) -> None:
    """Ticks of the uptime, or 32 bits of the stamp clock; 40 m is more than 16 bits of mm hold."""
    app = App("stm32", poison, stamp_format=kind, pose=HOVERS)
    wire = app.transmit("UART1", 12_999, 0x5600001E2F) + app.uart_bytes("UART1", 13_000, most=39)
    assert wire == message(state(time))


def test_it_moves_as_fast_as_it_says() -> None:
    app = App("stm32", stamp_format=lib.STM32_NANOCOCKPIT, pose=HOVERS, sway_m=0.5)
    for up_us, x, vx in ((0, 250, 250), (1_000_000, 500, 250), (2_000_000, 750, -250), (3_000_000, 500, -250)):
        assert app.uart_bytes("UART1", up_us, most=40) == message(state(up_us // 1000, x, vx))


# GAP8


def gap8(width: int = 60, height: int = 40, poison: int = POISONS[0], **config: Any) -> App:
    camera = {"analog_gain": 1, "digital_gain": 64, "burst": 1, "exposure_lines": 100, **config.pop("camera", {})}
    sizes = {"width": width, "height": height, "line_time_ns": 62_700}
    return App("gap8", poison, firmware=GAP8_NANOCOCKPIT, stream_always=True, camera=camera, **sizes, **config)


def sent(app: App) -> list[bytes]:
    found = []
    while window := app.transmit("SPI", 0, size=LARGE):
        found.append(window)
    return found


@pytest.mark.parametrize("poison", POISONS)
def test_a_frame_to_the_byte(poison: int) -> None:
    app = gap8(160, 160, poison)
    body = picture(25600)
    app.receive("UART1", message(state(7)), 0, 2**32 + 20_000)
    capture(app, body, 0, stamp_us=2**32 + 33_000)
    buffer = metadata(160, 160, 0, 33_000, 20_000, state(7)) + body
    assert sent(app) == packets(buffer, check=0)
    assert [len(window) for window in packets(buffer, 0)] == [4092] * 6 + [4 + 4 + 1252]


@pytest.mark.parametrize(
    ("width", "height"), [(1, 1), (2, 1), (3, 1), (4, 1), (491, 8), (131, 30), (1003, 4), (1002, 8), (4, 982)]
)
def test_sizes_around_the_edges_of_packets(width: int, height: int) -> None:
    """3928 pixels fill the first packet, 8012 the second."""
    size = width * height
    app = gap8(width, height)
    body = picture(size)
    capture(app, body)
    assert sent(app) == packets(metadata(width, height, 0, 0, 0, bytes(32)) + body, check=0)


def test_a_check_when_it_is_built_with_one() -> None:
    app = gap8(nanocockpit_check=True)
    body = picture(2400)
    capture(app, body)
    buffer = metadata(60, 40, 0, 0, 0, bytes(32)) + body
    assert sent(app) == packets(buffer, zlib.crc32(buffer))


def test_the_state_is_the_latest_when_sending_begins() -> None:
    app = gap8()
    body = picture(2400)
    app.receive("UART1", message(state(7)), 0, 20_000)
    capture(app, body, 0, stamp_us=33_000)
    app.receive("UART1", message(state(8)), 0, 34_000)
    assert sent(app) == packets(metadata(60, 40, 0, 33_000, 34_000, state(8)) + body, 0)


def test_other_messages_of_uart1_are_skipped() -> None:
    app = gap8()
    noise, ranges = message(bytes(4), b"!RNG"), message(bytes(68), b"!TOF")
    damaged = message(state(9))[:-1] + b"\0"
    app.receive("UART1", noise + message(state(7)) + ranges, 0, 20_000)
    app.receive("UART1", damaged, 0, 30_000)
    assert (app.stamp_last_gap8_us, app.state_last.stm32_time) == (20_000, 7)
    assert (app.stamp_rx.received, app.stamp_rx.bad_check, app.stamp_rx.garbage_bytes) == (3, 1, 40)


def test_the_sensor_counts_what_nobody_took() -> None:
    app = gap8(camera={"frame_period_us": 10_000})
    ids = []
    for number in range(300):
        up_us = number * 10_000
        if number % 3 == 1:
            capture(app, b"", up_us)  # failed
            continue
        capture(app, picture(2400), up_us)
        ids.append(sent(app)[0][4 + 12 + 7])
    assert ids == [number % 256 for number in range(300) if number % 3 != 1]
    assert app.transmit("CAMERA", 10_000 * 300 + 50_000) != b""


def reply(frame_us: int, frame_id: int, kind: int = 0xF0, check: int | None = None, size: int = 25) -> bytes:
    buffer = struct.pack("<IB20x", frame_us, frame_id)
    right = zlib.crc32(buffer)
    head = struct.pack("<BBII2x", 0x10, kind, size, right if check is None else check)
    return nano(cpx(HOST, GAP8, STREAMER, head + buffer))


@pytest.mark.parametrize("check", [None, 0])
def test_answers_come_back_in_the_next_frame(check: int | None) -> None:
    app = gap8()
    app.receive("SPI", reply(33_000, 7, check=check), 0, 2**32 + 50_000)
    body = picture(2400)
    capture(app, body)
    assert sent(app) == packets(metadata(60, 40, 0, 0, 0, bytes(32), 33_000, 50_000) + body, 0)


@pytest.mark.parametrize(
    "bad",
    [
        reply(1, 2, check=5),
        reply(1, 2, size=26),
        nano(cpx(HOST, GAP8, APP, b"\x10" + bytes(36))),
        nano(cpx(HOST, STM32, STREAMER, reply(1, 2)[4:])),
        nano(cpx(HOST, GAP8, STREAMER, b"\x11\0\0\0")),
    ],
)
def test_what_it_does_not_know(bad: bytes) -> None:
    app = gap8()
    app.receive("SPI", bad, 0)
    assert (app.packets_unknown, app.reply_last.frame_gap8_us) == (1, 0)


def test_damage_on_spi() -> None:
    app = gap8()
    app.receive("SPI", b"\xf9\x0f\x5c\x06", 0)  # 4089 bytes
    app.receive("SPI", b"\x05\x00\x5c\x06", 0)  # more than there are
    app.receive("SPI", bytes(4), 0)  # idle
    assert (app.spi_errors, app.packets_unknown) == (2, 0)


def test_it_waits_for_a_window_that_is_large_enough() -> None:
    app = gap8()
    capture(app, picture(2400))
    assert app.transmit("SPI", 0, size=LARGE - 1) == b""
    assert len(sent(app)) == 1


def test_jpeg_is_none_of_its_encodings() -> None:
    with pytest.raises(ValueError, match=str(lib.ERR_VALUE)):
        gap8(camera={"encoding": JPEG})


# ESP32

CLIENT, CLIENT_GONE = b"\x02", b"\x03"


def bridge(client: bool = True, poison: int = POISONS[0]) -> App:
    app = App("esp32", poison, bridge=1)
    assert app.transmit("NETWORK", 0, size=128) == b"\x10\x01\x09crazyflie\x00"
    if client:
        app.receive("NETWORK", CLIENT, 0)
    return app


def frame(seed: int, size: int = 9000) -> list[bytes]:
    return packets(random.Random(seed).randbytes(size), check=seed)


def give_all(app: App, windows: list[bytes]) -> None:
    for window in windows:
        app.receive("SPI", window, 0)


def tcp(app: App, size: int = 1440) -> bytes:
    stream = b""
    while piece := app.transmit("TCP", 0, size=size):
        stream += piece
    return stream


@pytest.mark.parametrize("size", [1, 3, 1440, 5000])
def test_the_bridge_changes_no_byte(size: int) -> None:
    app = bridge()
    give_all(app, frame(1) + frame(2))
    assert tcp(app, size) == b"".join(frame(1) + frame(2))
    assert (app.frames_forwarded, app.frames_dropped) == (2, 0)


def test_the_bridge_has_nothing_of_its_own_to_say() -> None:
    app = bridge()
    assert app.transmit("UART2", 0) == b""
    assert app.transmit("UART2", 10**9) == b""
    assert app.receive("UART2", b"\xff\x00" * 9, 0) == 18
    assert app.transmit("SPI", 10**9, size=LARGE) == bytes(4)
    assert tcp(app) == b""
    assert app.deadline() == NEVER_US


def test_the_bridge_drops_whole_frames() -> None:
    app = bridge()
    all_frames = [frame(seed, 30_000) for seed in range(6)]
    for each in all_frames:
        give_all(app, each)
    assert (app.frames_forwarded, app.frames_dropped) == (3, 3)
    assert tcp(app) == b"".join(b"".join(each) for each in all_frames[:3])
    give_all(app, all_frames[5])
    assert tcp(app) == b"".join(all_frames[5])


def test_the_largest_frame_fits_alone() -> None:
    app = bridge()
    full = frame(1, 148 + 324 * 324)
    give_all(app, full)
    assert tcp(app) == b"".join(full)


@pytest.mark.parametrize("size", [2**31, 2**32 - 1, 200_000])
def test_a_frame_that_can_never_fit(size: int) -> None:
    app = bridge()
    head = struct.pack("<BBII2x", 0x10, 1, size, 0)
    give_all(app, [nano(cpx(GAP8, HOST, STREAMER, head + bytes(100))), *frame(1)])
    assert tcp(app) == b"".join(frame(1))
    assert app.frames_dropped == 1


def test_a_client_gets_no_tail_of_a_frame() -> None:
    app = bridge(client=False)
    give_all(app, frame(1)[:2])
    app.receive("NETWORK", CLIENT, 0)
    give_all(app, frame(1)[2:] + frame(2)[:1])
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    give_all(app, frame(2)[1:] + frame(3))
    assert tcp(app) == b"".join(frame(3))


def test_other_packets_pass() -> None:
    app = bridge()
    hello = nano(cpx(GAP8, HOST, CONSOLE, b"hello\0"))
    give_all(app, [frame(1)[0], hello, *frame(1)[1:]])
    assert tcp(app) == frame(1)[0] + hello + b"".join(frame(1)[1:])


def test_a_new_frame_in_the_middle_of_another() -> None:
    app = bridge()
    give_all(app, frame(1)[:2] + frame(2))
    assert tcp(app) == b"".join(frame(1)[:2] + frame(2))
    assert app.frames_cut == 1


def test_more_than_was_announced() -> None:
    app = bridge()
    windows = frame(1)
    give_all(app, [*windows, windows[-1], *frame(2)])
    assert tcp(app) == b"".join(windows + frame(2))
    assert app.packets_unsent == 1


@pytest.mark.parametrize("cut", range(1, 41))
def test_packets_of_the_host_reach_the_gap8_whole(cut: int) -> None:
    app = bridge()
    wire = reply(33_000, 7)
    assert app.receive("TCP", wire[:cut], 0) == cut
    if cut < len(wire):
        assert app.transmit("SPI", 0, size=LARGE) == bytes(4)
        assert app.receive("TCP", wire[cut:], 0) == len(wire) - cut
    assert app.transmit("SPI", 0, size=LARGE) == wire
    assert app.transmit("SPI", 0, size=LARGE) == bytes(4)


def test_the_host_waits_while_a_packet_waits_for_spi() -> None:
    app = bridge()
    first, second = reply(1, 1), reply(2, 2)
    assert app.receive("TCP", first + second, 0) == len(first)
    assert app.receive("TCP", second, 0) == 0
    assert app.transmit("SPI", 0, size=LARGE) == first
    assert app.receive("TCP", second, 0) == len(second)
    assert app.transmit("SPI", 0, size=LARGE) == second


def test_the_largest_packet_of_the_host() -> None:
    app = bridge()
    wire = nano(cpx(HOST, GAP8, STREAMER, bytes(range(256)) * 15 + bytes(248)))
    assert len(wire) == LARGE
    assert app.receive("TCP", wire, 0) == LARGE
    assert app.transmit("SPI", 0, size=LARGE) == wire


def test_garbage_of_the_host_is_searched_over() -> None:
    app = bridge()
    wire = reply(1, 2)
    taken = app.receive("TCP", b"\xff\xff\x00\x00\x99" + wire, 0)
    assert taken == 5 + len(wire)
    assert app.transmit("SPI", 0, size=LARGE) == wire
    assert app.tcp_rx.skipped_bytes == 5


def test_half_a_packet_of_an_old_client_is_gone() -> None:
    app = bridge()
    app.receive("TCP", reply(1, 2)[:20], 0)
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    app.receive("TCP", reply(3, 4), 0)
    assert app.transmit("SPI", 0, size=LARGE) == reply(3, 4)


def test_damage_on_the_bridges_spi() -> None:
    app = bridge()
    app.receive("SPI", b"\xf9\x0f\x63\x06", 0)
    app.receive("SPI", b"\x05\x00\x63\x06", 0)
    app.receive("SPI", bytes(4), 0)
    assert app.spi_errors == 2
    assert tcp(app) == b""


@pytest.mark.parametrize("config", [{"bridge": 1, "host_on_uart": 1}, {"bridge": 2}])
def test_a_bridge_is_on_wifi(config: dict[str, int]) -> None:
    with pytest.raises(ValueError, match=str(lib.ERR_VALUE)):
        App("esp32", **config)
