"""Ends of frames from readings that are late, against the truth."""

import numpy as np
import pytest
from models import RTC_US, Link, run
from track import tracked

from host.clock.frame_ends import Readings, frame_ends
from host.clock.stamps import Stamped, stamp

PERIOD_US = 33_333.0


def readings(count: int, latency_us: float = 93.0) -> Readings:
    """As a robot says it: the first frames alone, the others by their pace."""
    told = np.where(np.arange(count) < 8, latency_us, latency_us / 10)
    return Readings(np.arange(count), np.zeros(count, np.int64), told)


def late(count: int, seed: int, mean_us: float = 20.0) -> tuple[np.ndarray, np.ndarray]:
    """True ends, and readings of them."""
    true_us = 1e6 + PERIOD_US * np.arange(count)
    return true_us, np.floor(true_us + np.random.default_rng(seed).exponential(mean_us, count)).astype(np.int64)


@pytest.mark.parametrize(
    ("link", "p95_us"),
    [
        (Link("typ", seconds=120), 3),
        (Link("presc85", seconds=120, gap8_tick_us=RTC_US), 7),
        (Link("rcbad", seconds=120), 8),
        (Link("presc85", seconds=120, gap8_tick_us=1000), 180),
    ],
    ids=["fine", "rtc", "rcbad", "1ms"],
)
@pytest.mark.parametrize("latency_us", [20.0, 100.0])
def test_with_messages_and_what_the_robot_says(link: Link, p95_us: float, latency_us: float) -> None:
    made = run(Link(**{**vars(link), "latency_us": latency_us}), 5)
    own = tracked(made, link.gap8_tick_us, latency_us=int(latency_us * 4.6) + 1)
    count = len(made.frame_gap8_us)
    told = Readings(
        np.arange(count), np.zeros(count, np.int64), np.where(own.given, own.times["latency_us"].astype(float), np.nan)
    )
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    got: Stamped = stamp(stm32, gap8, frames, made.frame_after, readings=told)
    error = np.abs(got.stm32_us - made.frame_true_us)
    assert got.ends.paced.mean() > 0.995
    assert np.quantile(error, 0.95) <= p95_us
    assert (error <= got.bound_us).mean() >= 0.985
    blind = stamp(stm32, gap8, frames, made.frame_after)
    assert (blind.stm32_us - made.frame_true_us).mean() == pytest.approx(latency_us, abs=0.15 * latency_us + p95_us)


def test_another_pace_and_other_settings_and_another_boot_begin_anew() -> None:
    covered = []
    for seed in range(10):
        true_us, read_us = late(600, seed)
        shift = np.repeat([0, 5_000_000, 5_700_123, 0], 150)
        true_us, read_us = true_us + shift, read_us + shift
        told = readings(600)
        mode, boot = np.repeat([0, 1, 1, 1], 150), np.repeat([0, 0, 0, 1], 150)
        got = frame_ends(read_us, boot, Readings(told.number, mode, told.latency_us), 1.0)
        # One reading in 10,000 may be too late for chance.
        assert got.paced.mean() > 0.99, seed
        error = np.abs(got.gap8_us - true_us)
        assert error[got.paced].max() < 12, seed
        covered.append((error <= got.bound_us).mean())
    assert np.mean(covered) > 0.985


def test_missing_frames_are_counted() -> None:
    true_us, read_us = late(900, 2)
    here = np.random.default_rng(3).random(900) < 0.4
    told = readings(900)
    got = frame_ends(read_us[here], np.zeros(here.sum(), np.int64),
                     Readings(told.number[here], told.mode[here], told.latency_us[here]), 1.0)  # fmt: skip
    assert got.paced.all()
    assert np.abs(got.gap8_us - true_us[here]).max() < 8


def test_a_frame_that_began_late_keeps_its_own_reading() -> None:
    _, read_us = late(400, 4)
    read_us[123] += 900
    got = frame_ends(read_us, np.zeros(400, np.int64), readings(400), 1.0)
    assert np.flatnonzero(~got.paced).tolist() == [123]
    assert got.gap8_us[123] == read_us[123] + 0.5
    assert got.bound_us[123] == 93.5


@pytest.mark.parametrize("latency_us", [93.0, 0.0])
def test_without_a_pace_readings_stay_and_the_bound_says_so(latency_us: float) -> None:
    _, read_us = late(400, 5)
    told = Readings(np.arange(400), np.zeros(400, np.int64), np.full(400, latency_us))
    got = frame_ends(read_us, np.zeros(400, np.int64), told, 1.0)
    assert not got.paced.any()
    assert np.array_equal(got.gap8_us, read_us + 0.5)
    assert set(got.bound_us) == {latency_us + 0.5}


def test_fewer_than_eight_frames_have_no_pace() -> None:
    _, read_us = late(7, 6)
    got = frame_ends(
        read_us, np.zeros(7, np.int64), Readings(np.arange(7), np.zeros(7, np.int64), np.full(7, 93.0)), 1.0
    )
    assert not got.paced.any()
    assert set(got.bound_us) == {93.5}


@pytest.mark.parametrize("count", [10, 20, 49])
def test_few_frames_have_a_line(count: int) -> None:
    errors, bounds = [], []
    for seed in range(60):
        true_us, read_us = late(count, seed)
        got = frame_ends(read_us, np.zeros(count, np.int64), readings(count), 1.0)
        errors.append(np.abs(got.gap8_us - true_us))
        bounds.append(got.bound_us)
    error, bound = np.concatenate(errors), np.concatenate(bounds)
    assert (error <= bound).mean() > 0.985
    assert np.median(bound) < 20 * 15 / count + 1
    assert np.median(error) < 20 * 2.5 / count + 0.5


@pytest.mark.parametrize(("count", "more_us"), [(60, 500), (60, -500), (60, 60), (600, 500), (600, -500), (600, -20)])
def test_a_period_that_changes_a_little_begins_another_pace(more_us: float, count: int) -> None:
    covered, bounds = [], []
    for seed in range(10):
        place = count // 3 + seed
        true_us, read_us = late(count, seed)
        shift = np.round(more_us * np.maximum(np.arange(count) - place, 0)).astype(np.int64)
        got = frame_ends(read_us + shift, np.zeros(count, np.int64), readings(count), 1.0)
        covered.append(np.abs(got.gap8_us - true_us - shift) <= got.bound_us)
        bounds.append(got.bound_us)
    assert np.mean(covered) > 0.985
    assert np.median(np.concatenate(bounds)) < (20 if count == 60 else 8)
    assert np.max(bounds) < 120
