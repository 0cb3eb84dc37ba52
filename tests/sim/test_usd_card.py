"""Logs on the virtual card: the whole way from a scenario's keys to a file in the image of a card."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from host.link.ports import open_port
from host.protocol.errors import LocalError
from host.usd.cardimage import CardImage
from host.usd.decode import decode
from host.usd.log import Log
from sim.world import World

QUIET: dict[str, Any] = {"camera_fps": 0, "usd_size_mb": 64}
ROWS = ("fixedFrequency", "estPose")


def flown(seconds: float, **keys: Any) -> World:
    world = World("hover", **(QUIET | keys))
    world.run(seconds)
    return world


def log_of(world: World, number: int = 0, robot: int = 0) -> Log:
    card = world.robots[robot].card
    assert card is not None
    return decode(card.get(f"log{number:02}"))


def landed(world: World) -> World:
    world.robots[0].shut_down()
    world.run(2.0)
    return world


def contents_of(path: Path, name: str) -> bytes:
    card = CardImage(path.read_bytes())
    content = card.read(card.find(name))
    assert (card.faults, content.faults) == ([], ())
    return content.data


def last_status(log: Log) -> dict[str, int]:
    rows = log.rows["log.status"].data
    return {name: int(rows[name][-1]) for name in rows.dtype.names or ()}


def test_a_flight_leaves_the_image_of_its_card(tmp_path: Path) -> None:
    path = tmp_path / "card.img"
    with World("hover", usd_config="full", usd_image=str(path), **QUIET) as world:
        world.run(3.0)
        assert not path.exists()
    log = decode(contents_of(path, "log00"))
    assert log.is_whole
    assert len(log.rows["fixedFrequency"]) >= 2990
    assert len(log.types[0].variables) == 20
    with pytest.raises(LocalError, match="exists and is not overwritten"):
        World("hover", usd_config="full", usd_image=str(path), **QUIET)


def test_each_robot_of_a_swarm_has_its_card(tmp_path: Path) -> None:
    with World("hover", robots=2, usd_config="state", usd_image=str(tmp_path / "card.img"), **QUIET) as world:
        world.run(1.0)
    images = sorted(path.name for path in tmp_path.iterdir())
    assert images == ["card.0.img", "card.1.img"]
    sessions = {log_of(world, robot=robot).session for robot in range(2)}
    assert len(sessions) == 2


def test_an_image_that_cannot_be_written_costs_no_other_robots(tmp_path: Path) -> None:
    robots = [tmp_path / "gone", tmp_path / "there"]
    world = World("hover", robots=2, usd_config="state", usd_image=str(tmp_path / "card.img"), **QUIET)
    world.run(1.0)
    for robot, folder in zip(world.robots, robots, strict=True):
        robot._image = folder / "card.img"
    robots[1].mkdir()
    with pytest.raises(LocalError, match="gone"):
        world.close()
    assert world.closed
    assert list(robots[1].iterdir()) == [robots[1] / "card.img"]


def test_the_image_of_a_port_is_written_when_it_closes(tmp_path: Path) -> None:
    path = tmp_path / "card.img"
    port = open_port(f"sim://hover?pace=max&usd_config=state&usd_size_mb=64&usd_image={path}")
    while port.clock_ns() < 1_000_000_000:
        port.read(1000)
    assert not path.exists()
    port.close()
    assert path.stat().st_size == 64 << 20


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"usd_config": "/nowhere/config.txt"}, "usd_config=/nowhere/config.txt: No such file"),
        ({"usd_config": "/"}, "usd_config=/: Is a directory"),
        ({"usd_image": "x.img"}, "there is no card without usd_config"),
        ({"usd_config": "state", "usd_image": "/nowhere/x.img"}, "there is no folder /nowhere"),
        ({"usd_config": "state", "usd_stall_ms": 200}, "each must be at least the one before"),
        ({"usd_config": "state", "usd_free_mb": 100}, "the card has usd_size_mb=64"),
        ({"usd_config": "state", "usd_mocap_hz": 0.0001}, "allowed is 0, or 0.001 and more"),
    ],
)
def test_what_cannot_be_is_refused_before_the_flight(keys: dict[str, Any], said: str) -> None:
    with pytest.raises(LocalError, match=said.replace(".", r"\.")):
        World("hover", **(QUIET | keys))


def test_a_path_in_a_scenario_file_starts_at_the_file(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("1\n512\nmine\n1\non:fixedFrequency\n100\n1\nacc.z\n")
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("[camera]\nfps = 0\n[usd]\nconfig = 'mine.txt'\nimage = 'card.img'\nsize_mb = 64\n")
    with World(str(scenario)) as world:
        world.run(1.0)
    assert (tmp_path / "card.img").exists()
    scenario.write_text("[camera]\nfps = 0\n[usd]\nconfig = 'state'\nsize_mb = 64\n")
    with World(str(scenario)) as world:
        world.run(0.5)
        assert world.robots[0].log["status"] == "on"


def test_at_1_khz_with_stalls_within_the_tolerance_no_row_is_lost() -> None:
    """Twenty floats at 1 kHz and poses at 100 Hz are 94 kB/s: a ring of 64 KiB is good for 0.69 s."""
    world = landed(flown(30.0, usd_config="full", seed=3))
    log = log_of(world)
    assert log.is_whole
    status = last_status(log)
    assert status["dropped"] == status["errors"] == 0
    assert status["stall_us"] > 300_000, "there was a long one"
    steps = np.diff(log.rows["fixedFrequency"].stamp_us)
    assert set(steps.tolist()) == {1000}
    assert len(log.rows["fixedFrequency"]) > 29_900


def test_beyond_the_tolerance_every_lost_row_is_counted() -> None:
    world = landed(flown(20.0, usd_config="full", usd_stall_p99_ms=800, usd_stall_max_ms=3000, seed=3))
    log = log_of(world)
    status = last_status(log)
    assert log.is_whole
    assert status["dropped"] > 100
    assert status["accepted"] == sum(len(log.rows[name]) for name in ROWS)
    # The robot hears a while later that it is to close its log: behind the packet that was on the wire.
    due = [
        (20_000_000 - int(log.rows[name].stamp_us[0])) // period + 1
        for name, period in zip(ROWS, (1000, 10_000), strict=True)
    ]
    assert status["requested"] == status["accepted"] + status["dropped"]
    assert sum(due) <= status["requested"] <= sum(due) + 3


@pytest.mark.parametrize("sync_ms", [50, 250])
def test_after_a_power_cut_all_up_to_the_last_sync_is_verified(sync_ms: int) -> None:
    for seed in range(6):
        world = flown(1.0 + seed * 0.113, usd_config="state", usd_sync_ms=sync_ms, usd_stall_p99_ms=20, seed=seed)
        syncs = world.robots[0].log["syncs"]
        world.robots[0].reboot("stm32", off_seconds=100)
        log = log_of(world)
        rows = log.rows["fixedFrequency"]
        verified = rows.stamp_us[rows.is_verified]
        assert len(log.rows["log.status"].verified) >= 1, f"seed {seed}"
        assert int(log.rows["log.status"].data["syncs"][-1]) >= int(syncs) - 1, f"seed {seed}"
        assert world.now_ns // 1000 - int(verified[-1]) < (sync_ms + 3 * 20 + 500) * 1000, f"seed {seed}"
        assert verified.tolist() == list(range(int(rows.stamp_us[0]), int(verified[-1]) + 1, 4000)), f"seed {seed}"


def test_a_full_card_is_used_up_and_the_log_on_it_is_whole() -> None:
    world = flown(30.0, usd_config="full", usd_free_mb=2, usd_stall_ms=0)
    assert world.robots[0].log["status"] == "full"
    log = log_of(world)
    assert log.is_whole
    assert 1.9e6 < log.size <= 2 << 20


def test_a_card_that_is_pulled_out() -> None:
    world = flown(3.0, usd_config="state", usd_remove_s=2)
    counts = world.robots[0].log
    assert (counts["status"], counts["errors"]) == ("no_card", 1)
    assert world.robots[0].stm32["stamps_sent"] > 290


def test_bad_sectors_cost_rows_that_are_counted() -> None:
    world = landed(flown(10.0, usd_config="full", usd_bad=0.003, usd_stall_ms=0, seed=5))
    files = [log_of(world, number) for number in range(int(world.robots[0].log["files"]))]
    assert len(files) > 1, "no write has met a bad sector"
    for log in files:
        if log.is_whole:
            assert last_status(log)["accepted"] == sum(len(log.rows[name]) for name in ROWS)
    assert any(last_status(log)["dropped"] for log in files)


def test_a_replay_makes_the_same_card_and_no_file(tmp_path: Path) -> None:
    path = tmp_path / "card.img"
    world = World("hover", usd_config="state", usd_image=str(path), seed=4, **QUIET)
    world.run(1.0)
    world.robots[0].set_faults("uart2", loss=0.1)
    world.run(0.5)
    world.close()
    again = World.replay(world.log)
    first, second = world.robots[0].card, again.robots[0].card
    assert first is not None
    assert second is not None
    assert first.get("log00") == second.get("log00")
    assert sorted(tmp_path.iterdir()) == [path]
