"""A GAP8 that has missed that its host went still sends native: none of it may reach a host that has not asked."""

import struct
import zlib

import pytest
from board import APP, CONSOLE, ESP32, GAP8, HOST, STM32, WIFI_CTRL, App, cpx
from esp32_rig import (
    CLIENT,
    CLIENT_GONE,
    NATIVE_REQUEST,
    ask,
    esp32,
    from_spi,
    from_tcp,
    give,
    give_all,
    native_frame,
    stock_frame,
    told,
)

REPLY = cpx(GAP8, HOST, APP, b"\x4e\x05\x10\x00")
CAMERA_REQUEST = cpx(HOST, GAP8, APP, b"\x4e\x11" + bytes(12))
NEW_CLIENT = told(0, GAP8) + told(1, GAP8)


def damaged(packet: bytes) -> bytes:
    return packet[:30] + bytes([packet[30] ^ 1]) + packet[31:]


def after(frame: list[bytes]) -> App:
    """A host that has had this frame and nothing else."""
    app = esp32()
    give_all(app, frame)
    assert from_tcp(app) == frame
    return app


@pytest.mark.parametrize("before", [[], stock_frame(20, 20)], ids=["at once", "after a stock frame"])
def test_a_host_that_has_not_asked_gets_nothing_native(before: list[bytes]) -> None:
    app = after(before)
    frame = native_frame(3000, 1, 100)
    give_all(app, [*frame, REPLY])
    assert from_tcp(app) == []
    assert (app.frames_unasked, app.frames_dropped, app.frames_cut) == (1, 0, 0)
    assert app.packets_unsent == len(frame) + 1
    assert from_spi(app) == NEW_CLIENT
    following = [*stock_frame(102, 20, 3), cpx(GAP8, HOST, CONSOLE, b"also")]
    give_all(app, following)
    assert sorted(from_tcp(app)) == sorted(following)


@pytest.mark.parametrize("before", [[], stock_frame(20, 20)], ids=["at once", "after a stock frame"])
def test_a_damaged_frame_message_is_held_back_too(before: list[bytes]) -> None:
    app = after(before)
    header, *rest = native_frame(3000, 1, 100)
    give_all(app, [damaged(header), *map(damaged, rest)])
    assert from_tcp(app) == []
    assert app.packets_unsent == 1 + len(rest)


def test_the_gap8_is_told_once_for_each_frame_and_only_when_nothing_waits() -> None:
    app = esp32()
    for number in range(5):
        give_all(app, native_frame(3000, number, 10))
        assert from_spi(app) == NEW_CLIENT
    for number in range(5):
        give_all(app, native_frame(3000, number, 10))  # its windows bring nothing
    assert from_spi(app) == NEW_CLIENT
    assert app.packets_dropped == 0
    assert app.frames_unasked == 10


def test_a_frame_that_was_under_way_when_the_client_came_tells_nothing() -> None:
    """The GAP8 has heard of the client by the time it begins another one."""
    app = esp32()
    ask(app, 0)
    frame = native_frame(3000, 1, 100)
    give_all(app, frame[:2])
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    assert from_spi(app) == NEW_CLIENT
    give_all(app, frame[2:])
    assert from_spi(app) == from_tcp(app) == []
    assert app.frames_unasked == 0


@pytest.mark.parametrize("data_max", [0, 144, 1020])
def test_what_was_asked_for_is_forgotten_with_the_client(data_max: int) -> None:
    app = esp32()
    ask(app, data_max)
    frame = native_frame(3000, 1, 100, data_max or 1020)
    give_all(app, [REPLY, *frame])
    assert from_tcp(app) == [REPLY, *frame]
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    from_spi(app)
    give_all(app, [REPLY, *frame])
    assert from_tcp(app) == []
    ask(app, data_max)
    give_all(app, [REPLY, *frame])
    assert from_tcp(app) == [REPLY, *frame]


def log_message(state: int = 2) -> bytes:
    message = struct.pack("<BBBBQ9I", 0x4E, 6, state, 0, 1, *range(9))
    return cpx(STM32, HOST, APP, message + struct.pack("<I", zlib.crc32(message)))


def test_messages_about_the_log_go_to_a_host_that_has_asked_the_stm32() -> None:
    app = esp32()
    request = NATIVE_REQUEST + bytes(2)
    for target in (GAP8, ESP32, None):
        if target is not None:
            give(app, "TCP", cpx(HOST, target, APP, request))
        app.transmit("UART2", 0)
        from_tcp(app)
        give(app, "UART2", log_message())
        assert from_tcp(app) == [], target
    assert app.packets_unsent == 3
    give(app, "UART2", cpx(STM32, HOST, APP, b"\x4e\x06 of somebody else"))
    assert len(from_tcp(app)) == 1
    give(app, "TCP", cpx(HOST, STM32, APP, request))
    give(app, "UART2", log_message())
    assert from_tcp(app) == [log_message()]
    give(app, "TCP", cpx(HOST, STM32, APP, b"\x4e\x10\0\0\0\0"))
    give(app, "UART2", log_message())
    assert from_tcp(app) == []


def test_the_next_host_gets_no_messages_about_the_log() -> None:
    app = esp32()
    give(app, "TCP", cpx(HOST, STM32, APP, NATIVE_REQUEST + bytes(2)))
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    give(app, "UART2", log_message())
    assert from_tcp(app) == []
    assert app.packets_unsent == 1


def test_a_host_that_goes_back_to_stock_gets_the_frame_under_way() -> None:
    app = esp32()
    ask(app, 0)
    frame = native_frame(3000, 1, 100)
    give_all(app, frame[:2])
    give(app, "TCP", cpx(HOST, GAP8, APP, b"\x4e\x10\x00" + bytes(3)))
    give_all(app, [REPLY, *frame[2:]])
    assert sorted(from_tcp(app)) == sorted([REPLY, *frame])
    assert app.frames_unasked == 0


def test_who_asks_for_camera_settings_gets_the_reply_and_stock_frames() -> None:
    app = esp32()
    give(app, "TCP", CAMERA_REQUEST)
    assert from_spi(app) == [CAMERA_REQUEST]
    reply = cpx(GAP8, HOST, APP, b"\x4e\x05\x11\x00")
    frame = stock_frame(20, 20)
    give_all(app, [*frame[:1], reply, *frame[1:], *native_frame(1000)])
    assert from_tcp(app) == [reply, *frame]
    assert app.frames_unasked == 1


@pytest.mark.parametrize("dialect", [0, 2])
def test_a_request_that_asks_for_no_native_frames_brings_none(dialect: int) -> None:
    app = esp32()
    give(app, "TCP", cpx(HOST, GAP8, APP, struct.pack("<BBBBH", *NATIVE_REQUEST[:2], dialect, 0, 0)))
    give(app, "TCP", cpx(HOST, ESP32, WIFI_CTRL, NATIVE_REQUEST + bytes(2)))
    give_all(app, native_frame(1000))
    assert from_tcp(app) == []
