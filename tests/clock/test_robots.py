"""Robots that heard the same broadcasts, simulated and real."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

from host.cli import main
from host.clock.robots import Heard, Pair, closures, compare

DATA = os.environ.get("SPINDECK_DATA", str(Path(__file__).resolve().parents[3] / "shared/data"))
REAL = Path(DATA) / "usd/sync-3-robots"
"""Logs of real robots, which are not part of the project."""


def heard(name: str, ppm: float, offset_us: float, seed: int) -> Heard:
    """2000 broadcasts at 100 Hz, one in ten missed, logged at about 500 Hz; most contents come again."""
    random = np.random.default_rng(seed)
    sent_us = np.arange(2000) * 10_000.0
    came = random.random(2000) > 0.1
    own_us = (sent_us + random.exponential(100, 2000)) * (1 + ppm * 1e-6) + offset_us
    row_us = 1979.3 + 1.7 * seed
    logged_us = np.ceil(own_us / row_us) * row_us
    what = [(k % 70, k if k % 10 == 0 else 0) for k in range(2000)]
    return Heard(name, logged_us[came], [each for each, here in zip(what, came, strict=True) if here])


def test_slopes_offsets_and_closure() -> None:
    robots = [heard("a", 0, 0, 1), heard("b", 54, 3_000, 2), heard("c", -183, -40_000, 3)]
    pairs = compare(robots)
    for pair, ppm, offset_us in zip(pairs, (54, -183, -237), (3_000, -40_000, -43_000), strict=True):
        assert isinstance(pair, Pair)
        assert pair.common > 1400
        assert abs(pair.slope_ppm - ppm) < 3 * pair.slope_sigma_ppm
        assert abs(pair.start_us - offset_us) < 3 * pair.start_sigma_us + 15
        assert pair.slope_sigma_ppm < 6
    assert [abs(each) < 6 for each in closures([each for each in pairs if isinstance(each, Pair)]).values()] == [True]


def test_robots_that_heard_nothing_in_common() -> None:
    one = heard("a", 0, 0, 1)
    other = Heard("b", one.time_us, [("other", each) for each in one.what])
    assert compare([one, other]) == [(0, 1, 0)]


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared logs are not here")
def test_three_real_robots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Against an independent decoder and fit (its table: slope, sigma)."""
    names = [str(REAL / name) for name in ("cf231_00", "cf5_00", "cf6_00")]
    picture = tmp_path / "clocks.svg"
    assert main(["sync", "robots", *names, "--json", "--plot", str(picture)]) == 0
    assert "about the line, us" in picture.read_text(encoding="utf-8")
    records = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    pairs = [each for each in records if each["event"] == "pair"]
    for pair, (ppm, sigma) in zip(pairs, [(54.0, 4.5), (237.1, 4.6), (183.3, 4.4)], strict=True):
        assert abs(abs(pair["slope_ppm"]) - ppm) < 2 * sigma
        assert pair["slope_sigma_ppm"] < sigma
        assert abs(pair["start_us"]) < 250
    assert abs(records[-1]["closure_ppm"]) < 1
    assert [each["counts_84_of_85"] for each in records if each["event"] == "robot"] == [True] * 3


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared logs are not here")
def test_what_cannot_be_compared_says_why(capsys: pytest.CaptureFixture[str]) -> None:
    log = str(REAL / "cf5_00")
    assert main(["sync", "robots", log]) == 2
    assert "two robots" in capsys.readouterr().err
    assert main(["sync", "robots", log, log]) == 2
    assert "given 2 times" in capsys.readouterr().err
    assert main(["sync", "robots", log, str(REAL / "cf6_00"), "--variable", "gyro"]) == 2
    assert "host usd info" in capsys.readouterr().err
