"""What is found in logs of real robots, against what is known of them, and in made ones against what was made."""

import numpy as np
import pytest
from logs import FIXED, VERSION_2, VERSION_2019, Writer, fill, real

from host.usd.decode import decode
from host.usd.examine import examine
from host.usd.log import Log


@pytest.mark.parametrize("name", ["flights/eckart12", "flights/jana00", "flights/jana20"])
def test_mocap_at_100_hz_betrays_the_clock(name: str) -> None:
    """It arrives every 9.885 to 9.890 ms of the STM32's time."""
    periods = {each.type: each for each in examine(decode(real(name))).periods}
    pose = periods["estPose"]
    assert pose.nominal_hz == 100
    assert 9885 <= round(pose.interval_us) <= 9890
    assert pose.error_us < 0.5
    assert pose.is_slow
    assert pose.is_clear


@pytest.mark.parametrize("name", [*VERSION_2, *VERSION_2019])
def test_every_robots_clock_is_slow(name: str) -> None:
    """All flew with firmware before the fix; what the gyro's own oscillator paces is off by tenths of a percent."""
    periods = examine(decode(real(name))).periods
    assert periods
    assert all(each.is_slow and each.is_clear for each in periods)


@pytest.mark.parametrize(("tick_us", "slow"), [(1000, False), (1000 * 84 / 85, True)])
def test_a_made_clock(tick_us: float, slow: bool) -> None:
    rng = np.random.default_rng(1)
    log = Writer()
    for number in range(2000):
        if rng.random() < 0.8:  # Rows that are missing do not matter.
            log.row(FIXED, round(1e6 + number * tick_us + rng.normal(0, 30)), 0, 0, 0)
    (period,) = examine(decode(log.close())).periods
    assert period.is_slow == slow
    assert abs(period.interval_us - tick_us) < max(4 * period.error_us, 0.02)


def test_events_at_random_have_no_period() -> None:
    rng = np.random.default_rng(1)
    log = Writer()
    for stamp in np.sort(rng.integers(0, 10**7, 1000)).tolist():
        log.row(FIXED, stamp + 1, 0, 0, 0)
    found = examine(decode(log.close()))
    assert (found.periods, found.holes) == ((), ())


def test_the_hole_of_one_and_a_half_seconds() -> None:
    (hole,) = examine(decode(real("flights/hole-1.5s"))).holes
    assert 1.5e6 < hole.to_us - hole.from_us < 1.53e6
    assert 375 <= hole.rows <= 390


def test_holes_are_found_where_they_are() -> None:
    log = fill(Writer(), seed=1, rows=100)
    fill(log, seed=2, rows=100, start_us=5_110_000)
    (hole,) = examine(decode(log.close())).holes
    assert (hole.type, hole.epoch, hole.rows) == ("fixedFrequency", 0, 10)
    assert 5_099_000 <= hole.from_us < 5_099_020
    assert 5_110_000 <= hole.to_us < 5_110_020


def test_a_reset_is_no_hole() -> None:
    log = fill(Writer(), seed=1, rows=100)
    fill(log, seed=2, rows=100, start_us=0)
    assert examine(decode(log.close())).holes == ()


def test_drops_are_between_two_status_rows() -> None:
    log = fill(Writer(session=5), seed=1, rows=100)
    log.dropped = 17
    fill(log, seed=2, rows=100, start_us=5_100_000)
    found = examine(decode(log.close()))
    assert found.counters is not None
    assert found.counters.dropped == 17
    (drop,) = found.drops
    assert drop.rows == 17
    assert drop.from_us < 5_100_000 < drop.to_us


def test_rows_out_of_order_are_counted() -> None:
    log = Writer()
    for stamp in (1000, 2000, 1900, 3000):
        log.row(FIXED, stamp, 0, 0, 0)
    assert examine(decode(log.close())).disorder == {"fixedFrequency": 1}


def broadcasts(log: Log) -> dict[tuple[float, ...], int]:
    """When each pose of the payload was first there. All robots hear the same broadcasts."""
    rows = log.rows["fixedFrequency"]
    poses = np.stack([rows.data[f"stateEstimate.p{axis}"] for axis in "xyz"], axis=1)
    changed = np.flatnonzero((np.diff(poses, axis=0) != 0).any(axis=1)) + 1
    return {tuple(poses[at].tolist()): int(rows.stamp_us[at]) for at in reversed(changed)}


@pytest.mark.parametrize(
    ("one", "other", "ppm", "within"),
    [("cf231_00", "cf5_00", 54.0, 4.5), ("cf231_00", "cf6_00", 237.1, 4.6), ("cf5_00", "cf6_00", 183.3, 4.4)],
)
def test_three_robots_that_heard_the_same(one: str, other: str, ppm: float, within: float) -> None:
    """Their clocks' drift, as it was found independently."""
    ours, theirs = (broadcasts(decode(real(f"sync-3-robots/{name}"))) for name in (one, other))
    pairs = np.array([(ours[pose], theirs[pose]) for pose in ours.keys() & theirs.keys()], np.float64)
    assert len(pairs) > 500
    away = pairs[:, 1] - pairs[:, 0]
    pairs = pairs[np.abs(away - np.median(away)) < 20_000]
    slope = np.polyfit(pairs[:, 0] - pairs[0, 0], pairs[:, 1] - pairs[:, 0], 1)[0]
    assert abs(abs(slope) * 1e6 - ppm) < 2 * within


def test_two_robots_that_swapped_places() -> None:
    """59.9 s; never nearer than 0.20 m."""
    logs = [decode(real(f"swap-2/{name}_02")).rows["fixedFrequency"] for name in ("cf50", "cf51")]
    assert round((int(logs[0].stamp_us[-1]) - int(logs[0].stamp_us[0])) / 1e6, 1) == 59.9
    first = np.stack([logs[0].data[f"stateEstimateZ.{axis}"] / 1000 for axis in "xyz"])
    times = [rows.stamp_us.astype(float) for rows in logs]
    columns = [logs[1].data[f"stateEstimateZ.{axis}"] / 1000 for axis in "xyz"]
    second = np.stack([np.interp(times[0], times[1], column) for column in columns])
    distance = np.sqrt(((first - second) ** 2).sum(axis=0))
    assert 0.19 < distance.min() < 0.21
