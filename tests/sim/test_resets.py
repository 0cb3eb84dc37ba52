"""A reset of all stamp clocks by broadcast, once or repeated, heard or missed: what `host sync robots` says of it."""

import json
from pathlib import Path
from typing import Any

import pytest
from radio_flights import ROWS, SHUTDOWN, Flight, Store

from host.cli import main
from host.cli.sync_robots import shared
from host.usd.decode import decode
from sim.world import World

RESET = {"reset_s": 3, "stm32_boot_ms": [0.0, 350.0, 700.0]}
DEAF = {"radio_loss": [0.0, 1.0, 1.0]}


def said(capsys: pytest.CaptureFixture[str], *arguments: str) -> list[dict[str, Any]]:
    capsys.readouterr()
    assert main(["sync", "robots", *arguments, "--json"]) == 0
    return [json.loads(each) for each in capsys.readouterr().out.splitlines()]


@pytest.mark.parametrize("seed", range(3))
def test_one_reset_alone_is_zero_with_its_spread(seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = Flight(tmp_path, 13.0, **RESET, seed=seed)
    pairs = said(capsys, *flight.paths)
    assert [(each["first"], each["second"], each["offset_us"]) for each in pairs] == [
        ("cf0", "cf1", 0), ("cf0", "cf2", 0), ("cf1", "cf2", 0),
    ]  # fmt: skip
    for each in pairs:
        a, b = (int(each[name][2:]) for name in ("first", "second"))
        assert abs(flight.stamps[b] - flight.stamps[a]) < each["bound_us_at_end"]
        assert each["bound_us_at_end"] == pytest.approx(1400 + 500 * each["span_s"], abs=1)
    assert main(["sync", "robots", *flight.paths]) == 0
    table = capsys.readouterr().out
    assert "cf1: set to 0 when it had counted to 2.6" in table


def test_a_robot_that_has_missed_it_is_refused_by_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = Flight(tmp_path, 6.0, **RESET, **DEAF)
    assert main(["sync", "robots", *flight.paths]) == 4
    error = capsys.readouterr().err
    assert "cf1 has missed a reset" in error
    assert "cf0 1, cf1 0, cf2 0" in error


def test_with_beacons_it_is_said_when_each_took_it_and_which_repeat(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = Flight(tmp_path, 45.0, **RESET, reset_repeats=8, beacon_hz=4, radio_loss=0.5, radio_jitter_us=30, seed=11)
    last = [heard[-1] for heard in flight.heard]
    assert len(set(last)) > 1, flight.heard
    records = [each for each in said(capsys, *flight.paths, "--reset-every-us", "1000") if each["event"] == "reset"]
    assert [each["repeat"] for each in records] == [each - min(last) for each in last]
    for each, repeat in zip(records, last, strict=True):
        assert abs(each["after_us"] - 1000 * (repeat - min(last))) < 300
        assert each["of_another_packet"] is (each["after_us"] - each["bound_us"] > 1400)
    assert main(["sync", "robots", *flight.paths]) == 0
    assert "all were set to 0 by a broadcast" in capsys.readouterr().out


def test_with_beacons_one_that_missed_it_keeps_its_place(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    flight = Flight(tmp_path, 33.0, **RESET, beacon_hz=4, seed=2)
    assert [each["event"] for each in said(capsys, *flight.paths)] == ["robot"] * 3 + ["pair"] * 3 + ["reset"] * 3
    # Another that has heard the same beacons, in a world without the reset.
    store, world = Store(ROWS + b"on:beacon\n"), World("hover", camera_fps=0, beacon_hz=4, seed=2)
    world.robots[0].set_storage(store)
    world.run(33.0)
    world.robots[0].inject("uart2_to_stm32", SHUTDOWN)
    world.run(1.0)
    (tmp_path / "deaf").write_bytes(bytes(store.files["log00"]))
    records = said(capsys, flight.paths[0], str(tmp_path / "deaf"))
    assert [each["event"] for each in records] == ["robot"] * 2 + ["pair", "reset"]
    assert "deaf has missed a reset" in records[-1]["not_told"]


def test_robots_that_did_the_same_heard_nothing_in_common(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Simulated robots sway alike: equal values, at times that fit no line."""
    alike = {"rows": b"stateEstimate.x\n", "robots": 2}
    paths = Flight(tmp_path, 13.0, **alike).paths
    assert shared([decode(Path(each).read_bytes()) for each in paths])[1] == ["stateEstimate.x"]
    assert main(["sync", "robots", *paths]) == 4
    assert "no variable has the same values" in capsys.readouterr().err
    assert [each["by"] for each in said(capsys, *paths, "--reset")] == ["reset"]


def test_logs_that_begin_after_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As the paper did: reset, then log. Nothing in them says that there was one."""
    for name, late_s in (("a", 0.0), ("b", 0.2), ("c", 30.0)):
        store = Store(ROWS)
        with World("hover", camera_fps=0, stm32_stamp_start_us=round(late_s * 1e6), seed=ord(name)) as world:
            world.robots[0].set_storage(store)
            world.run(2.0)
            world.robots[0].inject("uart2_to_stm32", SHUTDOWN)
            world.run(0.5)
        (tmp_path / name).write_bytes(bytes(store.files["log00"]))
    a, b, c = (str(tmp_path / name) for name in "abc")
    assert main(["sync", "robots", a, b]) == 4
    assert "no variable has the same values" in capsys.readouterr().err
    assert [each["by"] for each in said(capsys, a, b, "--reset")] == ["reset"]
    assert main(["sync", "robots", a, b, c, "--reset"]) == 4
    assert "c has missed the reset, or logged later" in capsys.readouterr().err
    assert main(["sync", "robots", a, b, "--reset-every-us", "0"]) == 2
    assert main(["sync", "robots", a, b, "--reset", "--plot", str(tmp_path / "no.svg")]) == 2
    assert not list(tmp_path.glob("no*"))
