"""The STM32's messages about its log: to a host that has asked, once a second, and what is in them."""

import struct
import zlib

import pytest
from board import APP, CREDIT, ESP32, GAP8, HOST, STM32, WIFI_CTRL, cpx, uart
from log_rig import SECOND, Rig, config
from memory_card import MemoryCard

NATIVE, STOCK = b"\x4e\x10\x01\0\0\0", b"\x4e\x10\0\0\0\0"
FIELDS = ["state", "epoch", "stm32_us", "files", "session"]
FIELDS += ["requested", "accepted", "dropped", "stall_us", "syncs", "errors", "card_errors"]


def ask(rig: Rig, data: bytes = NATIVE, source: int = HOST) -> None:
    rig.app.receive("UART2", uart(cpx(source, STM32, APP, data)), rig.now_us)


def reports(rig: Rig) -> list[dict[str, int]]:
    """What the STM32 has to say at this instant: at most one."""
    found = []
    for packet in rig.app.uart_packets(rig.now_us):
        assert packet[:2] == cpx(STM32, HOST, APP, b"", last=0)[:2]
        data = packet[2:]
        magic, kind, *values, check = struct.unpack("<BBBBQ10I", data)
        assert (magic, kind, check) == (0x4E, 6, zlib.crc32(data[:-4]))
        found.append(dict(zip(FIELDS, values, strict=True)))
    return found


def heard(rig: Rig, seconds: int) -> list[int]:
    """Milliseconds at which there was a message."""
    times = []
    for _ in range(seconds * 10):
        rig.now_us += SECOND // 10
        rig.app.receive("UART2", CREDIT, rig.now_us)
        times += [rig.now_us // 1000] * len(reports(rig))
    return times


def rig_without_log() -> Rig:
    rig = Rig(MemoryCard(None))
    rig.now_us = 500_000
    rig.app.uart_packets(rig.now_us)
    return rig


def test_nobody_gets_what_he_has_not_asked_for() -> None:
    assert heard(rig_without_log(), 5) == []


def test_at_once_and_every_second_until_the_host_says_stock() -> None:
    rig = rig_without_log()
    ask(rig)
    assert len(reports(rig)) == 1
    assert heard(rig, 3) == [1500, 2500, 3500]
    ask(rig, STOCK)
    assert heard(rig, 3) == []


def test_not_to_the_next_host() -> None:
    rig = rig_without_log()
    ask(rig)
    assert len(reports(rig)) == 1
    rig.app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x32\0")), rig.now_us)
    rig.app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x32\x01")), rig.now_us)
    assert heard(rig, 3) == []


@pytest.mark.parametrize("source", [GAP8, ESP32])
def test_only_a_host_can_ask(source: int) -> None:
    rig = rig_without_log()
    ask(rig, source=source)
    assert heard(rig, 2) == []
    assert rig.app.packets_unknown == 1


@pytest.mark.parametrize("data", [b"\x4e", b"\x4e\x10\x01", b"\x4e\x10\x02\0\0\0", b"\x4e\x11" + bytes(12), b"hello"])
def test_what_is_no_request_is_counted(data: bytes) -> None:
    rig = rig_without_log()
    ask(rig, data)
    assert heard(rig, 2) == []
    assert rig.app.packets_unknown == 1


def test_when_uart2_stands_still_messages_are_dropped() -> None:
    rig = rig_without_log()
    ask(rig)
    for _ in range(20):
        rig.now_us += SECOND
        rig.poll()
    assert rig.app.packets_dropped > 5
    rig.app.receive("UART2", CREDIT, rig.now_us)
    assert len(rig.app.uart_packets(rig.now_us)) >= 1


def test_counters_are_those_of_the_log_under_way() -> None:
    rig = Rig(MemoryCard(config(ring=4096)))
    rig.run(SECOND)
    rig.operation_us = lambda: 300_000
    rig.run(2 * SECOND)
    ask(rig)
    (said,) = reports(rig)
    counters = rig.app.log.log.counters
    assert said == {
        "state": 2,
        "epoch": 0,
        "stm32_us": 2 * SECOND,
        "files": 1,
        "session": counters.session,
        **{name: getattr(counters, name) for name in FIELDS[5:-1]},
        "card_errors": 0,
    }
    assert said["requested"] == said["accepted"] + said["dropped"]
    assert said["dropped"] > 100
    assert said["stall_us"] == 300_000
