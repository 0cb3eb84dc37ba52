"""The echo on UART1: the STM32's answers, and what the GAP8 makes of them."""

import binascii
import struct
from typing import Any

import pytest
from board import App
from gap8_rig import ask_native, capture, frame_message, gap8, sent, stamp, stamps

from host.native import lib

WIRE_US = 1477.381
QUESTION_US = 434
ANSWER_BYTES = 17


def checked(start: str, body: bytes) -> bytes:
    return bytes.fromhex(start) + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def question(number: int) -> bytes:
    return checked("d52b", bytes([number]))


def answer(number: int, received_us: int, held_us: int = 0) -> bytes:
    return checked("d52c", struct.pack("<BQI", number, received_us, held_us))


def line(app: App, up_us: int, stamp_us: int | None = None, size: int = 17) -> bytes:
    """What the app puts on UART1 at this moment, byte by byte."""
    return b"".join(app.transmit("UART1", up_us, stamp_us) for _ in range(size))


# The STM32.


def test_the_literals_are_the_format() -> None:
    assert question(1) == bytes.fromhex("d5 2b 01 d1 f1")
    assert answer(1, 0x0807060504030201, 0x0C0B0A09)[:15] == bytes.fromhex("d52c 01 0102030405060708 090a0b0c")


def test_an_answer_leaves_at_once_between_stamps() -> None:
    app = App("stm32")
    assert len(line(app, 0)) == 17
    app.receive("UART1", question(7), 2_000, 5_002_000)
    assert line(app, 2_000, 5_002_000, 20) == answer(7, 5_002_000)
    assert (app.stamps_sent, app.stamps_late) == (1, 0)
    assert line(app, 10_000)[:2] == b"\xd5\x2a", "and stamps keep their grid"


def test_an_answer_waits_for_the_stamp_under_way_and_for_one_that_is_due() -> None:
    app = App("stm32")
    first = line(app, 0, 0, 4)
    app.receive("UART1", question(7), 400, 400)
    assert (first + line(app, 400, 400, 13))[:2] == b"\xd5\x2a"
    assert line(app, 1500, 1500) == answer(7, 400, 1100)
    app.receive("UART1", question(8), 10_000, 10_000)
    assert line(app, 10_000, 10_000)[:2] == b"\xd5\x2a"
    assert line(app, 11_500, 11_500) == answer(8, 10_000, 1500)
    assert app.stamps_sent == 2


def test_only_the_last_question_is_answered_once() -> None:
    app = App("stm32")
    line(app, 0)
    app.receive("UART1", b"noise \xd5" + question(1) + question(2)[:3] + question(3), 2_000)
    assert line(app, 2_000, size=50) == answer(3, 2_000)


@pytest.mark.parametrize("stamp_us", [1490, 1507, 1470])
def test_an_answer_says_how_long_its_clock_says_it_was_held(stamp_us: int) -> None:
    """As long as it runs as its uptime does, or counts 84 of 85."""
    app = App("stm32")
    line(app, 0)
    app.receive("UART1", question(7), 8_509, 700_000)
    assert line(app, 9_999, 700_000 + stamp_us) == answer(7, 700_000, stamp_us)


@pytest.mark.parametrize("stamp_us", [1517, 1460, 0, -300, 2**40])
def test_a_clock_set_since_the_question_leaves_it_without_an_answer(stamp_us: int) -> None:
    """Else a clock set on by less than the delays would make them seem so much smaller."""
    app = App("stm32")
    line(app, 0)
    app.receive("UART1", question(7), 8_509, 700_000)
    assert line(app, 9_999, 700_000 + stamp_us) == b""
    app.receive("UART1", question(8), 9_999, 800_000)
    assert line(app, 9_999, 800_000) == answer(8, 800_000), "the next one has one"


@pytest.mark.parametrize("bit", range(40))
def test_a_damaged_question_is_none(bit: int) -> None:
    app = App("stm32")
    line(app, 0)
    wire = bytearray(question(1))
    wire[bit // 8] ^= 1 << bit % 8
    app.receive("UART1", bytes(wire), 2_000)
    assert line(app, 2_000) == b""


@pytest.mark.parametrize("stamp_format", [1, 2, 3])
def test_other_dialects_do_not_answer(stamp_format: int) -> None:
    app = App("stm32", stamp_format=stamp_format)
    line(app, 0, size=76)
    app.receive("UART1", question(1), 5_000)
    assert line(app, 5_000) == b""


# The GAP8, when its clock tracker has had 150 stamps.

BEGIN_US = 1_500_000


def settled(period_us: int = 1_000_000, **config: Any) -> App:
    app = gap8(echo_period_us=period_us, **config)
    ask_native(app)
    app.receive("UART1", stamp(0, 0), 0, round(WIRE_US))
    assert line(app, 0) == question(1)
    stamps(app, 149, stm32_us=10_000, gap8_us=round(WIRE_US) + 10_000, first=1)
    return app


def echo(app: App, sum_us: float, held_us: int = 0, at_us: int = BEGIN_US, number: int | None = None) -> None:
    """Asks at `at_us` of uptime and stamp clock; the answer comes `sum_us` later than it could."""
    app.receive("UART1", stamp(at_us // 10_000, at_us - round(WIRE_US)), at_us, at_us)
    asked = line(app, at_us, at_us)
    assert asked == question(app.echo.number)
    back_us = at_us + round(QUESTION_US + WIRE_US + sum_us) + held_us
    number = app.echo.number if number is None else number
    app.receive("UART1", answer(number, 5, held_us), back_us, back_us)


def told(app: App, stamp_us: int = BEGIN_US + 20_000) -> tuple[int, int, int]:
    capture(app, bytes(2400), 0, stamp_us)
    header = frame_message(sent(app)[0])
    return header.minimum_delay_us, header.minimum_delay_error_us, header.echoes


def test_it_is_half_of_the_sum_with_an_error_of_the_other_half() -> None:
    app = settled()
    assert told(app) == (0, 0, 0), "the first answer has not come"
    echo(app, 1000)
    assert told(app) == (500, 504, 1)
    assert app.stamp_rx.answers == 1


def test_what_the_stm32_has_held_is_taken_off() -> None:
    app = settled()
    echo(app, 1000, held_us=1400)
    assert told(app) == (500, 504, 1)


def test_the_smallest_of_the_window_counts_and_is_forgotten_with_it() -> None:
    app = settled(10_000)
    for n, sum_us in enumerate([900, 300, 700, *[800] * 29]):
        echo(app, sum_us, at_us=BEGIN_US + n * 10_000)
    assert told(app, BEGIN_US + 319_000) == (150, 154, 32)
    for n in range(32, 64):
        echo(app, 600, at_us=BEGIN_US + n * 10_000)
    assert told(app, BEGIN_US + 639_000) == (150, 154, 64)
    echo(app, 600, at_us=BEGIN_US + 640_000)
    assert told(app, BEGIN_US + 649_000) == (300, 304, 33)


def test_it_is_forgotten_when_nobody_answers_any_more() -> None:
    app = settled(10_000)
    echo(app, 1000)
    echo(app, 900, at_us=BEGIN_US + 10_000)
    for n in range(2, 17):
        echo(app, 100, at_us=BEGIN_US + n * 10_000, number=1)
    assert told(app, BEGIN_US + 169_000) == (450, 454, 2), "15 answers to another question"
    echo(app, 100, at_us=BEGIN_US + 170_000, number=1)
    assert told(app, BEGIN_US + 175_000) == (0, 0, 0)
    echo(app, 1200, at_us=BEGIN_US + 180_000)
    assert told(app, BEGIN_US + 189_000) == (600, 604, 1)


def test_it_is_forgotten_with_its_epoch_and_without_stamps() -> None:
    app = settled()
    echo(app, 1000)
    at_us = BEGIN_US + 10_000
    app.receive("UART1", stamp(151, 0, epoch=1), at_us, at_us)
    assert told(app) == (0, 0, 0)
    app = settled()
    echo(app, 1000)
    assert told(app, BEGIN_US + 19_990_000)[2] == 1
    assert told(app, BEGIN_US + 20_010_000)[2] == 0


def test_answers_to_other_questions_and_second_ones_mean_nothing() -> None:
    app = settled()
    echo(app, 10, number=1)
    assert told(app)[2] == 0
    echo(app, 1000, at_us=BEGIN_US + 1_000_000)
    app.receive("UART1", answer(app.echo.number, 5), BEGIN_US, BEGIN_US)
    assert told(app, BEGIN_US + 1_020_000) == (500, 504, 1)
    assert app.stamp_rx.answers == 3


@pytest.mark.parametrize("sum_us", [-100, -1911, 2_000_000])
def test_what_cannot_be_is_left_out(sum_us: float) -> None:
    """One of the clocks was set meanwhile."""
    app = settled()
    echo(app, sum_us)
    assert told(app)[2] == 0
    echo(app, 0, at_us=BEGIN_US + 3_000_000)
    assert told(app, BEGIN_US + 3_020_000) == (0, 4, 1)


def test_a_hold_longer_than_the_round_trip_is_left_out() -> None:
    app = settled()
    app.receive("UART1", stamp(150, BEGIN_US), BEGIN_US, BEGIN_US)
    line(app, BEGIN_US, BEGIN_US)
    app.receive("UART1", answer(2, 5, 2**32 - 100), BEGIN_US + 2000, BEGIN_US + 2000)
    assert told(app)[2] == 0


def test_a_clock_of_32_bits_may_wrap_in_between() -> None:
    app = gap8(echo_period_us=1_000_000, stamp_bits=32)
    ask_native(app)
    begin_us = 2**32 - BEGIN_US - 1000
    stamps(app, 151, gap8_us=begin_us)
    line(app, 0)
    app.receive("UART1", stamp(151, BEGIN_US + 10_000), BEGIN_US, 2**32 - 1000)
    assert line(app, BEGIN_US, 2**32 - 1000) == question(2)
    app.receive("UART1", answer(2, 5), BEGIN_US, round(QUESTION_US + WIRE_US) + 100 - 1000)
    assert told(app, 9000) == (50, 54, 1)


def test_steps_of_the_clock_are_in_the_error() -> None:
    app = settled(stamp_tick_ns=30_518)
    echo(app, 1000)
    assert told(app) == (500, 535, 1)


def test_it_asks_once_a_period_and_only_behind_a_stamp() -> None:
    app = gap8(echo_period_us=1_000_000)
    assert line(app, 5_000_000) == b"", "an STM32 that sends no stamps is left alone"
    for n in range(401):
        app.receive("UART1", stamp(n, 10_000 * n), 10_000 * n)
        assert line(app, 10_000 * n) == (question(n // 100 + 1) if n % 100 == 0 else b"")


@pytest.mark.parametrize("firmware", [lib.GAP8_STOCK, lib.GAP8_PAPER, lib.GAP8_NANOCOCKPIT])
def test_other_dialects_say_nothing(firmware: int) -> None:
    app = gap8(echo_period_us=1, firmware=firmware)
    for n in range(3):
        app.receive("UART1", stamp(n, 10_000 * n), 10_000 * n)
        app.receive("UART1", answer(0, 5), 10_000 * n)
        assert line(app, 10_000 * n) == b""


def test_without_a_period_it_never_asks_and_a_board_takes_a_question_in_one_go() -> None:
    quiet = gap8()
    quiet.receive("UART1", stamp(0, 0), 0)
    assert line(quiet, 0) == b""
    app = gap8(echo_period_us=1)
    app.receive("UART1", stamp(0, 0), 0)
    assert app.transmit("UART1", 0, size=5) == question(1)
    assert app.transmit("UART1", 0, size=5) == b""


def test_answers_are_no_stamps() -> None:
    app = settled()
    echo(app, 100)
    capture(app, bytes(2400), 0, BEGIN_US + 20_000)
    header = frame_message(sent(app)[0])
    assert (header.stamps_received, header.stamps_bad, header.stamps_missed) == (151, 0, 0)
