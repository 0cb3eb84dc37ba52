"""`host sim example`: what it says is true of its files is what `host sync` finds in them."""

import json
from pathlib import Path
from typing import Any

import pytest

from host.cli import main


def example(capsys: pytest.CaptureFixture[str], what: str, folder: Path, *more: str) -> dict[str, Any]:
    capsys.readouterr()
    assert main(["sim", "example", what, str(folder), "--json", *more]) == 0
    made: dict[str, Any] = json.loads(capsys.readouterr().out)
    assert made["files"] == sorted(str(path) for path in folder.iterdir())
    return made


def found(capsys: pytest.CaptureFixture[str], command: str) -> list[dict[str, Any]]:
    """What the command that was printed says."""
    tool, *words = command.split()
    assert tool == "host"
    assert main([*words, "--json"]) == 0
    return [json.loads(each) for each in capsys.readouterr().out.splitlines()]


def test_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = example(capsys, "board", tmp_path / "board", "--seed", "3")
    (said,) = found(capsys, made["command"])
    true_us = made["truth"]["shift_us"] + (said["at_us"] - made["truth"]["at_us"]) * made["truth"]["slope_ppm"] * 1e-6
    assert abs(said["shift_us"] - true_us) < 4 * said["sigma_us"]
    assert abs(said["slope_ppm"] - made["truth"]["slope_ppm"]) < 4 * said["slope_sigma_ppm"]


def test_mocap(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = example(capsys, "mocap", tmp_path / "mocap")
    poses, estimate = found(capsys, made["command"])
    assert abs(poses["lag_us"] - made["truth"]["mocap_lag_us"]) < 4 * poses["sigma_us"]
    assert abs(estimate["lag_us"] - made["truth"]["estimate_lag_us"]) < 4 * estimate["sigma_us"]


def test_camera(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = example(capsys, "camera", tmp_path / "camera")
    (said,) = found(capsys, made["command"])
    assert abs(said["offset_us"] - made["truth"]["offset_us"]) < 4 * said["offset_sigma_us"]
    assert said["focal_px"] == pytest.approx(made["truth"]["focal_px"], rel=0.01)
    assert said["gyro_lag_us"] == pytest.approx(made["truth"]["gyro_lag_us"], abs=1)


def test_equal_seeds_equal_files_and_words_for_people(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one", "two"):
        assert main(["sim", "example", "mocap", str(tmp_path / name), "--seed", "5"]) == 0
    assert (tmp_path / "one" / "log00").read_bytes() == (tmp_path / "two" / "log00").read_bytes()
    out = capsys.readouterr().out
    assert f"next      host sync mocap {tmp_path / 'two' / 'log00'}\n" in out
    assert "12.15 ms behind the motion" in out


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").write_text("mine")
    for folder, says in ((tmp_path, "not empty"), (tmp_path / "mine", "a file is there"), ("/dev/null/x", "a file")):
        assert main(["sim", "example", "board", str(folder)]) == 2
        assert says in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]
    assert main(["sim", "example", "board", str(tmp_path / "new"), "--seed", "-1"]) == 2
    assert not (tmp_path / "new").exists()
