"""The STM32's logger on cards that are full, broken, slow or gone: a log says what it lacks, and the rest is right."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "firmware"))

from board import CRTP, HOST, STM32, cpx, uart
from card_flights import CONFIG, FAST_CONFIG, FLOATS

from host.protocol.errors import LocalError
from host.usd.budget import budget
from host.usd.config import names_of_firmware, read_config
from host.usd.decode import decode
from host.usd.log import Log
from sim.card import WRITE, Card
from sim.world import World

MS, SECOND = 1_000_000, 1_000_000_000
KILOHERTZ = CONFIG.replace("\n250\n", "\n1000\n").replace("on:estPose\n", "")


def flown(card: Card, seconds: float, config: str = KILOHERTZ, **keys: Any) -> World:
    card.put("config.txt", config.encode())
    world = World("hover", camera_fps=0, **keys)
    world.robots[0].set_storage(card)
    world.run(seconds)
    return world


def logging(world: World, on: bool) -> dict[str, int | str]:
    """As the host switches it over the radio."""
    packet = cpx(HOST, STM32, CRTP, b"\x23\0usd\0logging\0\x08" + bytes([on]))
    world.robots[0].inject("uart2_to_stm32", uart(packet))
    world.run(2.5)
    return world.robots[0].log


def logs_on(card: Card) -> list[Log]:
    found = []
    for number in range(100):
        try:
            found.append(decode(card.get(f"log{number:02}")))
        except LocalError:
            return found
    return found


def counters(log: Log) -> dict[str, int]:
    """Of the last status row."""
    rows = log.rows["log.status"].data
    return {name: int(rows[name][-1]) for name in rows.dtype.names or ()}


def accounted(log: Log) -> int:
    """Every row that was due is in the file or counted as dropped. Returns how many were dropped."""
    last = counters(log)
    there = log.row_count - len(log.rows["log.status"])
    assert (last["requested"], last["accepted"]) == (there + last["dropped"], there)
    return last["dropped"]


def without_a_gap(logs: list[Log], period_us: int = 1000) -> int:
    """Rows of the fixed frequency come once, on their grid, and as many as are not there are counted. Returns them."""
    stamps = np.concatenate([log.rows["fixedFrequency"].stamp_us for log in logs]).astype(np.int64)
    steps = np.diff(stamps)
    assert (steps > 0).all(), "no row twice"
    assert not (steps % period_us).any()
    missing = int((steps // period_us - 1).sum())
    dropped = sum(accounted(log) for log in logs)
    events = {name for log in logs for name in log.rows} - {"fixedFrequency", "log.status"}
    assert missing <= dropped if events else missing == dropped
    return missing


@pytest.mark.parametrize("filler", [0, 5_000, 200_001, 1 << 20])
def test_full_in_the_middle_of_a_row(filler: int) -> None:
    """Whatever is left of the card: the file ends with a whole row, its status and its CRC, and uses all there is."""
    card = Card(128, free_mb=1)
    card.put("config.txt", FAST_CONFIG.encode())
    cluster = card.layout.cluster_sectors * 512
    card.put("filler", bytes(min(filler, (1 << 20) - 3 * cluster)))
    world = flown(card, 10.0 if filler < 100_000 else 8.5, FAST_CONFIG)
    state = world.robots[0].log
    assert state["status"] == "full"
    (log,) = logs_on(card)
    assert log.is_whole
    assert accounted(log) == state["dropped"] > 0
    assert counters(log)["errors"] == state["errors"] == 1, "that there is no room is an error"
    free = (1 << 20) - sum(-(-len(card.get(name)) // cluster) * cluster for name in ("config.txt", "filler", "log00"))
    assert free < 4096 + cluster


def test_slow_all_the_time() -> None:
    card = Card(128, seed=3, stall_ms=60, stall_p99_ms=450)
    world = flown(card, 4.0, FAST_CONFIG)
    state = logging(world, False)
    assert state["status"] == "off"
    (log,) = logs_on(card)
    assert log.is_whole
    assert accounted(log) == state["dropped"] > 0
    assert counters(log)["stall_us"] == state["stall_us"] > 200_000
    assert without_a_gap([log]) > 0


class Stalling(Card):
    """Prompt, but for one write that takes so long."""

    def __init__(self, number: int, stall_ms: float) -> None:
        super().__init__(128, stall_ms=0)
        self.left = number
        self.stall_ms = stall_ms

    def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
        answer, duration_ns = super().request(request, true_ns)
        self.left -= request[0] == WRITE
        stalls = request[0] == WRITE and self.left == 0
        return answer, duration_ns + round(self.stall_ms * MS) * stalls


@pytest.mark.parametrize("number", [40, 41, 43])
def test_a_stall_as_long_as_config_check_says_costs_nothing_and_a_longer_one_is_counted(number: int) -> None:
    """1 kHz, 20 floats, and events."""
    names = names_of_firmware()
    config = read_config(FAST_CONFIG.encode(), names)
    assert len(FLOATS) == 20
    tolerance_ms = budget(config, names.rates_hz).stall_ms
    assert tolerance_ms > 400
    for factor, loses in ((1.0, False), (1.2, True)):
        card = Stalling(number, tolerance_ms * factor)
        state = logging(flown(card, 2.5, FAST_CONFIG), False)
        (log,) = logs_on(card)
        assert log.is_whole
        assert (accounted(log) > 0) == loses
        assert state["dropped"] == counters(log)["dropped"]
        assert (without_a_gap([log]) > 0) == loses
        assert counters(log)["stall_us"] >= tolerance_ms * factor * 1000


@pytest.mark.parametrize("seed", [20, 21])
def test_bad_sectors(seed: int) -> None:
    """A file ends before a sector that cannot be written, and the log goes on in the next one."""
    card = Card(128, bad=0.002, seed=seed)
    state = logging(flown(card, 12.0), False)
    assert state["status"] == "off"
    found = logs_on(card)
    assert len(found) == state["files"] > 1
    assert all(log.is_whole for log in found)
    assert sum(counters(log)["errors"] for log in found) >= len(found) - 1
    assert without_a_gap(found) > 0, "and every row that is missing is counted"


def test_a_sector_that_cannot_be_written_for_a_while() -> None:
    """What is tried again and then done costs nothing but a count."""
    card = Card(128)
    world = flown(card, 1.5)
    card.sectors.bad_sectors = set(range(card.layout.data, card.layout.sectors))
    while not world.robots[0].log["errors"]:
        world.run(0.001)
    card.sectors.bad_sectors = set()
    state = logging(world, False)
    (log,) = logs_on(card)
    assert log.is_whole
    assert counters(log)["errors"] == state["errors"] > 0
    assert accounted(log) == without_a_gap([log]) == 0


def test_removed_in_flight_and_put_back() -> None:
    card = Card(128, removed_ns=3 * SECOND)
    world = flown(card, 4.0)
    state = world.robots[0].log
    assert state["status"] == "no_card"
    assert state["errors"] > 0
    assert world.robots[0].stm32["stamps_sent"] > 350, "it flies on"
    card.removed_ns = None
    world.run(1.0)
    assert world.robots[0].log["status"] == "no_card", "until it is told to log"
    assert logging(world, True)["status"] == "on"
    assert logging(world, False)["status"] == "off"
    first, second = logs_on(card)
    rows = first.rows["fixedFrequency"]
    last_us = int(rows.stamp_us[rows.is_verified][-1])
    assert 2_500_000 < last_us < 3_000_000, "up to the last sync"
    assert counters(first)["dropped"] == 0
    assert second.is_whole
    assert accounted(second) == 0
    assert first.session != second.session
    assert without_a_gap([second]) == 0


@pytest.mark.parametrize("off_ms", [1003, 1111, 1250, 1251])
def test_the_robots_power_goes_in_the_middle_of_an_operation(off_ms: int) -> None:
    """The next boot logs in the next file."""
    card = Card(128, seed=off_ms)
    world = flown(card, off_ms / 1000)
    world.robots[0].reboot("stm32", off_seconds=0.1)
    world.run(1.0)
    assert logging(world, False)["status"] == "off"
    first, second = logs_on(card)
    assert second.is_whole
    rows = first.rows["fixedFrequency"]
    verified_us = int(rows.stamp_us[rows.is_verified][-1])
    assert off_ms * 1000 - verified_us < 250_000 + 500_000, "a sync interval, and the longest stall"
    assert first.session != second.session
