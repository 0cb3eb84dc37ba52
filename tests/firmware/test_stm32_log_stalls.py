"""Stalls of the card: how long one costs no rows, by what host.usd.budget says and by what the logger does, and that
every row of a longer one is counted."""

import itertools

import pytest
from log_rig import ROW_BYTES, SECOND, Rig, config, ended, flown, grid, last_status, logs
from memory_card import SYNC, WRITE, MemoryCard

from host.native import lib
from host.usd.budget import OPERATIONS, PROMPT_S, budget
from host.usd.config import Config, names_of_firmware, read_config

NAMES = names_of_firmware()
FLOATS = [name for name, letter in NAMES.variables.items() if letter == "f"]


def text_of(ring: int, hz: int, floats: int, events: str = "") -> bytes:
    variables = "".join(f"{name}\n" for name in FLOATS[:floats])
    return f"1\n{ring}\nlog\n1\non:fixedFrequency\n{hz}\n1\n{variables}{events}".encode()


def parsed(text: bytes) -> Config:
    made = read_config(text, NAMES)
    assert not made.errors
    return made


def dropped(text: bytes, operation: int, number: int, stall_us: int) -> int:
    """Rows, when the number-th such operation takes so long, and every other one 2 ms."""
    rig = Rig(MemoryCard(text))
    left = itertools.count(number, -1)

    def took_us() -> int:
        mine = rig.card.done[-1][0] == operation and next(left) == 0
        return stall_us if mine else round(PROMPT_S * 1e6)

    rig.operation_us = took_us
    rig.run(700_000 + stall_us)
    return int(rig.app.state.log.log.counters.dropped)


GYRO = "on:estGyroscope\ngyro.x\ngyro.y\ngyro.z\n"
CASES = [
    (16384, 1000, 20, ""),
    (4096, 500, 7, ""),
    (2048, 1000, 3, ""),
    (8192, 500, 12, GYRO),
    (8192, 100, 1, GYRO + "on:estAcceleration\nacc.x\n"),
]


@pytest.mark.parametrize(("ring", "hz", "floats", "events"), CASES)
def test_a_stall_as_long_as_reckoned_costs_nothing_and_a_longer_one_rows(
    ring: int, hz: int, floats: int, events: str
) -> None:
    text = text_of(ring, hz, floats, events)
    cost = budget(parsed(text), NAMES.rates_hz)
    assert cost.stall_ms > 10
    stall_us = int(cost.stall_ms * 1000)
    # What is reckoned with before a stall, and does not always come together.
    slack_us = int((512 + 42 + 3 * 154) / cost.bytes_per_s * 1e6 + OPERATIONS * PROMPT_S * 1e6 + 2e6 / hz)
    lost = {}
    for operation, number in ((WRITE, 1), (WRITE, 9), (WRITE, 10), (WRITE, 11), (SYNC, 1), (SYNC, 2)):
        assert dropped(text, operation, number, stall_us) == 0, f"operation {operation}, number {number}"
        lost[operation, number] = dropped(text, operation, number, stall_us + slack_us)
    assert max(lost.values()) > 0


@pytest.mark.parametrize(("hz", "floats"), [(1000, 20), (1000, 2), (250, 7)])
def test_the_least_ring_is_enough_for_a_prompt_card(hz: int, floats: int) -> None:
    least = max(budget(parsed(text_of(4096, hz, floats)), {}).ring_least, lib.USD_CONFIG_RING_MIN)
    assert dropped(text_of(least, hz, floats), SYNC, 0, 2000) == 0


@pytest.mark.parametrize(("hz", "floats"), [(500, 7), (100, 32), (250, 20), (1000, 1)])
def test_the_ring_that_everybody_has_becomes_one_that_works(hz: int, floats: int) -> None:
    """512 bytes do not hold a sector and a row: with them, all rows are dropped from the first sync on."""
    text = text_of(512, hz, floats)
    assert read_config(text, NAMES).ring_bytes == lib.USD_CONFIG_RING_MIN
    assert dropped(text, SYNC, 0, 2000) == 0


def test_the_ring_that_is_wanted_survives_half_a_second() -> None:
    wanted = budget(parsed(text_of(4096, 500, 7)), {}).ring_wanted
    for number in (5, 6, 7):
        assert dropped(text_of(wanted, 500, 7), WRITE, number, 500_000) == 0


def tolerance_us(ring: int, hz: int = 1000) -> int:
    """How long a card may stand still: rows fill what the ring has, but for what waits there already."""
    waiting = 512 + lib.USD_STATUS_BYTES + lib.USD_LOG_END_BYTES
    return (ring - waiting) // ROW_BYTES * SECOND // hz


@pytest.mark.parametrize("ring", [2048, 8192, 65535])
def test_a_stall_within_the_tolerance_loses_nothing_and_beyond_it_every_row_is_counted(ring: int) -> None:
    for factor, loses in ((0.95, False), (1.5, True)):
        rig = flown(1.0, config(ring))
        stall_us = round(tolerance_us(ring) * factor)
        rig.operation_us = lambda stall_us=stall_us: stall_us
        rig.run(rig.now_us + 20_000)
        rig.operation_us = lambda: 2000
        rig.run(rig.now_us + stall_us + SECOND)
        due = rig.now_us
        (log,) = logs(ended(rig))
        status = last_status(log)
        rows = log.rows["fixedFrequency"]
        assert log.is_whole
        assert (status["dropped"] > 0) == loses
        assert status["accepted"] == len(rows)
        assert status["requested"] == grid(rows.stamp_us[0], due)
        assert status["requested"] == status["accepted"] + status["dropped"]
        assert status["stall_us"] == stall_us
        assert rig.app.log.log.fill_max <= ring


def test_stalls_of_a_bad_card_all_the_time() -> None:
    rig = Rig(MemoryCard(config(65535)), seed=3)
    rig.operation_us = lambda: 2000 if rig.rng.random() < 0.99 else 400_000
    rig.run(20 * SECOND)
    (log,) = logs(ended(rig))
    assert log.is_whole
    assert last_status(log)["dropped"] == 0
    assert len(log.rows["fixedFrequency"]) > 19_900
