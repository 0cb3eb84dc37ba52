"""What comes in over SPI and UART1: packets, stamps and what is not one of them."""

import random
import struct
from typing import Any

import pytest
from board import BOOTLOADER, ESP32, GAP8, HOST, STM32, TEST, WIFI_CTRL, App, cpx, link
from c_memory import seen
from gap8_rig import (
    CONNECTED,
    GONE,
    NONE_YET,
    ask_native,
    camera_request,
    capture,
    frame_message,
    gap8,
    picture,
    request,
    sent,
    stamp,
    stamps,
)

from host.native import lib

WIRE_US = 1477
"""A stamp message's."""


def test_known_packets_without_an_answer() -> None:
    app = gap8()
    for packet in (
        cpx(ESP32, GAP8, BOOTLOADER, b"\x06"),
        cpx(ESP32, GAP8, WIFI_CTRL, b"\x31\x0a\x00\x00\x01"),
        cpx(STM32, GAP8, TEST, b"\x00sink"),
    ):
        app.receive("SPI", link(packet), 0)
    app.receive("SPI", bytes(8), 0)
    assert (app.packets_unknown, app.spi_errors) == (0, 0)
    assert sent(app) == []


@pytest.mark.parametrize(
    "window", [b"", b"\0", b"\x01\x00\x00\x00", b"\xff\x03" + bytes(1022), b"\xff\xff" + bytes(6), b"\x09\x00\x1c\x05"]
)
def test_a_window_that_makes_no_sense_is_an_error(window: bytes) -> None:
    app = gap8()
    app.receive("SPI", window, 0)
    assert app.spi_errors == 1


def test_padding_behind_a_packet_is_ignored() -> None:
    app = gap8()
    app.receive("SPI", link(cpx(HOST, GAP8, TEST, b"\x01abc")) + b"\xa5" * 3, 0)
    assert sent(app) == [cpx(GAP8, HOST, TEST, b"\x01abc")]


def test_replies_are_bounded_and_what_is_lost_is_counted() -> None:
    app = gap8()
    for n in range(9):
        app.receive("SPI", link(cpx(HOST, GAP8, TEST, bytes([1, n]))), 0)
    app.receive("SPI", link(cpx(HOST, GAP8, TEST, b"\x01" + bytes(64))), 0)
    assert sent(app) == [cpx(GAP8, HOST, TEST, bytes([1, n])) for n in range(4)]
    assert app.packets_dropped == 6


def header_after(app: App, stamp_us: int) -> Any:
    capture(app, bytes(2400), 0, stamp_us)
    packets = sent(app)
    return frame_message(packets[0])


def test_without_a_stamp_the_time_is_refused() -> None:
    app = gap8()
    ask_native(app)
    header = header_after(app, 77)
    assert (header.flags, header.stamp_age_us, header.bound_us) == (512 | 4, NONE_YET, NONE_YET)
    assert (header.frame_gap8_us, header.frame_stm32_us) == (77, 0)


def test_elapsed_time_crosses_the_wrap_of_the_stamp_clock() -> None:
    app = gap8(stamp_bits=32)
    ask_native(app)
    start_us = 2**32 - 300_000
    for n in range(31):
        app.receive("UART1", stamp(n, 500 + 10_000 * n), 0, (start_us + WIRE_US + 10_000 * n) % 2**32)
    header = header_after(app, (start_us + 320_000) % 2**32)
    assert header.stamp_age_us == 20_000 - WIRE_US
    assert abs(header.frame_stm32_us - 320_500) <= header.bound_us < 300


def test_a_very_old_stamp_is_not_none() -> None:
    app = gap8()
    ask_native(app)
    app.receive("UART1", stamp(0, 500), 0, 0)
    header = header_after(app, 2**33)
    assert (header.stamp_age_us, header.bound_us) == (NONE_YET - 1, NONE_YET)
    assert header.flags & (lib.FRAME_REFUSED | lib.FRAME_HAS_ESTIMATE) == lib.FRAME_REFUSED


def test_the_time_of_a_frame_is_the_stamps_less_their_time_on_the_wire() -> None:
    app = gap8(frame_latency_us=50)
    ask_native(app)
    stamps(app, 200, stm32_us=7_000_000, gap8_us=1_000_000 + WIRE_US, epoch=3)
    header = header_after(app, 2_995_000)
    assert header.flags == lib.FRAME_HAS_ESTIMATE | lib.FRAME_HAS_BOUND
    assert abs(header.frame_stm32_us - 8_995_000) <= 5
    assert (header.epoch, header.stamp_sequence, header.latency_us) == (3, 199, 50)
    assert 50 < header.bound_us < 70
    assert header.window_stamps > 100
    assert 1_000_000 < header.window_us < 2_000_000
    assert header.skew_ppb == 0
    assert header.delay_us < 200, "it began with a guess of 500"


def test_steps_of_the_stamp_clock_are_in_the_bound() -> None:
    app = gap8(stamp_tick_ns=30_518)
    ask_native(app)
    stamps(app, 200, gap8_us=WIRE_US)
    header = header_after(app, 1_995_000)
    assert header.flags & lib.FRAME_QUANTISED
    assert 30 < header.bound_us < 70


def test_stamps_that_stay_away_are_told_and_then_refused() -> None:
    app = gap8()
    ask_native(app)
    stamps(app, 200, gap8_us=WIRE_US)
    after = [header_after(app, 2_000_000 + age_us) for age_us in (0, 300_000, 9_000_000, 11_000_000)]
    assert [bool(header.flags & lib.FRAME_HOLDOVER) for header in after] == [False, True, True, True]
    assert [bool(header.flags & lib.FRAME_REFUSED) for header in after] == [False, False, False, True]
    assert after[0].bound_us < after[1].bound_us < after[2].bound_us


@pytest.mark.parametrize("pieces", range(1, 34))
def test_stamps_come_whole_from_any_split(pieces: int) -> None:
    app = gap8()
    stream = stamp(1, 10) + stamp(2, 20)
    app.receive("UART1", stream[:pieces], 0, 5)
    app.receive("UART1", stream[pieces:], 0, 6)
    assert (app.stamp_rx.received, app.stamps_missed, app.pairs_fill) == (2, 0, 2)
    assert app.pairs[0].gap8_us == (5 if pieces >= 17 else 6)


@pytest.mark.parametrize(
    ("sequences", "missed"),
    [
        ([5, 6, 7], 0),
        ([5, 8], 2),
        ([2**32 - 1, 0, 2], 1),  # wraps
        ([5, 5, 6], 0),  # came twice
        ([90_000, 0, 1], 0),  # the STM32 has started anew
        ([5, 5 + 100_001], 100_000),
        ([5, 5 + 100_002], 0),  # and with a sequence that is no continuation
    ],
)
def test_gaps_in_the_sequence_are_missed_stamps(sequences: list[int], missed: int) -> None:
    app = gap8()
    for sequence in sequences:
        app.receive("UART1", stamp(sequence, 1), 0)
    assert app.stamps_missed == missed
    assert app.stamp_rx.received == len(sequences)


def test_a_new_epoch_is_not_a_gap() -> None:
    app = gap8()
    ask_native(app)
    stamps(app, 100, stm32_us=9_000_000, gap8_us=WIRE_US)
    stamps(app, 100, stm32_us=12, gap8_us=1_000_000 + WIRE_US, epoch=1, first=100)
    header = header_after(app, 2_000_000)
    assert (header.epoch, header.stamps_missed) == (1, 0)
    assert abs(header.frame_stm32_us - 1_000_012) <= 10
    assert header.flags & lib.FRAME_EPOCH_NEW


@pytest.mark.parametrize("seed", range(20))
def test_under_random_traffic_nothing_is_lost_without_a_count(seed: int) -> None:
    rng = random.Random(seed)
    app = gap8(camera={"burst": rng.randrange(1, 4), "frame_period_us": rng.choice([0, 3000])})
    windows = [CONNECTED, GONE, camera_request(), request(16, struct.pack("<BBH", 1, 0, 144)), bytes(8), b"\x07"]
    command = b""
    for step in range(3000):
        now_us = step * 1000
        match rng.randrange(8):
            case 0:
                app.receive("SPI", rng.choice([*windows, CONNECTED, CONNECTED, rng.randbytes(6)]), now_us)
            case 1:
                app.receive("UART1", rng.choice([stamp(step, now_us), rng.randbytes(5)]), now_us)
            case 2 | 3:
                if command:
                    app.receive("CAMERA", rng.choice([bytes(2400)] * 4 + [b""]), now_us)
                command = b""
            case 4:
                command = app.transmit("CAMERA", now_us) or command
            case _:
                app.transmit("SPI", now_us)
        waiting = app.order_fill + (app.sending >= 0)
        assert app.frame == app.frames_sent + app.frames_unsent + waiting, f"seed {seed}, step {step}"
        used = sum(slot.state != lib.SLOT_FREE for slot in app.slots)
        assert used == waiting + (app.capturing >= 0), f"seed {seed}, step {step}"
        assert app.queue_fill <= 4
        assert app.pairs_fill <= 512
    assert app.frames_sent > 0


def test_a_body_is_looked_at_where_it_is() -> None:
    app = gap8()
    body = picture(2400)
    capture(app, body)
    assert seen(app.slots[0].body) == body
    assert app.slots[0].body.data == app.given[0].memory
