"""One robot's clock against another's by their gyros, on simulated teeterboards whose truth is known."""

import functools
import json
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from host.cli import main
from host.clock.gyro import Gyro, Refused, Shift, compare
from host.clock.gyro_signal import Samples, prediction
from host.usd.decode import decode
from sim import teeterboard
from sim.teeterboard import Board, Teetered, bound_us, noise_dps

DATA = os.environ.get("SPINDECK_DATA", str(Path(__file__).resolve().parents[3] / "shared/data"))
REAL = Path(DATA) / "usd/flights"
"""Logs of real robots, which are not part of the project."""
SHORT = {"seconds": 14.0, "impacts": 8}
teeter = functools.cache(teeterboard.teeter)
"""Several tests look at the same boards."""


def gyro(data: bytes) -> Gyro:
    log = decode(data)
    assert log.is_whole
    rows = log.rows["fixedFrequency"]
    rate = np.stack([rows.data[f"gyro.{axis}"].astype(np.float64) for axis in "xyz"], axis=1)
    return Gyro(rows.stamp_us.astype(np.float64), rate)


def compared(made: Teetered) -> Shift:
    found = compare(*map(gyro, made.logs))
    assert isinstance(found, Shift), f"{found} of {made.board}"
    return found


def off_us(made: Teetered, found: Shift) -> float:
    return float(found.shift_us - made.shift_us(found.at_us))


@pytest.mark.parametrize("white_dps", [0.1, 1.0, 10.0])
def test_as_sharp_as_the_noise_allows(white_dps: float) -> None:
    """Of few seeds; benchmarks/gyro.py has more, and holds 1.2."""
    ratio, away, slope = [], [], []
    for seed in range(4):
        made = teeter(Board(seed=seed, density_dps_rthz=0.0, white_dps=white_dps, **SHORT))
        found = compared(made)
        ratio.append(off_us(made, found) / bound_us(made, found.at_us))
        away.append(off_us(made, found) / found.sigma_us)
        slope.append((found.skew_ppm - made.board.skew_ppm) / found.skew_sigma_ppm)
        assert len(found.events) >= 8
    assert np.sqrt(np.mean(np.square(ratio))) < 1.5, ratio
    assert np.abs(away).max() < 3.5, away
    assert np.abs(slope).max() < 3.5, slope


def test_the_stated_sigma_is_true() -> None:
    """One that is 1.5 times too small, or too large, fails: 24 draws of noise on one board."""
    made = teeter(Board(seed=1, density_dps_rthz=0.0, **SHORT))
    first, second = map(gyro, made.logs)
    random, away, slope = np.random.default_rng(5), [], []
    for _ in range(24):
        found = compare(
            *(Gyro(each.time_us, each.rate_dps + random.normal(0, 1, each.rate_dps.shape)) for each in (first, second))
        )
        assert isinstance(found, Shift), found
        away.append(off_us(made, found) / found.sigma_us)
        slope.append((found.skew_ppm - made.board.skew_ppm) / found.skew_sigma_ppm)
    for each in (away, slope):
        assert 0.75 < np.sqrt(np.mean(np.square(each))) < 1.25, each


def test_the_bound_is_the_textbook_one_where_noise_is_white() -> None:
    made = teeter(Board(density_dps_rthz=0.0, white_dps=1.0, **SHORT))
    slope = CubicSpline(made.stamp_us, made.clean_dps)(made.stamp_us, 1)
    textbook = np.sqrt(2) * noise_dps(made.board) / np.sqrt((slope**2).sum())
    middle_us = float((made.stamp_us * slope**2).sum() / (slope**2).sum())
    assert 0.99 < bound_us(made, middle_us) / textbook < 1.02


def test_against_another_estimator() -> None:
    """Shifts of 10 us steps tried one by one, splines between samples, and a parabola through the best three."""
    made = teeter(Board(seed=6, skew_ppm=0.0, gain=1.0, turned_deg=0.0, density_dps_rthz=0.0, white_dps=0.3, **SHORT))
    first, second = map(gyro, made.logs)
    spline = CubicSpline(second.time_us, second.rate_dps[:, 1] + 0.5)
    shifts = 20_000 + np.arange(-400.0, 401.0, 10.0)
    inner = slice(1000, -1000)
    squares = [float(((first.rate_dps[inner, 1] - spline(first.time_us[inner] + each)) ** 2).sum()) for each in shifts]
    best = int(np.argmin(squares))
    bend = np.polyfit(shifts[best - 1 : best + 2], squares[best - 1 : best + 2], 2)
    found = compared(made)
    # That one takes the sensors' rates for equal.
    assert abs(found.shift_us + found.filter_us - (-bend[1] / (2 * bend[0]))) < 4


def test_what_the_sensors_rates_do_is_taken_off() -> None:
    """Without noise: filters that count samples of 0.6 % another length are up to 30 us apart. What is left is what the
    board does above 500 Hz, folded."""
    for seed in range(3):
        made = teeter(Board(seed=seed, density_dps_rthz=0.0, **SHORT))
        found = compared(made)
        assert abs(off_us(made, found)) < 1
        assert 1 < abs(found.filter_us) < 30


@pytest.mark.parametrize(
    ("settings", "most_us"),
    [
        ({"skew_ppm": 84 / 85 * 1e6 - 1e6}, 3),
        ({"skew_ppm": 237.0, "shift_us": -3_400_000.0}, 3),
        ({"turned_deg": 180.0, "gain": 0.8}, 3),
        ({"every": 2}, 5),
        ({"jitter_us": 300.0}, 60),
        ({"flex": 0.1}, 100),
        ({"warming_ppm": -10.0}, 20),
    ],
    ids=["84-of-85", "far-apart", "turned-round", "500-Hz", "late-stamps", "board-bends", "warming-up"],
)
def test_what_a_teeterboard_may_be_like(settings: dict[str, float], most_us: float) -> None:
    """The bound of the error, whatever it comes from, is the jackknife's."""
    made = teeter(Board(seed=11, **{**SHORT, **settings}))
    found = compared(made)
    assert found.sigma_us < most_us
    assert abs(off_us(made, found)) < 3.5 * found.sigma_us + 1
    before_us, behind_us = made.shift_us(found.at_us + np.array([-1e6, 1e6]))
    assert abs(found.skew_ppm - (behind_us - before_us) / 2) < 3.5 * found.skew_sigma_ppm + 0.1


@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"impacts": 0, "rocking_dps": 0.0}, "too little rotation"),
        ({"impacts": 2, "rocking_dps": 0.0}, "events in which they turned"),
        ({"impacts": 0, "rocking_dps": 8.0, "white_dps": 10.0}, "did not turn alike"),
    ],
    ids=["at-rest", "two-impacts", "lost-in-noise"],
)
def test_refused_with_a_reason(settings: dict[str, float], why: str) -> None:
    found = compare(*map(gyro, teeter(Board(seed=2, **{**SHORT, **settings})).logs))
    assert isinstance(found, Refused)
    assert why in found.why


@pytest.mark.parametrize("rows", [0, 1, 999, 4000])
def test_logs_with_nothing_in_them(rows: int) -> None:
    made = teeter(Board(seed=1, **SHORT))
    nothing = Gyro(np.arange(rows) * 1000.0, np.zeros((rows, 3)))
    for pair in ((gyro(made.logs[0]), nothing), (nothing, gyro(made.logs[0])), (nothing, nothing)):
        found = compare(*pair)
        assert isinstance(found, Refused)
        assert "rows" in found.why if rows < 1000 else "too little rotation" in found.why


def test_radians_are_not_taken_for_degrees() -> None:
    first, second = map(gyro, teeter(Board(seed=1, **SHORT)).logs)
    radians = Gyro(second.time_us, np.radians(second.rate_dps))
    for pair, named in (((first, radians), "the second turned"), ((radians, first), "the first turned")):
        found = compare(*pair)
        assert isinstance(found, Refused)
        assert named in found.why
        assert "rad/s" in found.why


def test_two_boards_are_not_one() -> None:
    one, other = (teeter(Board(seed=seed, **SHORT)).logs[0] for seed in (1, 2))
    found = compare(gyro(one), gyro(other))
    assert isinstance(found, Refused)


def test_clocks_that_warm_up_bend_and_the_sigmas_know() -> None:
    made = teeter(Board(seed=3, seconds=60.0, impacts=12, warming_ppm=-20.0))
    found = compared(made)
    assert found.bend_ppm > 1
    assert found.sigma_us > 5
    assert abs(off_us(made, found)) < 2 * found.sigma_us
    assert abs(found.start_us - made.shift_us(0.0)) < 2 * found.start_sigma_us
    assert compared(teeter(Board(seed=3, **SHORT))).bend_ppm == 0


def test_a_hole_in_the_rows_is_left_out() -> None:
    made = teeter(Board(seed=3, **SHORT))
    first, second = map(gyro, made.logs)
    keep = np.ones(len(second.time_us), np.bool_)
    keep[5000:5300] = keep[9000:9001] = False
    found = compare(first, Gyro(second.time_us[keep], second.rate_dps[keep]))
    assert isinstance(found, Shift)
    assert abs(off_us(made, found)) < 3.5 * found.sigma_us


def test_between_samples() -> None:
    time_us = np.cumsum(np.random.default_rng(1).uniform(800, 1200, 400))
    samples = Samples(time_us, np.sin(time_us / 2000))
    at_us = np.linspace(time_us[10], time_us[-10], 999)
    assert np.abs(samples.at(at_us) - np.sin(at_us / 2000)).max() < 1e-4
    assert np.abs(samples.slope(at_us) * 2000 - np.cos(at_us / 2000)).max() < 1e-3
    assert np.isnan(samples.at(time_us[[0, -1]] + [-1, 1])).all()
    hole = Samples(np.delete(time_us, slice(200, 220)), np.delete(samples.value, slice(200, 220)))
    assert np.isnan(hole.at(time_us[[210]])).all()


def test_noise_becomes_white() -> None:
    random = np.random.default_rng(3)
    white = random.normal(0, 1, 20_000)
    colored = np.zeros(len(white))
    for k in range(2, len(white)):
        colored[k] = colored[k - 1] - 0.4 * colored[k - 2] + white[k]
    by = prediction(colored, np.ones(len(colored), np.bool_))
    left = np.convolve(colored, by)[20 : len(colored)]
    assert abs(np.corrcoef(left[1:], left[:-1])[0, 1]) < 0.1


@pytest.fixture
def board(tmp_path: Path) -> tuple[str, str]:
    made = teeter(Board(seed=3, **SHORT))
    for name, data in zip("ab", made.logs, strict=True):
        (tmp_path / name).write_bytes(data)
    return str(tmp_path / "a"), str(tmp_path / "b")


def test_the_command(board: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "gyro", *board, "--plot", str(tmp_path / "p.svg"), "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert (tmp_path / "p.svg").read_text(encoding="utf-8").startswith("<svg")
    assert abs(said["slope_ppm"] - 15) < 3.5 * said["slope_sigma_ppm"]
    assert abs(said["start_us"] - (20_000 - 5e6 * 15e-6)) < 3.5 * said["start_sigma_us"]
    assert said["counts_84_of_85"] is None
    # One shift for all, of a clock that runs on: it is coarse, but not far.
    assert abs(said["paper_us"] - said["shift_us"]) < 200
    assert len(said["paper_cases_us"]) == 4
    assert main(["sync", "gyro", *board]) == 0
    table = capsys.readouterr().out
    assert f"{said['shift_us']:+.1f} ± {said['sigma_us']:.1f} us" in table
    assert "paper's" in table


def test_wrong_input_of_the_command(board: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "gyro", board[0], board[0]]) == 2
    assert "given twice" in capsys.readouterr().err
    kept = tmp_path / "kept.svg"
    kept.write_text("mine")
    assert main(["sync", "gyro", *board, "--plot", str(kept)]) == 2
    assert kept.read_text() == "mine"
    rest = tmp_path / "rest"
    rest.write_bytes(teeter(Board(**{**SHORT, "impacts": 0}, rocking_dps=0.0)).logs[0])
    assert main(["sync", "gyro", board[0], str(rest), "--plot", str(tmp_path / "none.svg"), "--json"]) == 4
    said = capsys.readouterr()
    assert "too little rotation" in json.loads(said.out)["refused"]
    assert "too little rotation" in said.err
    assert not (tmp_path / "none.svg").exists()


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared logs are not here")
def test_flights_that_were_not_on_one_board(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "gyro", str(REAL / "jana00"), str(REAL / "jana20")]) == 4
    assert "one board" in capsys.readouterr().err
    swap = Path(DATA) / "usd-2019/swap-2"
    assert main(["sync", "gyro", str(swap / "cf50_02"), str(swap / "cf51_02")]) == 4
    assert "one board" in capsys.readouterr().err
    assert main(["sync", "gyro", str(REAL / "jana00"), str(REAL / "hole-1.5s")]) == 4
    assert "no gyro" in capsys.readouterr().err
