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


@pytest.mark.parametrize("source", ["estPose", "stateEstimate"])
def test_a_lag_that_is_measured_is_the_one_that_sync_mocap_says(
    source: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["sim", "example", "mocap", str(tmp_path / "a"), "--json"]) == 0
    log = json.loads(capsys.readouterr().out)["files"][0]
    assert main(["sync", "mocap", log, "--source", source, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    ask = ["usd", "interpolate", log, "--at", "15000000,20000000.5", "--source", source, "--json", "--lag-us"]
    assert main([*ask, f"{said['lag_us']}±{said['sigma_us']}"]) == 0
    given = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    assert main([*ask, "measured"]) == 0
    output = capsys.readouterr()
    lag, *poses = [json.loads(each) for each in output.out.splitlines()]
    assert lag == said
    assert [each.keys() for each in poses] == [each.keys() for each in given]
    for one, other in zip(poses, given, strict=True):
        assert (one.pop("event"), one.pop("refused")) == (other.pop("event"), other.pop("refused")) == ("pose", None)
        assert one == pytest.approx(other, rel=1e-3, abs=1e-5)
    assert main([*ask, f"{said['lag_us']}"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[0])["attitude_error_rad"] < poses[0]["attitude_error_rad"]
    assert main([*ask, "0"]) == 0
    late = json.loads(capsys.readouterr().out.splitlines()[0])
    assert abs(late["qx"] - poses[0]["qx"]) + abs(late["qz"] - poses[0]["qz"]) > 1e-4
    assert f"{said['lag_us'] / 1000:+.3f} ± 0.0" in output.err


def test_a_lag_that_is_not_known_ends_as_sync_mocap_does(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    still = Writer(types={FIXED: ("fixedFrequency", [*POSE, *(f"gyro.{axis}(f)" for axis in "xyz")])})
    flat = Writer(types={FIXED: ("fixedFrequency", [*POSE[:3], *(f"gyro.{axis}(f)" for axis in "xyz")])})
    for number in range(10_000):
        still.row(FIXED, 1000 * number, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0)
        flat.row(FIXED, 1000 * number, 0, 0, 0, 0, 0, 0)
    (folder / "still00").write_bytes(still.close())
    (folder / "flat00").write_bytes(flat.close())
    for log, why in (("log00", "no gyro in it"), ("still00", None), ("flat00", "no attitude")):
        assert main(["sync", "mocap", log]) == 4
        reason = capsys.readouterr().err.strip().rpartition(": ")[2]
        assert main(["usd", "interpolate", log, "--at", "500500", "--lag-us", "measured"]) == 4
        output = capsys.readouterr()
        assert (why or reason) in output.err
        assert output.out == ""
