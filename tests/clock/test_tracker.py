"""The online tracker of firmware/core/clock.h: how good it is without faults, and what it says with next to nothing.

benchmarks/clock.py prints the same figures from longer runs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from models import RTC_US, Link, run, silence, stm32_leap, take
from track import Tracked, tracked

from host.native import ffi, lib

SECONDS = 60
REFUSED = lib.FRAME_REFUSED


def results(link: Link, seeds: int = 3) -> list[Tracked]:
    return [tracked(run(link, seed), link.gap8_tick_us) for seed in range(seeds)]


def settled_us(found: list[Tracked]) -> np.ndarray:
    return np.concatenate([each.error_us[(each.at_s > 20) & each.given] for each in found])


def shares(found: list[Tracked]) -> tuple[float, float, float]:
    """Of frames after the first second: covered, flagged; and the median bound in us."""
    later = [each.at_s > 1 for each in found]
    covered = np.concatenate([each.covered[one & each.given] for each, one in zip(found, later, strict=True)])
    flagged = np.concatenate([each.flagged[one] for each, one in zip(found, later, strict=True)])
    bound = np.concatenate([each.times["bound_us"][one & each.given] for each, one in zip(found, later, strict=True)])
    return covered.mean(), flagged.mean(), float(np.median(bound))


@pytest.mark.parametrize("mu_us", [50, 200, 500, 2000])
@pytest.mark.parametrize("ppm", [-20000, 100, 20000])
def test_constant_skew(ppm: int, mu_us: int) -> None:
    error = settled_us(results(Link(f"const{ppm}", mu_us, SECONDS)))
    assert np.sqrt((error**2).mean()) <= 1.5 * np.hypot(3.2 * mu_us / 1600, 0.6)


@pytest.mark.parametrize(
    ("oscillator", "mu_us", "p95_us", "bound_us"),
    [
        ("typ", 500, 5, 12),
        ("presc85", 500, 5, 12),
        ("fll5000", 500, 15, 30),
        ("rcbad", 500, 30, 50),
        ("rcbad", 50, 10, 20),
        ("typ", 2000, 20, 45),
    ],
)
def test_oscillators(oscillator: str, mu_us: float, p95_us: float, bound_us: float) -> None:
    found = results(Link(oscillator, mu_us, SECONDS))
    covered, flagged, bound = shares(found)
    assert np.percentile(np.abs(settled_us(found)), 95) <= p95_us
    assert covered >= 0.985
    assert flagged <= 0.02
    assert bound <= bound_us


def test_half_lost_in_bursts_of_2_s() -> None:
    found = results(Link("presc85", 500, 120, loss=0.5, burst_s=2), seeds=20)
    assert np.percentile(np.abs(settled_us(found)), 95) <= 10
    assert shares(found)[0] >= 0.985


def test_what_was_known_before_12_s_of_silence_is_of_use_after() -> None:
    """There is no time after 10 s, and at once a good one with the first messages."""
    for seed in range(5):
        found = tracked(silence(run(Link("presc85", 500, 60), seed), 3000, 12))
        refused = found.at_s[~found.given & (found.at_s > 1)]
        assert refused[0] == pytest.approx(40.3, abs=0.1)
        assert refused[-1] == pytest.approx(42.3, abs=0.1)
        after = found.at_s > refused[-1]
        assert np.nanmax(np.abs(found.error_us[after])) <= 50
        assert found.covered[after].mean() >= 0.985


def test_ticks_of_the_32_khz_clock() -> None:
    found = results(Link("typ", 500, SECONDS, gap8_tick_us=RTC_US))
    assert np.percentile(np.abs(settled_us(found)), 95) <= 12
    assert shares(found)[0] >= 0.985
    assert all((each.times["flags"] & lib.FRAME_QUANTISED).all() for each in found)


@pytest.mark.parametrize(("oscillator", "p95_us"), [("typ", 210), ("presc85", 100), ("rcbad", 250)])
def test_ticks_of_1_ms(oscillator: str, p95_us: float) -> None:
    found = results(Link(oscillator, 500, SECONDS, gap8_tick_us=1000), seeds=6)
    covered, flagged, bound = shares(found)
    assert np.percentile(np.abs(settled_us(found)), 95) <= p95_us
    assert covered >= 0.985
    assert flagged <= 0.01
    assert bound <= 1600


@pytest.mark.parametrize("latency_us", [0, 50])
@pytest.mark.parametrize("fps", [10, 25, 60])
@pytest.mark.parametrize("mu_us", [20, 2000])
@pytest.mark.parametrize("late", [0, 0.02])
def test_the_bound_of_ticks_of_1_ms_holds(late: float, mu_us: float, fps: float, latency_us: float) -> None:
    """Whatever of the delays and of the frames' phases the ticks hide."""
    link = Link("typ", mu_us, 40, late=late, gap8_tick_us=1000, fps=fps, latency_us=latency_us)
    found = [tracked(run(link, seed), 1000, latency_us=5 * latency_us) for seed in range(2)]
    covered, flagged, _ = shares(found)
    assert covered >= 0.985
    assert flagged <= 0.03


@pytest.mark.parametrize("bits", [32, 64])
@pytest.mark.parametrize("clocks", ["stm32", "gap8", "both"])
def test_wrap(clocks: str, bits: int) -> None:
    """Of 32 bits after 71.6 minutes, and of 64: no frame is the worse for it."""
    made = run(Link("presc85", 500, 40), 1)
    to = (1 << bits) - 20_000_000
    plus = {
        "stm32_plus": to - int(made.stm32_us[0]) if clocks != "gap8" else 0,
        "gap8_plus": to - int(made.gap8_us[0]) if clocks != "stm32" else 0,
    }
    plain, wrapped = tracked(made), tracked(made, bits=bits, **plus)
    assert (wrapped.times["flags"] == plain.times["flags"]).all()
    assert (wrapped.times["bound_us"] == plain.times["bound_us"]).all()
    assert np.allclose(wrapped.error_us, plain.error_us, equal_nan=True, atol=1e-6)


def test_the_known_delay_is_removed() -> None:
    made = run(Link("presc85", 500, 30), 1)
    late = replace(made, gap8_us=made.gap8_us + 1477)
    plain, known, unknown = tracked(made), tracked(late, delay_ns=1_477_000), tracked(late)
    end = plain.at_s > 10
    assert np.abs(known.error_us - plain.error_us)[end].max() <= 3
    assert np.median(unknown.error_us[end]) == pytest.approx(-1477 * 84 / 85, abs=20)


def test_an_epoch_that_the_messages_announce_is_believed_at_once() -> None:
    at = 2000
    made = stm32_leap(run(Link("presc85", 500, 40), 2), at, -5_000_000)
    found = tracked(made, epochs=(np.arange(len(made.stm32_us)) >= at).astype(np.int64))
    after = found.times["epoch"] == 1
    assert found.at_s[after][0] == pytest.approx(20, abs=0.2)
    new = (found.times["flags"] & lib.FRAME_EPOCH_NEW) != 0
    assert found.at_s[new][-1] - found.at_s[new][0] == pytest.approx(1, abs=0.3)
    # The frame between the leap and its message cannot know.
    assert (found.wrong_unflagged & ~after).sum() <= 1 + 0.01 * len(after)
    # Skew outlives the epoch: the first frames of the new one are sharp.
    first = after & found.given & (found.at_s < 20.8)
    assert first.any()
    assert np.abs(found.error_us[first]).max() <= 1000


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_no_messages_give_no_time(count: int) -> None:
    made = run(Link("typ", 500, 5), 0)
    found = tracked(take(made, np.arange(count)))
    assert not found.given.any()
    assert ((found.times["flags"] & REFUSED) != 0).all()
    assert (found.times["bound_us"] == 0xFFFFFFFF).all()
    assert (found.times["stm32_us"] == 0).all()


def test_nothing_grows_for_hours() -> None:
    """Four hours at 2 % of skew: a difference of 288 s."""
    made = run(Link("const20000", 500, 4 * 3600, fps=1), 0)
    found = tracked(made)
    assert np.abs(found.error_us[found.at_s > 20]).max() <= 60
    assert found.times["skew_ppb"][-1] == pytest.approx(-20000e3 / 1.02, abs=2e3)


def test_state_is_small() -> None:
    assert ffi.sizeof("clock_track_t") <= 2048


def test_wire_time_is_that_of_the_real_divisor() -> None:
    assert round(17 * 10 * 365 / 42e6 * 1e9) == lib.CLOCK_STAMP_WIRE_NS


def test_random_readings_do_no_harm() -> None:
    """Whatever came before, 20 s of good messages give good times."""
    for seed in range(20):
        random = np.random.default_rng(seed)
        made = run(Link("presc85", 500, 30, fps=10), seed)
        count = 200
        wild = random.integers(0, 1 << int(random.integers(4, 62)), count)
        events = np.sort(random.integers(0, 1 << int(random.integers(4, 40)), count))
        dirty = replace(
            made,
            stm32_us=np.concatenate((wild, made.stm32_us)),
            gap8_us=np.concatenate((events - (1 << 41), made.gap8_us)),
        )
        found = tracked(dirty)
        end = found.at_s > 25
        assert found.given[end].all(), f"seed {seed}"
        assert np.abs(found.error_us[end]).max() <= 200, f"seed {seed}"
