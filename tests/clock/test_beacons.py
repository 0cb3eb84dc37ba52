"""Robots against the host's clock by beacons, and against each other. SPINDECK_CLOCK_SEEDS=20 tries more seeds."""

import os
from dataclasses import replace

import numpy as np
import pytest
from radio_models import Radio, Robot, fleet

from host.clock.beacons import BEACONS_MIN, Against, Beacons, against_host, between, collect, recent

SEEDS = range(int(os.environ.get("SPINDECK_CLOCK_SEEDS", "3")))
RADIO = Radio()


def noted(robot: Robot) -> Beacons:
    return collect(robot.sequence, robot.host_us, robot.local_us)


def fitted(robot: Robot) -> Against:
    found = against_host(noted(robot))
    assert found is not None
    return found


def error_us(pair: list[Robot], fits: list[Against], at_us: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    (here, here_bound), (there, there_bound) = (fit.at(at_us) for fit in fits)
    truth = pair[1].clock(at_us) - pair[0].clock(at_us)
    return np.abs(there - here - truth), np.hypot(here_bound, there_bound)


@pytest.mark.parametrize("divider", [84, 85])
def test_two_robots_for_half_an_hour(divider: int) -> None:
    errors, bounds = [], []
    for seed in SEEDS:
        pair = fleet(replace(RADIO, divider=divider), seed)
        fits = [fitted(each) for each in pair]
        assert [(each.is_slow, each.is_clear) for each in fits] == [(divider == 84, True)] * 2, f"seed {seed}"
        error, bound = error_us(pair, fits, np.linspace(pair[0].host_us[0] + 3e6, pair[0].host_us[-1] - 3e6, 500))
        errors.append(error)
        bounds.append(bound)
    error, bound = np.concatenate(errors), np.concatenate(bounds)
    assert np.quantile(error, 0.95) <= 20
    assert (error <= bound).mean() >= 0.985
    assert np.median(bound) < 50


def test_as_it_is_known_while_beacons_come() -> None:
    errors, bounds = [], []
    for seed in SEEDS:
        pair = fleet(RADIO, seed)
        for now_us in pair[0].host_us[0] + np.arange(100e6, 1790e6, 130e6):
            fits = []
            for each in pair:
                so_far = each.host_us < now_us
                known = collect(each.sequence[so_far], each.host_us[so_far], each.local_us[so_far])
                fit = against_host(recent(known))
                assert fit is not None
                assert len(fit.beacons) <= 180
                fits.append(fit)
            error, bound = error_us(pair, fits, np.array([now_us]))
            errors.append(error)
            bounds.append(bound)
    error, bound = np.concatenate(errors), np.concatenate(bounds)
    assert np.quantile(error, 0.95) <= 100
    assert (error <= bound).mean() >= 0.985


def test_slope_and_offset_of_a_pair() -> None:
    for seed in SEEDS:
        pair = fleet(RADIO, seed)
        found = between(0, 1, *(fitted(each) for each in pair))
        assert found is not None
        ends = np.array([pair[0].host_us[0], pair[0].host_us[-1]], np.float64)
        first, second = (np.diff(each.clock(ends))[0] for each in pair)
        assert abs(found.slope_ppm - (second / first - 1) * 1e6) <= found.slope_bound_ppm < 1, f"seed {seed}"
        assert abs(fitted(pair[0]).drift_ppm - (first / np.diff(ends)[0] - 1) * 1e6) < 0.1
        moments = np.linspace(*ends, 100_001)
        at = moments[np.argmin(np.abs(pair[0].clock(moments) - found.at_us))]
        assert abs(found.offset_us - (pair[1].clock(at) - pair[0].clock(at))) <= found.bound_us + 5
        assert found.bound_us <= found.worst_us
        assert found.common == len(np.intersect1d(pair[0].host_us, pair[1].host_us))


def test_repeats_and_loss_of_a_minute() -> None:
    """What comes again counts once; where nothing came the bound grows, and holds."""
    pair = fleet(replace(RADIO, seconds=600.0, repeats=3), 5)
    silent = [replace_rows(each, (each.sequence < 300) | (each.sequence >= 340)) for each in pair]
    fits = [fitted(each) for each in silent]
    assert all(len(np.unique(fit.beacons.host_us)) == len(fit.beacons) for fit in fits)
    assert all(fit.beacons.repeated > len(fit.beacons) for fit in fits)
    start = pair[0].host_us[0]
    error, bound = error_us(pair, fits, start + np.array([150e6, 320e6]))
    assert (error <= bound).all()
    assert bound[1] > bound[0]
    far = fits[0].at(np.array([start - 61e6, start + 661e6]))[1]
    assert np.isinf(far).all()


def test_a_host_that_started_anew_and_nonsense() -> None:
    """The longest run of the host is kept whole; what is not of it is counted."""
    robot = fleet(replace(RADIO, seconds=400.0), 6)[0]
    host_us, sequence = robot.host_us.copy(), robot.sequence.copy()
    late = robot.sequence >= 300
    sequence[late] -= 300
    host_us[late] -= 900_000_000
    host_us[50] += 7_000_000_000
    host_us[100] = 0
    host_us[[150, 151]] = 2**63 - 1, -(2**63)
    with np.errstate(all="raise"):
        kept = collect(sequence, host_us, robot.local_us)
    assert len(kept) == (~late).sum() - 4
    assert kept.other_runs == late.sum() + 4
    assert (np.diff(kept.host_us) > 0).all()


def test_numbers_that_wrap_and_clocks_that_glitch() -> None:
    """A timer's interrupt that comes late makes a reading wrong by 65.536 ms, once."""
    pair = fleet(replace(RADIO, seconds=900.0), 8)
    robot = pair[0]
    local_us = robot.local_us.copy()
    local_us[[40, 200, 500]] += np.array([-65_536, 65_536, -65_536])
    wrapped = Robot((robot.sequence + 2**32 - 300) % 2**32, robot.host_us, local_us, robot.clock)
    clean, found = fitted(robot), fitted(wrapped)
    assert len(found.beacons) == len(clean.beacons)
    missing = robot.sequence[-1] - robot.sequence[0] + 1 - len(robot.sequence)
    assert found.beacons.lost == clean.beacons.lost == missing
    error, bound = error_us(pair, [found, fitted(pair[1])], np.linspace(robot.host_us[0] + 3e6, robot.host_us[-1], 300))
    assert (error <= bound).mean() > 0.985
    assert np.median(bound) < 60


@pytest.mark.parametrize("count", [0, 1, 2, BEACONS_MIN - 1])
def test_too_few(count: int) -> None:
    robot = fleet(RADIO, 1)[0]
    few = noted(replace_rows(robot, np.arange(len(robot.sequence)) < count))
    assert against_host(few) is None
    assert len(recent(few)) == len(few)


def test_robots_that_never_heard_the_same() -> None:
    pair = fleet(replace(RADIO, seconds=300.0), 2)
    half = pair[0].sequence < 150, pair[1].sequence >= 150
    early, late = (fitted(replace_rows(each, kept)) for each, kept in zip(pair, half, strict=True))
    assert between(0, 1, early, late) is None


def replace_rows(robot: Robot, kept: np.ndarray) -> Robot:
    return Robot(robot.sequence[kept], robot.host_us[kept], robot.local_us[kept], robot.clock)
