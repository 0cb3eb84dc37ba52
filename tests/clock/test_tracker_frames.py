"""How late a frame's end was read: what firmware/core/clock_frames.c finds out from frames of one rate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import RTC_US, Link, Run, run
from track import Tracked, tracked

SECONDS = 60


def told(latency_us: float) -> int:
    """99 % of exponential latencies of that mean are less."""
    return int(np.ceil(latency_us * np.log(100)))


def settled(found: Tracked) -> tuple[np.ndarray, np.ndarray]:
    later = found.given & (found.at_s > 15)
    return found.error_us[later], found.times["bound_us"][later]


def chosen(made: Run, frames: np.ndarray) -> Run:
    return replace(
        made,
        frame_gap8_us=made.frame_gap8_us[frames],
        frame_true_us=made.frame_true_us[frames],
        frame_us=made.frame_us[frames],
    )


@pytest.mark.parametrize(
    ("latency_us", "tick_us", "fps", "p95_us", "bound_us"),
    [
        (20, 1, 30, 5, 20),
        (20, 1, 10, 6, 20),
        (300, 1, 30, 60, 90),
        (20, RTC_US, 30, 15, 80),
        (20, RTC_US, 10, 15, 80),
        (100, RTC_US, 30, 25, 100),
    ],
)
def test_latency_is_found_and_taken_off(
    latency_us: float, tick_us: float, fps: float, p95_us: float, bound_us: float
) -> None:
    link = Link("typ", 200, SECONDS, gap8_tick_us=tick_us, fps=fps, latency_us=latency_us)
    for seed in range(3):
        error, bound = settled(tracked(run(link, seed), tick_us, latency_us=told(latency_us)))
        assert np.percentile(np.abs(error), 95) <= p95_us, seed
        assert np.median(bound) <= bound_us, seed
        assert (np.abs(error) <= bound).mean() >= 0.985, seed


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_frames_that_are_missing_do_no_harm(share: float) -> None:
    made = run(Link("typ", 200, SECONDS, latency_us=50), 1)
    here = np.random.default_rng(1).random(len(made.frame_us)) >= share
    error, bound = settled(tracked(chosen(made, here), latency_us=told(50)))
    assert np.percentile(np.abs(error), 95) <= 10
    assert (np.abs(error) <= bound).mean() >= 0.985


def test_frames_of_no_rate_have_all_of_the_latency_in_their_bound() -> None:
    made = run(Link("typ", 200, SECONDS, latency_us=50), 2)
    found = tracked(made, latency_us=told(50), regular=False)
    error, bound = settled(found)
    assert np.median(error) == pytest.approx(50 * np.log(2), abs=5)
    assert (np.abs(error) <= bound).mean() >= 0.985
    assert (found.times["latency_us"][found.given] == told(50)).all()


def test_frames_that_are_said_to_be_regular_and_are_not() -> None:
    """Any pause between frames: no line through them is believed."""
    made = run(Link("typ", 200, SECONDS, fps=100, latency_us=50), 3)
    random = np.random.default_rng(3)
    error, bound = settled(tracked(chosen(made, random.random(len(made.frame_us)) < 0.3), latency_us=told(50)))
    assert (np.abs(error) <= bound).mean() >= 0.985
    jittered = run(Link("typ", 200, SECONDS), 3)
    off_us = np.cumsum(random.normal(0, 2_000, len(jittered.frame_us)))
    moved = replace(
        jittered,
        frame_gap8_us=jittered.frame_gap8_us + off_us.astype(np.int64),
        frame_true_us=jittered.frame_true_us + off_us.astype(np.int64) / (1 - 65e-6),
        frame_us=jittered.frame_us + off_us,
    )
    error, bound = settled(tracked(moved, latency_us=told(50)))
    assert (np.abs(error) <= bound).mean() >= 0.985


def test_a_rate_that_changes_is_learnt_anew() -> None:
    made = run(Link("typ", 200, SECONDS, fps=60, latency_us=50), 4)
    half = len(made.frame_us) // 2
    thinned = np.arange(len(made.frame_us)) % 2 == 0
    thinned[:half] = True
    shifted = replace(made, frame_gap8_us=made.frame_gap8_us.copy(), frame_true_us=made.frame_true_us.copy())
    shifted.frame_gap8_us[half:] += 5_000
    shifted.frame_true_us[half:] += 5_000 / (1 - 65e-6)
    error, bound = settled(tracked(chosen(shifted, thinned), latency_us=told(50)))
    assert np.percentile(np.abs(error), 95) <= 10
    assert (np.abs(error) <= bound).mean() >= 0.985


def test_a_clock_that_wraps_changes_nothing() -> None:
    made = run(Link("typ", 200, 40, latency_us=50), 5)
    plus = (1 << 32) - 20_000_000 - int(made.gap8_us[0])
    plain = tracked(made, latency_us=told(50))
    wrapped = tracked(made, latency_us=told(50), bits=32, gap8_plus=plus)
    assert (wrapped.times["bound_us"] == plain.times["bound_us"]).all()
    assert np.allclose(wrapped.error_us, plain.error_us, equal_nan=True, atol=1e-6)
