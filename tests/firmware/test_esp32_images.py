"""The image stream through the ESP32: whole frames or none, and never in the way of other packets."""

import random
import struct

import pytest
from board import (
    APP,
    CONSOLE,
    CRTP,
    GAP8,
    HOST,
    STM32,
    TEST,
    App,
    cpx,
    link,
    unlink,
)
from esp32_rig import (
    CLIENT,
    CLIENT_GONE,
    ask,
    esp32,
    from_tcp,
    give,
    give_all,
    native_frame,
    stock_frame,
)

RING_BYTES = 114688


@pytest.mark.parametrize("size", [7, 1440, 65535])
@pytest.mark.parametrize(
    "frame",
    [
        stock_frame(324, 244),
        stock_frame(324, 324),
        stock_frame(102, 10),
        stock_frame(11, 1),
        native_frame(1000, 7, 100),
    ],
    ids=["qvga", "full", "one packet", "body like a header", "native"],
)
def test_a_frame_goes_to_the_host_byte_for_byte(frame: list[bytes], size: int) -> None:
    app = esp32()
    if frame[0][2:4] == b"\x4e\x01":
        ask(app, 0)
    give_all(app, frame)
    assert from_tcp(app, size=size) == frame
    assert (app.frames_forwarded, app.frames_dropped, app.frames_cut) == (1, 0, 0)


def test_a_blocked_connection_costs_whole_frames_and_no_other_packet() -> None:
    app = esp32()
    frames = [stock_frame(324, 244, seed) for seed in range(3)]
    give_all(app, frames[0])
    start = app.transmit("TCP", 0, size=700)  # the window closes inside the header's packet's successor
    for n, packet in enumerate(frames[1]):
        give(app, "SPI", packet)
        if n % 10 == 0:
            give(app, "UART2", cpx(STM32, HOST, CRTP, bytes([n])))
    assert (app.frames_forwarded, app.frames_dropped) == (1, 1)
    stream = start
    while piece := app.transmit("TCP", 0, size=1440):
        stream += piece
    console = [cpx(STM32, HOST, CRTP, bytes([n])) for n in range(0, 79, 10)]
    # What waits goes out at the next border between packets: behind the one that was cut by the window.
    assert unlink(stream) == frames[0][:2] + console + frames[0][2:]
    give_all(app, frames[2])
    assert from_tcp(app) == frames[2]
    assert (app.frames_forwarded, app.frames_dropped, app.packets_dropped) == (2, 1, 0)


@pytest.mark.parametrize("small", [1, 3])
def test_every_frame_that_is_taken_fits(small: int) -> None:
    """Whatever is left in the ring, a frame comes whole or not at all."""
    app = esp32()
    rng = random.Random(small)
    sent, expected = [], []
    for n in range(60):
        frame = stock_frame(rng.randrange(1, 300), rng.randrange(1, 300), n)
        dropped = app.frames_dropped
        give_all(app, frame)
        expected += frame if app.frames_dropped == dropped else []
        stream = b""
        for _ in range(rng.randrange(small * 20)):
            stream += app.transmit("TCP", 0, size=1440)
        sent.append(stream)
    while piece := app.transmit("TCP", 0, size=1440):
        sent.append(piece)
    assert unlink(b"".join(sent)) == expected
    assert app.frames_forwarded + app.frames_dropped == 60
    assert app.frames_dropped > 0
    assert app.frames_cut == 0


def test_a_frame_that_can_never_fit_is_dropped() -> None:
    app = esp32()
    give_all(app, stock_frame(400, 300))
    assert from_tcp(app) == []
    assert app.frames_dropped == 1
    small = stock_frame(20, 20)
    give_all(app, small)
    assert from_tcp(app) == small


def test_a_frame_that_the_gap8_broke_off_is_cut() -> None:
    app = esp32()
    first, second = stock_frame(324, 244, 1), stock_frame(324, 244, 2)
    give_all(app, first[:30])
    give_all(app, second)
    assert from_tcp(app) == first[:30] + second
    assert (app.frames_cut, app.frames_forwarded) == (1, 1)


def test_a_body_that_runs_over_its_frame_is_cut() -> None:
    app = esp32()
    first, second = stock_frame(100, 15, 1), stock_frame(20, 20, 2)
    give_all(app, [*first[:2], first[1], *second])
    assert from_tcp(app) == first[:2] + second
    assert app.frames_cut == 1


def test_a_client_that_joins_in_mid_frame_gets_the_next_one() -> None:
    for frame in (stock_frame(324, 244, 1), native_frame(1024, 3)):
        app = esp32()
        give_all(app, frame[:2])
        app.receive("NETWORK", CLIENT_GONE, 0)
        app.receive("NETWORK", CLIENT, 0)
        give_all(app, frame[2:])
        unsent = app.packets_unsent
        assert unsent >= len(frame) - 2
        following = stock_frame(30, 30, 2)
        give_all(app, following)
        assert from_tcp(app) == following


def test_a_reply_inside_a_stock_frame_is_no_part_of_its_body() -> None:
    app = esp32()
    ask(app, 100)  # too little: refused
    frame = stock_frame(324, 244)
    reply = cpx(GAP8, HOST, APP, b"\x4e\x05\x10\x00")
    give_all(app, [*frame[:30], reply, *frame[30:]])
    packets = from_tcp(app)
    assert packets == [reply, *frame]
    assert app.frames_forwarded == 1


def test_other_app_packets_pass_between_frames_only_once_the_stream_is_known() -> None:
    app = esp32()
    other = cpx(GAP8, HOST, APP, b"hello")
    give(app, "SPI", other)  # may be the tail of a frame
    frame = stock_frame(20, 20)
    give_all(app, [*frame, other])
    assert from_tcp(app) == [other, *frame]
    assert app.packets_unsent == 1


@pytest.mark.parametrize(("data_max", "size"), [(1020, 104_976), (200, 79_056), (100, 79_056)])
def test_a_native_frame_is_measured_by_the_packets_that_were_asked_for(data_max: int, size: int) -> None:
    app = esp32()
    ask(app, 0)
    ask(app, data_max)  # 100 is refused: it gets what it had asked for before, and may get less
    frame = native_frame(size, 1, 60, data_max)
    give_all(app, frame)
    assert from_tcp(app) == frame
    give_all(app, frame)
    give_all(app, native_frame(size, 2, 60, data_max))
    packets = from_tcp(app)
    assert packets[: len(frame)] == frame
    assert {packet[2:4] for packet in packets[len(frame) :]} == {b"\x4e\x03"}, "pairs go on without their frame"
    assert (app.frames_forwarded, app.frames_dropped, app.frames_cut) == (2, 1, 0)


def test_pairs_never_take_the_place_of_a_body() -> None:
    app = esp32()
    ask(app, 0)
    frame = native_frame(104_976, 1, 48 * 10, 1020)
    give_all(app, frame)
    packets = from_tcp(app)
    assert [packet for packet in packets if packet[2:4] != b"\x4e\x03"] == [frame[0], *frame[11:]]
    assert app.packets_dropped == len(frame) - len(packets) > 0
    assert app.frames_forwarded == 1


def test_a_frame_in_smaller_packets_than_asked_for_is_cut_when_the_ring_is_full() -> None:
    app = esp32()
    ask(app, 0)
    frame = native_frame(104_976, 1, 0, 104)
    give_all(app, frame)
    packets = from_tcp(app)
    assert packets == frame[: len(packets)]
    assert len(packets) < len(frame)
    assert (app.frames_cut, app.frames_forwarded) == (1, 0)
    following = native_frame(1000, 2, 0, 104)
    give_all(app, following)
    assert from_tcp(app) == following


LOOK_ALIKES = {
    "stock header": stock_frame(9, 9)[0][2:],
    "native frame": native_frame(9)[0][2:],
    "reply": b"\x4e\x05\x10\x00",
    "pairs": native_frame(9, pairs=1)[1][2:],
    "native data": native_frame(9)[1][2:],
}


@pytest.mark.parametrize("alike", LOOK_ALIKES.values(), ids=LOOK_ALIKES.keys())
def test_a_stock_body_may_look_like_anything(alike: bytes) -> None:
    app = esp32()
    body = alike.ljust(1020, b"x") + alike
    header = struct.pack("<BHHBBI", 0xBC, 324, 324, 1, 1, len(body))
    frame = [cpx(GAP8, HOST, APP, data) for data in (header, body[:1020], body[1020:])]
    other = cpx(GAP8, HOST, CONSOLE, b"between")
    give_all(app, [*frame, other])
    assert from_tcp(app) == [other, *frame]
    assert (app.frames_forwarded, app.frames_cut, app.packets_dropped) == (1, 0, 0)


def jpeg_frame(size: int) -> list[bytes]:
    """With its file header and footer in packets of their own."""
    header = struct.pack("<BHHBBI", 0xBC, 324, 324, 1, 1, size)
    parts = [b"h" * 300, *(b"d" * min(1020, size - 302 - at) for at in range(0, size - 302, 1020)), b"\xff\xd9"]
    return [cpx(GAP8, HOST, APP, data) for data in (header, *parts)]


@pytest.mark.parametrize("short", [0, 1, 8])
def test_a_jpeg_that_would_just_not_fit_is_dropped_whole(short: int) -> None:
    app = esp32()
    jpeg = jpeg_frame(10_600)
    fill_ring(app, sum(map(len, map(link, jpeg))) - short)
    give_all(app, jpeg)
    assert (app.frames_forwarded, app.frames_dropped, app.frames_cut) == ((2, 0, 0) if short == 0 else (1, 1, 0))


def test_a_native_frame_leaves_room_for_pairs() -> None:
    frame = native_frame(1000)
    needed = sum(map(len, map(link, frame)))
    for spare, taken in ((4096, True), (4095, False)):
        app = esp32()
        ask(app, 0)
        fill_ring(app, needed + spare)
        give_all(app, frame)
        assert app.frames_dropped == (not taken)


def fill_ring(app: App, free: int) -> None:
    """Leaves `free` bytes of the ring, by one frame."""
    wanted = RING_BYTES - app.image_fill - free - 15
    body = wanted - 4 * -(-wanted // 1024)
    header = struct.pack("<BHHBBI", 0xBC, 324, 324, 1, 1, body)
    give(app, "SPI", cpx(GAP8, HOST, APP, header))
    for at in range(0, body, 1020):
        give(app, "SPI", cpx(GAP8, HOST, APP, bytes(min(1020, body - at))))
    assert RING_BYTES - app.image_fill == free


def test_a_packet_cut_on_tcp_does_not_stop_uart2() -> None:
    app = esp32()
    give_all(app, stock_frame(324, 244))
    app.transmit("TCP", 0, size=500)
    packet = cpx(HOST, STM32, TEST, b"\x01")
    give(app, "TCP", packet)
    assert app.uart_packets(0) == [packet]
