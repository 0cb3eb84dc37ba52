"""`host usd interpolate`: times as people give them, answers and refusals, and the frames of a recording."""

import csv
import io
import json
import sys
from pathlib import Path
from typing import Any

import pytest

from host.cli import main

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from logs import FIXED, Writer

POSE = [f"stateEstimate.{name}(f)" for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
SHORT = {FIXED: ("fixedFrequency", POSE), 3: ("estPose", [each.replace("stateEstimate", "locSrv") for each in POSE])}


def made_log(verified: bool = True) -> bytes:
    """x in metres is the time in seconds; poses have 100 m more."""
    log = Writer(types=SHORT)
    for number in range(2000):
        log.row(FIXED, 1000 * number, number / 1000, 0, 0, 0, 0, 0, 1)
        if number % 10 == 0:
            log.row(3, 1000 * number + 300, 100 + number / 1000, 0, 0, 0, 0, 0, 1)
    return log.close() if verified else log.close()[:-4]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "log00").write_bytes(made_log())
    (tmp_path / "open00").write_bytes(made_log(verified=False))
    (tmp_path / "empty00").write_bytes(b"")
    (tmp_path / "times").write_text("# us\n500500, 600500\n\n 1000000 # one second\n")
    (tmp_path / "bad").write_text("500500\n5e5x\n")
    (tmp_path / "binary").write_bytes(bytes(range(256)))
    (tmp_path / "nothing").write_text("# nothing\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows(capsys: pytest.CaptureFixture[str]) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(capsys.readouterr().out)))


@pytest.mark.parametrize("times", ["500500,600500,1000000", "times"])
def test_times(folder: Path, times: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "interpolate", "log00", "--at", times]) == 0
    found = rows(capsys)
    assert [each["stamp_stm32_us"] for each in found] == ["500500", "600500", "1000000"]
    assert [float(each["x_m"]) for each in found] == pytest.approx([0.5005, 0.6005, 1], abs=1e-6)
    assert [float(each["position_error_m"]) for each in found] == pytest.approx([0.001] * 3, rel=0.01)
    assert {each["refused"] for each in found} == {""}


def test_standard_input(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.StringIO("500500\n"))
    assert main(["usd", "interpolate", "log00", "--at", "-", "--source", "estPose", "--method", "cubic"]) == 0
    (found,) = rows(capsys)
    assert float(found["x_m"]) == pytest.approx(100.5002, abs=1e-4)


def test_refusals_have_their_words_and_no_numbers(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "interpolate", "log00", "--at", "500500,2000000", "--json"]) == 0
    printed = capsys.readouterr()
    good, refused = (json.loads(line) for line in printed.out.splitlines())
    assert good["refused"] is None
    assert refused == {"event": "pose", "stamp_stm32_us": 2000000, "refused": "after"}
    assert "1 of 2 times answered; refused: 1 after" in printed.err
    assert main(["usd", "interpolate", "log00", "--at", "9999999"]) == 4
    assert main(["usd", "interpolate", "open00", "--at", "500500"]) == 4
    assert "1 unverified" in capsys.readouterr().err
    assert main(["usd", "interpolate", "open00", "--at", "500500", "--unverified"]) == 0


def recorded(scenario: str, capsys: pytest.CaptureFixture[str]) -> dict[int, dict[str, Any]]:
    """flight.mcap, and its frames that carry an STM32 time."""
    port = f"sim://{scenario}?pace=max&seed=7"
    assert main(["stream", "--port", port, "--count", "5", "--record", "flight.mcap", "--json"]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    frames = [each for each in events if each["event"] == "frame"]
    assert len(frames) == 5
    return {each["index"]: each for each in frames if each["frame_stm32_us"] is not None}


def test_frames_of_a_recording(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = recorded("hover", capsys)
    command = ["usd", "interpolate", "log00", "--at", "flight.mcap"]
    assert main(command) == 0
    printed = capsys.readouterr()
    found = list(csv.DictReader(io.StringIO(printed.out)))
    assert {int(each["frame"]): int(each["stamp_stm32_us"]) for each in found} == {
        index: frame["frame_stm32_us"] for index, frame in frames.items()
    }
    assert all(float(each["x_m"]) == pytest.approx(int(each["stamp_stm32_us"]) / 1e6, abs=1e-5) for each in found)
    for each in found:
        bound_us = frames[int(each["frame"])]["bound_us"]
        assert bound_us > 0
        assert float(each["position_error_m"]) == pytest.approx(0.001 + bound_us * 1e-6, rel=0.01)
    assert "1 frames carry no STM32 time" in printed.err
    assert main([*command, "--robot", "3"]) == 2
    assert "no robot 3 in it" in capsys.readouterr().err


def test_frames_that_do_not_say_how_good_their_times_are(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames = recorded("paper", capsys)
    command = ["usd", "interpolate", "log00", "--at", "flight.mcap"]
    assert main(command) == 2
    assert "--time-error-us" in capsys.readouterr().err
    assert main([*command, "--time-error-us", "2500"]) == 0
    found = rows(capsys)
    assert {int(each["frame"]) for each in found} == set(frames)
    answered = [each for each in found if not each["refused"]]
    assert answered
    assert all(float(each["position_error_m"]) == pytest.approx(0.0035, rel=0.01) for each in answered)


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["nowhere", "--at", "1"], 2, "No such file"),
        ([".", "--at", "1"], 2, "directory"),
        (["empty00", "--at", "1"], 4, "no rows: empty"),
        (["times", "--at", "1"], 4, "no rows: not a log"),
        (["log00", "--at", "nowhere.txt"], 2, "neither a file that is there nor"),
        (["log00", "--at", "500500,x"], 2, "neither a file that is there nor"),
        (["log00", "--at", ""], 2, "no times in it"),
        (["log00", "--at", "1,,-"], 2, "neither a file that is there nor"),
        (["log00", "--at", "x" * 5000], 2, "File name too long"),
        (["log00", "--at", "."], 2, "directory"),
        (["log00", "--at", "bad"], 2, "line 2: '5e5x'"),
        (["log00", "--at", "binary"], 2, "neither times as text nor a recording"),
        (["log00", "--at", "nothing"], 2, "no times in it"),
        (["log00", "--at", "1", "--source", "gyro"], 2, "there are fixedFrequency:stateEstimate"),
        (["log00", "--at", "1", "--epoch", "1"], 2, "counted from 0"),
        (["log00", "--at", "1", "--epoch", "x"], 2, "whole number"),
        (["log00", "--at", "1", "--hole-us", "-1"], 2, "microseconds"),
    ],
)
def test_errors(folder: Path, words: list[str], code: int, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "interpolate", *words]) == code
    printed = capsys.readouterr()
    assert says in printed.err
    assert len(printed.err.splitlines()) == 1
    assert printed.out == ""
