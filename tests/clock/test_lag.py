"""How late a log's attitudes are, by its gyro: simulated flights whose lags are known, and real ones."""

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from host.cli import main
from host.clock.gyro import Gyro, Refused
from host.clock.jackknife import left_out
from host.clock.lag import Attitudes, Lag, lag_of
from host.usd.decode import decode
from sim.pose_log import Flight, pose_log

DATA = os.environ.get("SPINDECK_DATA", str(Path(__file__).resolve().parents[3] / "shared/data"))
REAL = Path(DATA) / "usd/flights"
"""Logs of real robots, which are not part of the project."""


def read(data: bytes) -> tuple[Gyro, Attitudes, Attitudes]:
    """The gyro, motion capture's and the estimator's attitudes."""
    log = decode(data)
    assert log.is_whole
    fixed, told = log.rows["fixedFrequency"], log.rows["estPose"]
    rate = np.stack([fixed.data[f"gyro.{axis}"].astype(np.float64) for axis in "xyz"], axis=1)
    time_us = fixed.stamp_us.astype(np.float64)
    mocap, estimate = (
        np.stack([rows.data[f"{group}.q{axis}"].astype(np.float64) for axis in "xyzw"], axis=1)
        for rows, group in ((told, "locSrv"), (fixed, "stateEstimate"))
    )
    return Gyro(time_us, rate), Attitudes(told.stamp_us.astype(np.float64), mocap), Attitudes(time_us, estimate)


def known(flight: Flight, found: Lag | Refused) -> Lag:
    assert isinstance(found, Lag), f"{found} of {flight}"
    return found


@pytest.mark.parametrize("lag_us", [0.0, 4_321.0, 12_000.0, 30_000.0])
def test_known_lags(lag_us: float) -> None:
    flight = Flight(seed=int(lag_us), seconds=10, mocap_lag_us=lag_us, estimate_lag_us=lag_us / 2)
    gyro, mocap, estimate = read(pose_log(flight))
    late = known(flight, lag_of(mocap, gyro))
    assert late.sigma_us < 70
    assert abs(late.behind_motion_us - lag_us - flight.mocap_jitter_us / 2) < 3.5 * late.sigma_us
    # The gyro's gain is 1.01, and its bias drops out.
    assert abs(late.gain - 1 / flight.gain) < 0.005
    assert np.abs(np.array(late.mount_deg) - flight.mount_deg).max() < 0.2
    assert late.noise_deg == pytest.approx(flight.mocap_noise_deg, rel=0.1)
    own = known(flight, lag_of(estimate, gyro))
    assert own.sigma_us < 30
    assert abs(own.behind_motion_us - lag_us / 2) < 3.5 * own.sigma_us


def test_the_stated_sigma_is_true() -> None:
    """One that is 1.5 times too small, or too large, fails: 16 draws of noise in one flight."""
    flight = Flight(seed=4, seconds=12, mocap_noise_deg=0, mocap_jitter_us=0, gyro_noise_dps=0)
    gyro, mocap, _ = read(pose_log(flight))
    random, away, turns = np.random.default_rng(4), [], Rotation.from_quat(mocap.attitude)
    for _ in range(16):
        noisy = turns * Rotation.from_rotvec(random.normal(0, np.radians(0.05), (len(turns), 3)))
        rates = gyro.rate_dps + random.normal(0, 0.12, gyro.rate_dps.shape)
        found = known(flight, lag_of(Attitudes(mocap.time_us, noisy.as_quat()), Gyro(gyro.time_us, rates)))
        away.append((found.behind_motion_us - flight.mocap_lag_us) / found.sigma_us)
    assert 0.75 < np.sqrt(np.mean(np.square(away))) < 1.25, away


def test_a_mount_that_is_askew_is_no_lag() -> None:
    """Without noise. What is not linear in the angle counts too."""
    flight = Flight(seed=6, seconds=12, mount_deg=3.0, mocap_noise_deg=0, mocap_jitter_us=0, gyro_noise_dps=0)
    gyro, mocap, _ = read(pose_log(flight))
    found = known(flight, lag_of(mocap, gyro))
    assert abs(found.behind_motion_us - 12_000) < 5
    assert found.mount_deg == pytest.approx((3, 3, 3), abs=0.05)


def test_against_another_estimator() -> None:
    """How fast motion capture turns between poses, about the axis that turns most, against the gyro's mean in the same
    time, shifted by 1 ms steps; and a parabola through the best three."""
    flight = Flight(seed=5, seconds=20, mocap_noise_deg=0.02, lost=0.0, mocap_jitter_us=0.0, mount_deg=0.0)
    gyro, mocap, _ = read(pose_log(flight))
    turns = Rotation.from_quat(mocap.attitude)
    step_us = np.diff(mocap.time_us)
    told = (turns[:-1].inv() * turns[1:]).as_rotvec()[:, 2] / step_us
    angle = np.concatenate([[0], np.cumsum(np.radians(gyro.rate_dps[:-1, 2]) * np.diff(gyro.time_us))])
    lags_us = np.arange(0, 15_000.0, 1000.0)
    alike = []
    for each in lags_us:
        there = np.interp(mocap.time_us - each, gyro.time_us, angle)
        alike.append(np.corrcoef(told[5:-5], (np.diff(there) / step_us)[5:-5])[0, 1])
    best = int(np.argmax(alike))
    bend = np.polyfit(lags_us[best - 1 : best + 2], alike[best - 1 : best + 2], 2)
    found = known(flight, lag_of(mocap, gyro))
    # A row's rate there holds until the next one; so it takes the gyro to be 1 ms later.
    assert abs(found.lag_us - (-bend[1] / (2 * bend[0]) + 1000)) < 300


@pytest.mark.parametrize("motion", ["still", "spin"])
def test_refused_with_a_reason(motion: str) -> None:
    gyro, mocap, estimate = read(pose_log(Flight(motion=motion, seconds=8)))  # type: ignore[arg-type]
    for each in (mocap, estimate):
        found = lag_of(each, gyro)
        assert isinstance(found, Refused)
        assert "too little rotation" in found.why


def test_attitudes_of_another_flight() -> None:
    gyro, _, _ = read(pose_log(Flight(seed=1, seconds=8)))
    _, mocap, _ = read(pose_log(Flight(seed=2, seconds=8)))
    found = lag_of(mocap, gyro)
    assert isinstance(found, Refused)
    elsewhere = lag_of(Attitudes(mocap.time_us + 1e9, mocap.attitude), gyro)
    assert isinstance(elsewhere, Refused)
    assert "same time" in elsewhere.why


def test_a_gyro_that_was_never_logged_right() -> None:
    """All zeros, as a firmware without the sensor has it."""
    gyro, mocap, _ = read(pose_log(Flight(seed=1, seconds=8)))
    for rate in (np.zeros_like(gyro.rate_dps), np.full_like(gyro.rate_dps, 2000.0)):
        found = lag_of(mocap, Gyro(gyro.time_us, rate))
        assert isinstance(found, Refused)
    assert isinstance(lag_of(Attitudes(np.zeros(0), np.zeros((0, 4))), gyro), Refused)


def test_a_gyro_in_radians() -> None:
    gyro, mocap, _ = read(pose_log(Flight(seed=1, seconds=8)))
    found = lag_of(mocap, Gyro(gyro.time_us, np.radians(gyro.rate_dps)))
    assert isinstance(found, Refused)
    assert "rad/s" in found.why


def test_wrong_poses_and_gaps_are_left_out() -> None:
    flight = Flight(seed=3, seconds=12)
    gyro, mocap, _ = read(pose_log(flight))
    attitude = mocap.attitude.copy()
    attitude[100:1000:60] = [0.5, 0.5, 0.5, 0.5]
    attitude[7] = np.nan
    keep = np.ones(len(gyro.time_us), np.bool_)
    keep[2000:2400] = False
    found = known(flight, lag_of(Attitudes(mocap.time_us, attitude), Gyro(gyro.time_us[keep], gyro.rate_dps[keep])))
    assert found.outliers >= 10
    assert abs(found.behind_motion_us - 12_150) < 3.5 * found.sigma_us


def test_jackknife_of_a_mean_is_the_textbook_one() -> None:
    values = np.random.default_rng(1).normal(3, 2, 50)
    found = left_out(np.ones((50, 1)), values - values.mean(), np.arange(50))
    assert found.spread[0, 0] == pytest.approx(values.var(ddof=1) / 50)


@pytest.fixture
def log(tmp_path: Path) -> str:
    path = tmp_path / "log00"
    path.write_bytes(pose_log(Flight(seed=2, seconds=10)))
    return str(path)


def test_the_command(log: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "mocap", log, "--json", "--plot", str(tmp_path / "lag.svg")]) == 0
    mocap, estimate = (json.loads(each) for each in capsys.readouterr().out.splitlines())
    assert (mocap["source"], estimate["source"]) == ("estPose:locSrv", "fixedFrequency:stateEstimate")
    assert abs(mocap["lag_us"] - 12_150) < 3.5 * mocap["sigma_us"]
    assert abs(estimate["lag_us"] - 6_000) < 3.5 * estimate["sigma_us"]
    assert (tmp_path / "lag.svg").read_text(encoding="utf-8").startswith("<svg")
    one = tmp_path / "one.svg"
    assert main(["sync", "mocap", log, "--source", "estPose", "--plot", str(one)]) == 0
    said = capsys.readouterr().out
    both, alone = ((tmp_path / name).read_text().split('height="')[1].split('"')[0] for name in ("lag.svg", "one.svg"))
    assert int(alone) < int(both)  # no room for a panel that is not there
    told = re.search(r"--lag-us (\d+)±(\d+)", said)
    assert told
    assert [float(each) for each in told.groups()] == pytest.approx([mocap["lag_us"], mocap["sigma_us"]], abs=0.6)
    assert "stateEstimate" not in said


def test_what_the_command_refuses(tmp_path: Path, log: str, capsys: pytest.CaptureFixture[str]) -> None:
    still = tmp_path / "still"
    still.write_bytes(pose_log(Flight(motion="still", seconds=8)))
    assert main(["sync", "mocap", str(still), "--plot", str(tmp_path / "none.svg")]) == 4
    said = capsys.readouterr()
    assert "too little rotation" in said.err
    assert said.err.count("\n") == 1
    assert not said.out
    assert not (tmp_path / "none.svg").exists()
    assert main(["sync", "mocap", log, "--source", "acc"]) == 2
    assert "no position or attitude" in capsys.readouterr().err


def test_annotations_know_the_lag(log: str, capsys: pytest.CaptureFixture[str]) -> None:
    """The pose of a time is found in rows that are stamped later, and may be off by so much more."""
    ask = ["usd", "interpolate", log, "--source", "estPose", "--row-error-us", "0", "--json"]
    answers = []
    for at, *more in (
        ["17012150"],
        ["17000000", "--lag-us", "12150±0"],
        ["17000000", "--lag-us", "12150+-100"],
        ["17000000", "--time-error-us", "300", "--lag-us", "12150"],
    ):
        assert main([*ask, "--at", at, *more]) == 0
        answers.append(json.loads(capsys.readouterr().out))
    attitudes = [[each[f"q{axis}"] for axis in "xyzw"] for each in answers]
    assert attitudes[0] == attitudes[1] == attitudes[2]
    assert answers[1]["stamp_stm32_us"] == 17_000_000
    errors = [each["attitude_error_rad"] for each in answers]
    assert errors[0] == errors[1] < errors[2] == errors[3]
    assert main([*ask, "--at", "17000000", "--lag-us", "12 ms"]) == 2
    assert "6500±400" in capsys.readouterr().err


@pytest.mark.skipif(not REAL.is_dir(), reason="the shared logs are not here")
def test_real_flights(capsys: pytest.CaptureFixture[str]) -> None:
    """Motion capture comes some ms late; a flight that hardly turned is refused. The clock counts 84 where 85 have
    passed, so the gyro's integral is 1.2 % too small, if its own gain is right."""
    for name in ("jana00", "eckart12"):
        assert main(["sync", "mocap", str(REAL / name), "--source", "estPose", "--json"]) == 0
        said = json.loads(capsys.readouterr().out)
        assert 3_000 < said["lag_us"] < 9_000
        assert said["sigma_us"] < 1_500
        assert 1 < said["gain"] < 1.03
    assert main(["sync", "mocap", str(REAL / "jana20"), "--source", "estPose"]) == 4
    assert "too little rotation" in capsys.readouterr().err
