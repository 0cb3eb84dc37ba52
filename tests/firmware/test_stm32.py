"""The STM32's app: stamps to the byte and to the microsecond, and its end of UART2."""

import binascii
import random
import struct
from typing import Any

import pytest
from board import (
    APP,
    CONSOLE,
    CREDIT,
    CRTP,
    ESP32,
    GAP8,
    HOST,
    NEVER_US,
    STM32,
    SYSTEM,
    TEST,
    WIFI_CTRL,
    App,
    cpx,
    uart,
)
from c_memory import POISONS

STAMPS_OFF = 2**32 - 1
BYTE_US = 87


def stamp(sequence: int, stm32_us: int, epoch: int = 0) -> bytes:
    body = struct.pack("<IQB", sequence, stm32_us, epoch)
    return b"\xd5\x2a" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def next_stamp(app: App, up_us: int, stamp_us: int) -> bytes:
    """One whole message; the clock goes on while it leaves."""
    return b"".join(app.transmit("UART1", up_us + n * BYTE_US, stamp_us + n * BYTE_US) for n in range(17))


@pytest.mark.parametrize("poison", POISONS)
def test_a_stamp_has_the_time_at_which_its_first_byte_leaves(poison: int) -> None:
    app = App("stm32", poison)
    literal = bytes.fromhex("d52a 00000000 4e61bc0000000000 00 d66e")
    assert next_stamp(app, 0, 12345678) == literal == stamp(0, 12345678)
    assert app.transmit("UART1", 17 * BYTE_US) == b""
    assert app.deadline() <= 10_000
    assert app.stamps_sent == 1


def test_stamps_keep_their_grid_whatever_the_moment_of_the_call() -> None:
    app = App("stm32")
    next_stamp(app, 3, 3)
    assert app.transmit("UART1", 9_999) == b""
    assert next_stamp(app, 10_004, 10_004) == stamp(1, 10_004)
    assert app.transmit("UART1", 19_999) == b""
    assert next_stamp(app, 20_000, 20_000) == stamp(2, 20_000)
    assert app.stamps_late == 0


def test_periods_that_passed_are_counted_and_not_made_up_for() -> None:
    app = App("stm32")
    next_stamp(app, 0, 0)
    assert next_stamp(app, 45_000, 45_000) == stamp(1, 45_000)  # due at 10, 20, 30 and 40 ms
    assert app.stamps_late == 3
    assert app.transmit("UART1", 49_999) == b""
    assert next_stamp(app, 50_000, 50_000) == stamp(2, 50_000)


@pytest.mark.parametrize("bits", [32, 48])
def test_a_stamp_clock_of_few_bits_that_wraps_starts_none(bits: int) -> None:
    app = App("stm32")
    next_stamp(app, 0, 2**bits - 9_000)
    assert next_stamp(app, 10_000, 882) == stamp(1, 882), "84/85, and back by all of its range"
    assert next_stamp(app, 20_000, 2**bits - 40_000) == stamp(2, 2**bits - 40_000)
    assert next_stamp(app, 30_000, 5) == stamp(3, 5, 1), "40 ms in 10 is no wrap"


def test_a_stamp_clock_that_goes_backwards_starts_an_epoch_and_moves_no_deadline() -> None:
    app = App("stm32")
    assert next_stamp(app, 0, 1_000_000) == stamp(0, 1_000_000, 0)
    assert next_stamp(app, 10_000, 7) == stamp(1, 7, 1)
    assert next_stamp(app, 20_000, 7) == stamp(2, 7, 1)  # stands still: the same epoch
    assert next_stamp(app, 30_000, 6) == stamp(3, 6, 2)
    assert app.stamps_late == 0


def test_stamps_can_be_slower_or_off() -> None:
    slow = App("stm32", stamp_period_us=250_000)
    next_stamp(slow, 0, 0)
    assert slow.transmit("UART1", 249_999) == b""
    assert slow.transmit("UART1", 250_000) == b"\xd5"
    off = App("stm32", stamp_period_us=STAMPS_OFF)
    assert off.transmit("UART1", 10**12) == b""


@pytest.mark.parametrize(
    "config",
    [{"wifi_mode": 3}, {"wifi_ssid": b"s" * 32}, {"wifi_key": b"k" * 64}],
    ids=lambda config: next(iter(config)),
)
def test_a_configuration_that_cannot_be_used_is_refused(config: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="-5"):
        App("stm32", **config)


def quiet(**config: Any) -> App:
    """Without stamps, past the first credit."""
    app = App("stm32", stamp_period_us=STAMPS_OFF, **config)
    assert app.uart_bytes("UART2", 0) == CREDIT
    return app


WIFI: dict[str, Any] = {"wifi_mode": 1, "wifi_ssid": b"abc", "wifi_key": b"12345678"}
CONNECT_AS_AP = bytes.fromhex("ff 04 0a 04 20 01 d4")
CLIENT_CONNECTED = bytes.fromhex("ff 04 51 04 32 01 9d")


def test_wifi_is_set_up_at_boot_and_again_until_a_client_is_heard_of() -> None:
    app = quiet(**WIFI)
    commands = [cpx(STM32, ESP32, WIFI_CTRL, data, last=0) for data in (b"\x10abc", b"\x1112345678", b"\x20\x01")]
    assert app.uart_packets(0) == commands
    assert uart(commands[2]) == CONNECT_AS_AP
    assert app.uart_packets(1_999_999) == []
    assert app.uart_packets(2_000_000) == commands
    app.receive("UART2", CLIENT_CONNECTED, 3_000_000)
    assert app.client
    assert app.uart_packets(9_000_000) == []
    app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x32\x00")), 9_000_000)
    assert not app.client
    assert app.uart_packets(9_000_000) == commands, "it may be the ESP32 that has restarted, and knows no settings"
    assert app.uart_packets(10_999_999) == []
    assert app.uart_packets(11_000_000) == commands


def test_a_station_without_a_key_sends_none() -> None:
    app = quiet(wifi_mode=2, wifi_ssid=b"s" * 31)
    assert [packet[2:] for packet in app.uart_packets(0)] == [b"\x10" + b"s" * 31, b"\x20\x00"]


def test_commands_do_not_pile_up_while_the_esp32_is_silent() -> None:
    app = App("stm32", stamp_period_us=STAMPS_OFF, **WIFI)
    for up_us in range(0, 60_000_000, 100_000):
        assert set(app.uart_bytes("UART2", up_us)) <= set(CREDIT)
    assert app.packets_dropped == 0
    assert len(app.uart_packets(60_000_000)) == 3


@pytest.mark.parametrize("source", [ESP32, HOST, GAP8])
def test_echo_answers_whoever_asked_and_sink_nobody(source: int) -> None:
    app = quiet()
    app.receive("UART2", uart(cpx(source, STM32, TEST, b"\x01" + b"e" * 97)), 0)
    app.receive("UART2", uart(cpx(source, STM32, TEST, b"\x00sink")), 0)
    assert app.uart_packets(0) == [cpx(STM32, source, TEST, b"\x01" + b"e" * 97, last=0)]
    assert app.packets_unknown == 0


UNKNOWN = [
    cpx(HOST, GAP8, TEST, b"\x01"),
    cpx(HOST, STM32, TEST, b"\x02"),
    cpx(HOST, STM32, APP, b"?"),
    cpx(HOST, STM32, 63, b"?"),
    cpx(HOST, STM32, SYSTEM, b"\x21"),
    cpx(HOST, STM32, SYSTEM, b"\x22\x01"),
    cpx(ESP32, STM32, WIFI_CTRL, b"\x32"),
    cpx(ESP32, STM32, WIFI_CTRL, b"\x31\x01\x02\x03"),
    cpx(0, STM32, TEST, b"\x01"),
    cpx(HOST, STM32, TEST, b""),
]


@pytest.mark.parametrize("packet", UNKNOWN, ids=bytes.hex)
def test_what_means_nothing_is_counted_and_changes_nothing(packet: bytes) -> None:
    app = quiet()
    app.receive("UART2", uart(packet), 0)
    assert app.packets_unknown == 1
    assert app.uart_packets(0) == []


def test_known_packets_without_an_answer() -> None:
    app = quiet()
    app.receive("UART2", uart(cpx(HOST, STM32, CRTP, b"\xff\x01")), 0)
    app.receive("UART2", uart(cpx(ESP32, STM32, CONSOLE, b"hello\0")), 0)
    app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x31\xc0\xa8\x04\x01")), 0)
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x20\x01")), 0)
    assert app.client
    assert (app.crtp_ignored, app.packets_unknown) == (1, 0)
    assert app.uart_packets(0) == []


def test_crtp_goes_to_the_host_while_the_bridge_is_on() -> None:
    app = quiet(crtp_period_us=100_000)
    assert app.uart_packets(500_000) == []
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x21\x01")), 500_000)
    texts = [packet for up_us in range(500_000, 1_600_000, 100_000) for packet in app.uart_packets(up_us)]
    assert texts == [cpx(STM32, HOST, CRTP, b"\0crtp %d\n" % n, last=0) for n in range(11)]
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x21\x00")), 1_600_000)
    assert app.uart_packets(9_000_000) == []


def test_the_bridge_ends_with_its_client() -> None:
    app = quiet(crtp_period_us=1000)
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x21\x01")), 0)
    app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x32\x00")), 0)
    assert not app.bridge
    assert app.uart_packets(1_000_000) == []


def test_the_queue_is_bounded_and_says_what_it_lost() -> None:
    app = quiet()
    for n in range(30):
        app.receive("UART2", uart(cpx(HOST, STM32, TEST, bytes([1, n]))), 0)
    answers = app.uart_packets(0)
    assert [packet[3] for packet in answers] == list(range(8))
    assert app.packets_dropped == 30 - 8


def test_one_stamp_more_or_less_never_waits_for_uart2() -> None:
    """Both UARTs as a board runs them, UART2 always busy: every stamp leaves on its grid."""
    app = App("stm32")
    rng = random.Random(1)
    now_us, free_us, starts = 0, {"UART1": 0, "UART2": 0}, []
    while now_us < 300_000:
        for port, byte_us in (("UART1", BYTE_US), ("UART2", 17)):
            if free_us[port] <= now_us:
                first = app.stamp_sent == app.stamp_size
                if app.transmit(port, now_us):
                    starts += [now_us] if port == "UART1" and first else []
                    free_us[port] = now_us + byte_us
        deadline = app.deadline()
        waits = [free for free in free_us.values() if free > now_us]
        waits += [deadline] if deadline > now_us else []
        assert waits, "nothing will ever happen again"
        now_us = min(waits)
        if rng.random() < 0.01:
            app.receive("UART2", uart(cpx(HOST, STM32, TEST, b"\x01" + bytes(90))) + CREDIT, now_us)
    assert len(starts) == 30
    assert all(start - 10_000 * n < 2 * 17 for n, start in enumerate(starts))
    assert app.stamps_late == 0


@pytest.mark.parametrize("seed", range(20))
def test_any_bytes_on_uart2_leave_a_working_app(seed: int) -> None:
    app = App("stm32", crtp_period_us=5000, **WIFI)
    rng = random.Random(seed)
    for step in range(300):
        noise = rng.choice([rng.randbytes(rng.randrange(8)), CREDIT, uart(rng.choice(UNKNOWN)), CLIENT_CONNECTED])
        app.receive("UART2", noise, step * 1000)
        app.uart_bytes("UART2", step * 1000, most=20)
        assert app.queue_fill <= 8
    later = 10_000_000
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x21\x00")), later)
    app.uart_packets(later)
    app.receive("UART2", uart(cpx(HOST, STM32, TEST, b"\x01alive")), later)
    assert cpx(STM32, HOST, TEST, b"\x01alive", last=0) in app.uart_packets(later), f"seed {seed}"


def test_nothing_configured_waits_for_nothing_but_credits() -> None:
    app = quiet()
    assert app.deadline() == 100_000
    assert app.deadline() < NEVER_US


def test_what_a_timer_queues_while_uart1_is_served_does_not_wait() -> None:
    app = quiet(crtp_period_us=5000)
    app.receive("UART2", CREDIT, 0)
    app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x21\x01")), 0)
    app.uart_packets(0)
    app.transmit("UART1", 5000)
    assert app.deadline() <= 5000
    assert app.uart_packets(5000) == [cpx(STM32, HOST, CRTP, b"\0crtp 1\n", last=0)]
