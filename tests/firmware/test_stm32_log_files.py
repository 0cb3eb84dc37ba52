"""When the STM32 begins a log and when it ends it, under which name, and by which config.txt."""

import numpy as np
import pytest
from board import CRTP, HOST, STM32, SYSTEM, cpx, uart
from log_rig import SECOND, Rig, config, ended, flown, logs
from memory_card import CLOSE, CREATE, EXISTS, NO_CARD, OPEN, MemoryCard

from host.native import lib
from host.usd.decode import decode


def replies(rig: Rig, data: bytes) -> list[bytes]:
    rig.app.uart_packets(rig.now_us)
    rig.app.receive("UART2", uart(cpx(HOST, STM32, CRTP, data)), rig.now_us)
    return rig.app.uart_packets(rig.now_us)


def test_logging_begins_and_ends_by_its_parameter() -> None:
    rig = flown(1.0, config(startup=0))
    assert (rig.app.log.status, sorted(rig.card.files)) == (lib.LOG_OFF, ["config.txt"])
    answer = cpx(STM32, HOST, CRTP, b"\x23\0usd\0logging\0\x00", last=0)
    assert replies(rig, b"\x23\0usd\0logging\0\x08\x01") == [answer]
    rig.run(2 * SECOND)
    assert rig.app.log.status == lib.LOG_ON
    assert replies(rig, b"\x23\0usd\0logging\0\x08\x00") == [answer]
    rig.run(3 * SECOND)
    assert replies(rig, b"\x23\0usec\0reset\0\x08\x01") == [cpx(STM32, HOST, CRTP, b"\x23\0usec\0reset\0\x02", last=0)]
    assert replies(rig, b"\x23\0usd\0logging\0\x06\x01") == [
        cpx(STM32, HOST, CRTP, b"\x23\0usd\0logging\0\x16", last=0)
    ]
    rig.logging(True)
    rig.run(4 * SECOND)
    ended(rig)
    assert sorted(rig.card.files) == ["config.txt", "log00", "log01"]
    first, second = logs(rig)
    assert first.is_whole
    assert second.is_whole
    assert first.session != second.session
    assert 850 < len(first.rows["fixedFrequency"]) <= 1000


def test_the_log_is_closed_before_the_power_goes() -> None:
    rig = flown(1.0)
    rig.app.receive("UART2", uart(cpx(HOST, STM32, SYSTEM, b"\x30")), rig.now_us)
    rig.poll()
    rig.run(rig.now_us + 100_000)  # what the Crazyflie gives it
    assert logs(rig)[0].is_whole


def test_begin_end_and_begin_again_in_one_breath() -> None:
    rig = flown(1.0)
    for on in (False, True, False, True):
        rig.logging(on)
        rig.run(rig.now_us + 1000)
    rig.run(rig.now_us + SECOND)
    ended(rig)
    assert all(log.is_whole for log in logs(rig))
    assert len(logs(rig)) >= 2


def test_the_first_free_name_is_taken() -> None:
    card = MemoryCard(config())
    card.files |= {f"log{n:02}": bytearray(b"old") for n in range(100) if n != 42}
    rig = Rig(card)
    rig.run(2 * SECOND)
    ended(rig)
    assert decode(bytes(card.files["log42"])).is_whole
    assert sum(data == b"old" for data in card.files.values()) == 99
    rig.logging(True)
    rig.run(rig.now_us + SECOND)
    assert rig.app.log.status == lib.LOG_NO_NAME
    assert card.done[-1] == (CREATE, EXISTS)


@pytest.mark.parametrize(
    ("text", "status"),
    [(None, lib.LOG_NO_CONFIG), (b"2\n", lib.LOG_BAD_CONFIG), (b"", lib.LOG_BAD_CONFIG)],
)
def test_without_a_usable_config_nothing_is_written(text: bytes | None, status: int) -> None:
    rig = Rig(MemoryCard(text))
    rig.run(SECOND)
    assert rig.app.log.status == status
    assert {operation for operation, _ in rig.card.done} <= {OPEN, 3, CLOSE}


def test_without_a_card_the_robot_flies() -> None:
    card = MemoryCard(config())
    card.fails = lambda operation, argument: NO_CARD
    rig = Rig(card)
    rig.run(SECOND)
    assert (rig.app.log.status, len(card.done), rig.app.log.errors) == (lib.LOG_NO_CARD, 1, 0)
    card.fails = lambda operation, argument: None
    rig.logging(True)
    rig.run(2 * SECOND)
    assert rig.app.log.status == lib.LOG_ON


def test_a_long_config_with_findings_is_read_to_its_end() -> None:
    text = b"# comments\n" * 300 + config(hz=300, more=b"no.such\n" + b"#\n" * 500)
    rig = flown(1.0, text)
    assert (rig.app.log.config.errors, rig.app.log.config.warnings) == (1, 1)
    assert [(each.line, each.kind) for each in rig.app.log.config.findings[0:2]] == [
        (306, lib.USD_WARNING_ROUNDED),
        (314, lib.USD_ERROR_VARIABLE),
    ]
    assert set(np.diff(logs(ended(rig))[0].rows["fixedFrequency"].stamp_us).tolist()) == {3000}


def test_sessions_differ_from_boot_to_boot_and_from_robot_to_robot() -> None:
    sessions = set()
    for seed in range(5):
        for boot in range(5):
            rig = flown(0.2, log={"seed": seed, "boot": boot})
            sessions.add(rig.app.log.log.counters.session)
    assert len(sessions) == 25
    assert 0 not in sessions
