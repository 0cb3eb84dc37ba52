"""The STM32's log in a simulated world: a store as its card, clocks that drift, power that goes."""

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "firmware"))

from memory_card import MS, Store

from host.usd.decode import decode
from host.usd.log import Log
from sim.world import World

CONFIG = (
    b"1\n16384\nlog\n1\non:fixedFrequency\n1000\n1\nstateEstimate.x\nstateEstimate.vx\nacc.z\npm.vbatMV\n"
    b"on:estGyroscope\ngyro.z\n"
)
SHUTDOWN = bytes.fromhex("ff 03 59 01 30 94")


def flown(seconds: float, store: Store | None = None, name: str = "hover", **keys: Any) -> tuple[World, Store]:
    store = store or Store(CONFIG)
    world = World(name, **keys)
    world.robots[0].set_storage(store)
    world.run(seconds)
    return world, store


def log_of(store: Store, number: int = 0) -> Log:
    return decode(bytes(store.files[f"log{number:02}"]))


def shut_down(world: World, seconds: float = 1.0) -> None:
    world.robots[0].inject("uart2_to_stm32", SHUTDOWN)
    world.run(seconds)


def test_a_log_from_boot_to_shutdown() -> None:
    world, store = flown(2.0)
    assert world.robots[0].log["status"] == "on"
    shut_down(world)
    log = log_of(store)
    assert log.is_whole
    counts = world.robots[0].log
    assert (counts["status"], counts["dropped"], counts["errors"]) == ("off", 0, 0)
    assert counts["requested"] == len(log.rows["fixedFrequency"]) + len(log.rows["estGyroscope"])
    assert set(np.diff(log.rows["fixedFrequency"].stamp_us).tolist()) == {1000}


def test_stamps_are_the_stamp_clock_and_the_grid_is_the_uptime() -> None:
    world, store = flown(2.0, stm32_ppm=300, stm32_divider=84, stm32_stamp_start_us=5_000_000)
    shut_down(world)
    steps = np.diff(log_of(store).rows["fixedFrequency"].stamp_us)
    assert steps.mean() == pytest.approx(1000 * 84 / 85, abs=0.01)
    assert log_of(store).rows["fixedFrequency"].stamp_us[0] > 5_000_000
    asked_ns = [true_ns for true_ns, _ in store.requests]
    assert asked_ns == sorted(asked_ns)


def test_a_reset_of_the_stamp_clock_is_an_epoch_and_loses_no_row() -> None:
    world, store = flown(1.0)
    world.robots[0].reset_stamp_clock("stm32", 0)
    world.run(1.0)
    shut_down(world)
    log = log_of(store)
    assert log.is_whole
    assert len(log.epochs) == 2
    assert 1980 < len(log.rows["fixedFrequency"]) < 2000


def test_power_that_goes_is_told_to_the_card_and_the_next_boot_has_another_file() -> None:
    world, store = flown(1.0)
    world.robots[0].reboot("stm32", off_seconds=0.5)
    assert store.cuts == [1_000_000_000]
    before = len(store.requests)
    world.run(0.4)
    assert len(store.requests) == before
    world.run(1.1)
    shut_down(world)
    first, second = log_of(store, 0), log_of(store, 1)
    assert first.crc != "good"
    assert first.verified_count > 1400
    assert second.is_whole
    assert first.session != second.session


def test_a_robot_without_a_card_says_so_and_flies() -> None:
    world = World("hover")
    world.run(1.0)
    assert world.robots[0].log["status"] == "no_card"
    assert world.robots[0].stm32["stamps_sent"] > 90


def test_stamps_on_uart1_do_not_wait_for_the_card() -> None:
    world, _ = flown(3.0, Store(CONFIG, stall_ms=400), name="hover")
    alone = World("hover")
    alone.run(3.0)
    assert world.robots[0].stm32["stamps_sent"] == alone.robots[0].stm32["stamps_sent"]
    assert world.robots[0].stm32["stamps_late"] == 0


def test_the_same_seed_gives_the_same_file_and_the_log_repeats_it() -> None:
    files = []
    for seed in (3, 3, 4):
        world, store = flown(1.0, seed=seed, stm32_walk_ppb=1000)
        shut_down(world)
        files.append(bytes(store.files["log00"]))
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_a_store_that_raises_ends_the_run_with_its_error() -> None:
    class Broken(Store):
        def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
            if true_ns > 500 * MS:
                raise RuntimeError("of the store")
            return super().request(request, true_ns)

    with pytest.raises(RuntimeError, match="of the store"):
        flown(1.0, Broken(CONFIG))


@pytest.mark.parametrize("answer", [b"", b"\x02", b"\x02\0\0\0\0" * 500, b"\xff" * 517])
def test_a_store_may_answer_anything(answer: bytes) -> None:
    class Odd(Store):
        def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
            return answer[:517], -5

    world, _ = flown(0.5, Odd(CONFIG))
    assert world.robots[0].log["status"] != "on"
