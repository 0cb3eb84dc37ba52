"""`host sync camera` on recordings of what simulated robots saw, through the whole stream, against the truth."""

import json
import re
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "clock"))

from filmed import Filmed, filmed  # type: ignore[import-not-found]

from host.cli import main


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Filmed:
    """The STM32's clock counts 84 where 85 have passed: on it rows and exposure, 6.8 ms to the end of frame, are 80 us
    shorter, and the filters' 4.5 ms 53 us."""
    keys = "&stm32_divider=84&stm32_ppm=40&gap8_ppm=-30"
    return filmed(tmp_path_factory.mktemp("turned"), 7, "teeter", seconds=5, fps=10, keys=keys)


def sync(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> dict:
    capsys.readouterr()
    assert main(["sync", "camera", *words, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def test_restamped_frames_have_no_offset(turned: Filmed, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    plot = tmp_path / "a.svg"
    said = sync(capsys, turned.recording, turned.log, "--plot", str(plot))
    assert said["times"] == "restamped"
    assert said["of"] == "end of frame"
    assert abs(said["offset_us"]) < 30
    assert abs(said["skew_ppm"]) < 60
    assert said["offset_sigma_us"] < 15
    assert said["end_after_middle_us"] == pytest.approx(turned.flight.optics.middle_to_end_s * 1e6, abs=5)
    assert said["gyro_lag_us"] == pytest.approx(turned.flight.gyro.lag_s * 1e6, abs=1)
    assert said["focal_px"] == pytest.approx(turned.flight.optics.focal_px, rel=0.01)
    assert said["line_time_us"] == pytest.approx(71.667 * (1 + 70e-6), rel=2e-5), "the STM32's"
    assert said["paper"]["events"] >= 3
    assert plot.read_text(encoding="utf-8").startswith("<svg")


def test_with_the_gyros_lag_left_in(turned: Filmed, capsys: pytest.CaptureFixture[str]) -> None:
    said = sync(capsys, turned.recording, turned.log, "--raw-gyro")
    assert said["offset_us"] == pytest.approx(turned.flight.gyro.lag_s * 1e6 * 84 / 85, abs=80)
    assert "filters" in said["not_in_sigma"]


def test_the_robots_own_times_for_people(turned: Filmed, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "camera", turned.recording, turned.log, "--own-times"]) == 0
    out = capsys.readouterr().out
    assert "times     the robot's own" in out
    offset = re.search(r"frames were ([\d.]+) us (later|earlier)", out)
    assert offset
    assert float(offset[1]) < 150
    for word in ("offset ", "skew", "rows", "focal length", "paper", "unseen"):
        assert word in out
    assert "do not agree" not in out


def test_the_papers_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Stamped too early by the message's way over the wire and half of two ticks, and each by another rounding."""
    made = filmed(tmp_path, 5, "teeter", scenario="paper", seconds=6, fps=10, keys="&camera_burst=1")
    optics = made.flight.optics
    alone = sync(capsys, made.recording, made.log)
    assert alone["of"] == "middle of exposure of the middle row"
    assert alone["line_time_us"] is None
    told = ["--line-time-us", f"{optics.line_s * 1e6}", "--exposure-us", f"{optics.exposure_s * 1e6}"]
    known = sync(capsys, made.recording, made.log, *told)
    assert known["of"] == "end of frame"
    assert 3000 < known["offset_us"] < 5000
    assert alone["offset_us"] - known["offset_us"] == pytest.approx(-optics.middle_to_end_s * 1e6, abs=250)


def test_refused_and_wrong_words(turned: Filmed, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert main(["sync", "camera", turned.recording, turned.log, "--within-ms", "0"]) == 2
    assert main(["sync", "camera", turned.recording, turned.log, "--exposure-us", "-1"]) == 2
    assert main(["sync", "camera", turned.log, turned.log]) == 2
    assert main(["sync", "camera", turned.recording, str(tmp_path / "none")]) == 2
    assert main(["sync", "camera", turned.recording, turned.log, "--robot", "3"]) == 2
    assert main(["sync", "camera", turned.recording, turned.log, "--plot", str(tmp_path / "x.gif")]) == 2
    capsys.readouterr()
    other = tmp_path / "other"
    other.mkdir()
    still = filmed(other, 7, "still", seconds=3, fps=10)
    refused = sync(capsys, still.recording, still.log, "--plot", str(tmp_path / "y.svg"), code=4)
    assert refused["refused"] == "too little rotation"
    assert not (tmp_path / "y.svg").exists()
    assert main(["sync", "camera", turned.recording, still.log]) == 4
    assert "too little rotation" in capsys.readouterr().err


def test_a_stock_robot_has_no_times(tmp_path: Path, capsys: pytest.CaptureFixture[str], turned: Filmed) -> None:
    path = str(tmp_path / "stock.mcap")
    assert main(["stream", "--port", "sim://stock?pace=max", "--duration", "2", "--record", path, "--json"]) == 0
    capsys.readouterr()
    assert main(["sync", "camera", path, turned.log]) == 4
    assert "without a time" in capsys.readouterr().err
