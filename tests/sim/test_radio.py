"""Beacons from a simulated host to the logs of simulated robots, and what `host sync robots` makes of these."""

import json
from pathlib import Path
from typing import Any

import pytest
from radio_flights import PPM, Flight

from host.cli import main
from host.native import ffi, lib
from host.protocol.errors import LocalError
from host.usd.decode import decode
from sim.radio import BEACON, BEACON_HEAD
from sim.world import World


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert main(["sync", "robots", *arguments, "--json"]) == 0
    return [json.loads(each) for each in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("divider", [84, 85])
def test_from_the_air_to_the_table(divider: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = Flight(tmp_path, 200.0, beacon_hz=2, radio_loss=0.2, stm32_divider=divider, seed=5)
    assert all(robot.stm32["crtp_ignored"] == 0 for robot in flight.world.robots)
    records = said(capsys, *flight.paths)
    robots = [each for each in records if each["event"] == "robot"]
    rate = divider / 85
    for robot, ppm in zip(robots, PPM, strict=True):
        assert abs(robot["drift_ppm"] - (rate * (1 + ppm * 1e-6) - 1) * 1e6) < 0.5
        assert robot["counts_84_of_85"] is (divider == 84)
        assert 40 < robot["lost"] < 120
        assert robot["host_bound_us"] < 100
    for pair in (each for each in records if each["event"] == "pair"):
        a, b = (int(pair[name][2:]) for name in ("first", "second"))
        now = pair["offset_us"] + pair["slope_ppm"] * 1e-6 * (flight.stamps[a] - pair["at_us"])
        assert abs(now - (flight.stamps[b] - flight.stamps[a])) <= pair["worst_us"] + 1
        assert pair["worst_us"] < 200
    picture = tmp_path / "clocks.svg"
    assert main(["sync", "robots", *flight.paths, "--plot", str(picture)]) == 0
    assert "beacons late, us" in picture.read_text(encoding="utf-8")
    assert main(["sync", "robots", *flight.paths, "--plot", str(picture)]) == 2
    table = capsys.readouterr().out
    assert ("it counts 84 where 85 have passed" in table) == (divider == 84)
    assert "cf2 against cf1" in table


def test_too_few_and_other_runs_say_so(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    paths = Flight(tmp_path, 15.2, beacon_hz=2).paths
    assert main(["sync", "robots", *paths]) == 4
    assert "cf0: 30 beacons of one run of the host; at least 50" in capsys.readouterr().err
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir()
    second.mkdir()
    one = Flight(first, 27.0, beacon_hz=2).paths[0]
    other = Flight(second, 27.0, beacon_hz=2.2).paths[1]
    assert main(["sync", "robots", one, other]) == 4
    assert "cf0 and cf1: not one beacon in common" in capsys.readouterr().err


def test_a_run_with_a_radio_is_repeated_from_its_log() -> None:
    keys = {"beacon_hz": 20, "reset_s": 1.5, "reset_repeats": 5, "radio_loss": 0.4, "seed": 9}
    with World("swarm", robots=2, trace="hash", **keys) as world:
        world.run(0.7)
        world.robots[0].radio(BEACON.pack(*BEACON_HEAD, 1, 2))
        world.run(2.0)
        log = json.loads(json.dumps(world.log))
        assert sum("radio" in each["do"] for each in log) == 1, "what the scenario has is in no log"
        with World.replay(log) as again:
            assert again.trace_hash() == world.trace_hash()
            assert again.radio.heard_resets == world.radio.heard_resets != [[0, 1, 2, 3, 4]] * 2


def test_losses_of_one_robot_change_nothing_for_another() -> None:
    def resets(loss: list[float]) -> list[list[int]]:
        with World("swarm", robots=2, reset_s=0.1, reset_repeats=20, radio_loss=loss) as world:
            world.run(0.2)
            return world.radio.heard_resets

    assert resets([0.5, 0.5])[1] == resets([0.0, 0.5])[1]
    assert resets([0.0, 0.5])[0] == list(range(20))


def test_how_late_broadcasts_come(tmp_path: Path) -> None:
    keys = {"stm32_ppm": 0, "radio_latency_us": [100.0, 900.0, 900.0], "radio_jitter_us": 0, "stm32_walk_ppb": 0}
    paths = Flight(tmp_path, 5.0, beacon_hz=20, stm32_boot_ms=0, **keys).paths
    first, second = (decode(Path(each).read_bytes()).rows["beacon"] for each in paths[:2])
    assert len(first) > 90
    assert set((second.stamp_us - first.stamp_us).tolist()) == {800}
    assert set((first.stamp_us - first.data["hostUs"]).tolist()) == {100}


def test_the_packet_is_the_firmwares() -> None:
    out = ffi.new("uint8_t[14]")
    lib.beacon_encode(ffi.new("beacon_t *", (0x04030201, 0x0C0B0A0908070605)), out)
    assert bytes(out) == BEACON.pack(*BEACON_HEAD, 0x04030201, 0x0C0B0A0908070605)
    assert bytes(out) == bytes.fromhex("d2 62 01 02 03 04 05 06 07 08 09 0a 0b 0c")


def test_what_is_refused() -> None:
    with pytest.raises(LocalError, match="the image has no radio"):
        World("hover", beacon_hz=1, backend="emulated")
    with pytest.raises(LocalError, match=r"beacon_hz=0\.001: allowed is 0, or 0\.01 and more"):
        World("hover", beacon_hz=0.001)
