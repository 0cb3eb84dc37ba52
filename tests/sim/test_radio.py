"""Beacons from a simulated host to the logs of simulated robots, and what `host sync robots` makes of these."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "firmware"))

from memory_card import Store

from host.cli import main
from host.native import ffi, lib
from sim.radio import BEACON, BEACON_HEAD, Air, Radio
from sim.world import World

CONFIG = b"1\n8192\nlog\n1\non:fixedFrequency\n20\n1\npm.vbatMV\non:beacon\n"
SHUTDOWN = bytes.fromhex("ff 03 59 01 30 94")
KEYS = {"robots": 3, "stm32_ppm": [120.0, -80.0, 33.0], "camera_fps": 0, "seed": 5}


def fly(seconds: float, air: Air, hz: float = 2.0, **keys: object) -> tuple[World, list[Store], list[tuple[int, int]]]:
    """Boot, a second, beacons, shutdown; (true time, stamp clock of each robot) when the last beacon had gone."""
    world = World("swarm", **{**KEYS, **keys})
    stores = [Store(CONFIG) for _ in world.robots]
    for robot, store in zip(world.robots, stores, strict=True):
        robot.set_storage(store)
    world.run(1.0)
    Radio(world, air).beacons(seconds, hz)
    truth = [(world.now_ns, robot.stamp_us("stm32")) for robot in world.robots]
    for robot in world.robots:
        robot.inject("uart2_to_stm32", SHUTDOWN)
    world.run(1.0)
    return world, stores, truth


def saved(folder: Path, stores: list[Store]) -> list[str]:
    paths = [folder / f"cf{number}" for number in range(len(stores))]
    for path, store in zip(paths, stores, strict=True):
        path.write_bytes(bytes(store.files["log00"]))
    return [str(path) for path in paths]


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, object]]:
    assert main(["sync", "robots", *arguments, "--json"]) == 0
    return [json.loads(each) for each in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("divider", [84, 85])
def test_from_the_air_to_the_table(divider: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world, stores, truth = fly(200.0, Air(loss=0.2), stm32_divider=divider)
    assert all(robot.stm32["crtp_ignored"] == 0 for robot in world.robots)
    records = said(capsys, *saved(tmp_path, stores))
    robots = [each for each in records if each["event"] == "robot"]
    rate = divider / 85
    for robot, ppm in zip(robots, (120.0, -80.0, 33.0), strict=True):
        assert abs(robot["drift_ppm"] - (rate * (1 + ppm * 1e-6) - 1) * 1e6) < 1
        assert robot["counts_84_of_85"] is (divider == 84)
        assert 40 < robot["lost"] < 120
        # The floor of 250 us is nobody's to see.
        assert robot["host_bound_us"] < 100
    for pair in (each for each in records if each["event"] == "pair"):
        a, b = (int(str(pair[name])[2:]) for name in ("first", "second"))
        (_, here), (_, there) = truth[a], truth[b]
        now = pair["offset_us"] + pair["slope_ppm"] * 1e-6 * (here - pair["at_us"])
        assert abs(now - (there - here)) <= pair["worst_us"] + 1
        assert pair["worst_us"] < 200
    assert main(["sync", "robots", *saved(tmp_path, stores)]) == 0
    table = capsys.readouterr().out
    assert ("it counts 84 where 85 have passed" in table) == (divider == 84)
    assert "cf2 against cf1" in table


def test_too_few_and_other_runs_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, stores, _ = fly(15.0, Air())
    assert main(["sync", "robots", *saved(tmp_path, stores)]) == 4
    assert "cf0: 30 beacons of one run of the host; at least 50" in capsys.readouterr().err
    _, stores, _ = fly(30.0, Air())
    first = saved(tmp_path, stores)[0]
    world = World("swarm", **KEYS)
    store = Store(CONFIG)
    world.robots[0].set_storage(store)
    world.run(1.0)
    Radio(world, host_start_us=1 << 40).beacons(30.0, 2.0)
    world.robots[0].inject("uart2_to_stm32", SHUTDOWN)
    world.run(1.0)
    other = tmp_path / "other"
    other.write_bytes(bytes(store.files["log00"]))
    assert main(["sync", "robots", first, str(other)]) == 4
    assert "cf0 and other: not one beacon in common" in capsys.readouterr().err


def test_a_run_with_a_radio_is_repeated_from_its_log() -> None:
    world, stores, _ = fly(5.0, Air(loss=0.3))
    replayed = World.replay(json.loads(json.dumps(world.log)))
    assert [robot.stm32 for robot in replayed.robots] == [robot.stm32 for robot in world.robots]
    assert replayed.now_ns == world.now_ns
    assert {each["do"] for each in world.log} >= {"radio"}
    assert len(stores) == 3


def test_the_packet_is_the_firmwares() -> None:
    out = ffi.new("uint8_t[14]")
    lib.beacon_encode(ffi.new("beacon_t *", (0x04030201, 0x0C0B0A0908070605)), out)
    assert bytes(out) == BEACON.pack(*BEACON_HEAD, 0x04030201, 0x0C0B0A0908070605)
    assert bytes(out) == bytes.fromhex("d2 62 01 02 03 04 05 06 07 08 09 0a 0b 0c")
