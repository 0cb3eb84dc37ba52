"""What goes wrong with clocks and links: no frame gets a wrong time without saying so."""

import os
from dataclasses import replace

import models
import numpy as np
import pytest
from models import Link, Run, run

from host.clock.stamps import Stamped, stamp
from host.clock.ticks import sent_tick_us, tick_us, unwrap

SECONDS, AT = 60.0, 3000
LINK = Link("presc85", 500.0, seconds=SECONDS)
SEEDS = range(5, 5 + int(os.environ.get("SPINDECK_CLOCK_SEEDS", "1")))
WRAP = (1 << 32) - 30_000_000


def stamped(made: Run) -> Stamped:
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    return stamp(stm32, gap8, frames, made.frame_after)


def wrapped_stm32(made: Run) -> Run:
    return replace(made, stm32_us=(made.stm32_us + WRAP) % (1 << 32), frame_true_us=made.frame_true_us + WRAP)


def wrapped_gap8(made: Run) -> Run:
    gap8_us, frames = (made.gap8_us + WRAP) % (1 << 32), (made.frame_gap8_us + WRAP) % (1 << 32)
    return replace(made, gap8_us=gap8_us, frame_gap8_us=frames)


def reset_twice(made: Run) -> Run:
    """The broadcast that resets is repeated, and met again by the next message."""
    once = models.stm32_leap(made, AT, -int(made.stm32_us[AT]))
    return models.stm32_leap(once, AT + 1, -int(once.stm32_us[AT + 1]))


def stalled(made: Run) -> Run:
    """The wire stands still once a second, for a second on average, and then all that was held comes at once."""
    random = np.random.default_rng(len(made.stm32_us))
    gap8_us = made.gap8_us.copy()
    at = float(gap8_us[0])
    while at < gap8_us[-1] - 5e6:
        at += random.exponential(1e6)
        until = at + random.exponential(1e6)
        gap8_us[(made.gap8_us > at) & (made.gap8_us < until)] = int(until)
        at = until
    return replace(made, gap8_us=gap8_us, come_us=made.come_us + (gap8_us - made.gap8_us))


def swapped_and_stalled(made: Run) -> Run:
    return models.swapped(stalled(made), 0.05, 1)


FAULTS = {
    # name: (the fault, epochs, frames refused at most, messages dropped and why)
    "wrap of the STM32's": (wrapped_stm32, 1, 0, {}),
    "wrap of the GAP8's": (wrapped_gap8, 1, 0, {}),
    "wrap of both": (lambda made: wrapped_gap8(wrapped_stm32(made)), 1, 0, {}),
    "reset": (lambda made: models.stm32_leap(made, AT, -int(made.stm32_us[AT])), 2, 2, {}),
    "reset twice": (reset_twice, 2, 2, {"repeated": 1}),
    "leap +250 ms": (lambda made: models.stm32_leap(made, AT, 250_000), 2, 2, {}),
    "leap -250 ms": (lambda made: models.stm32_leap(made, AT, -250_000), 2, 2, {}),
    "leap +3 ms": (lambda made: models.stm32_leap(made, AT, 3_000), 2, 2, {}),
    "leap -3 ms": (lambda made: models.stm32_leap(made, AT, -3_000), 2, 2, {}),
    "lost for 3 s": (lambda made: models.silence(made, AT, 3), 1, 0, {}),
    "lost for 15 s": (lambda made: models.silence(made, AT, 15), 1, 0, {}),
    "backlog": (lambda made: models.backlog(made, AT, 0.5), 1, 0, {"late": 54}),
    "half of it backlogs": (stalled, 1, 0, {"late": 2259}),
    "half of it backlogs, swapped": (swapped_and_stalled, 1, 0, {"late": 2049, "out of order": 572}),
    "duplicates": (lambda made: models.duplicates(made, 0.2, 1), 1, 0, {"repeated": 1203}),
    "swapped": (lambda made: models.swapped(made, 0.05, 1), 1, 0, {"out of order": 572}),
    "stuck": (lambda made: models.stuck(made, AT, 2), 1, 0, {"the STM32's clock stood still": 197}),
    "glitches early": (lambda made: models.glitches(made, [AT, 4000], 65_536), 1, 0, {"impossible": 2}),
    "glitches late": (lambda made: models.glitches(made, [AT, 4000], -65_536), 1, 0, {"late": 2}),
    "first an outlier": (lambda made: models.glitches(made, [0], -3_000_000), 1, 0, {"impossible": 1}),
    "first two outliers": (lambda made: models.glitches(made, [0, 1], 3_000_000), 1, 0, {"impossible": 2}),
    "GAP8 reboot": (lambda made: models.gap8_reboot(made, AT, 1.5), 2, 0, {}),
}


@pytest.mark.parametrize("name", FAULTS)
def test_nothing_wrong_passes(name: str) -> None:
    fault, epochs, refused, dropped = FAULTS[name]
    for seed in SEEDS:
        made = fault(run(LINK, seed))
        got = stamped(made)
        error = np.abs(got.stm32_us - made.frame_true_us[got.frame])
        assert len(got.fitted) == epochs, f"seed {seed}: {[each.epoch.why for each in got.fitted]}"
        assert len(got.refused) <= refused
        assert len(got.frame) + len(got.refused) == len(made.frame_gap8_us)
        assert np.quantile(error, 0.95) < 6
        assert (error <= got.bound_us).mean() >= 0.97
        assert (error <= 2 * got.bound_us).all(), f"seed {seed}: {error.max()}"
        assert dropped.keys() == got.sorted.dropped.keys()
        if seed == SEEDS[0]:
            assert dropped == got.sorted.dropped


@pytest.mark.parametrize("seed", range(3))
def test_frames_among_repeated_resets_are_refused(seed: int) -> None:
    """The first message of the new epoch left before the last of them: the clock that it tells of is gone."""
    made = models.stm32_resets(run(replace(LINK, fps=200), seed), AT, 15, 1_000)
    got = stamped(made)
    assert (np.abs(got.stm32_us - made.frame_true_us[got.frame]) <= 2 * got.bound_us).all()
    assert 2 <= len(got.refused) <= 6


@pytest.mark.parametrize(("ppm", "seed"), [(2000, 15), (-2000, 6), (4000, 0), (-4000, 0), (-4000, 1)])
def test_a_rate_that_steps_is_no_leap(ppm: float, seed: int) -> None:
    """Lines drawn from either side miss each other by 0.65 ms where the first has the bend in it."""
    made = run(replace(LINK, rate_step_ppm=ppm), seed)
    got = stamped(made)
    assert len(got.fitted) == 1
    assert (np.abs(got.stm32_us - made.frame_true_us[got.frame]) <= 1.2 * got.bound_us).all()


@pytest.mark.parametrize("by_us", [-1_000, 1_000, -3_000])
def test_a_leap_of_little_more_than_delays_is_one(by_us: int) -> None:
    for seed in range(3):
        assert len(stamped(models.stm32_leap(run(LINK, seed), AT, by_us)).fitted) == 2, f"seed {seed}"


@pytest.mark.parametrize(("ppm", "worst_us"), [(50, 60), (-50, 60), (2000, 800), (-2000, 800)])
def test_steps_of_the_rate(ppm: float, worst_us: float) -> None:
    made = run(replace(LINK, rate_step_ppm=ppm), 5)
    got = stamped(made)
    error = np.abs(got.stm32_us - made.frame_true_us[got.frame])
    assert error.max() < worst_us
    assert (error <= got.bound_us).mean() > 0.97
    assert (error <= got.bound_us + 20).all()


def test_starvation_each_second() -> None:
    made = run(replace(LINK, delay_us=models.starved), 5)
    got = stamped(made)
    error = np.abs(got.stm32_us - made.frame_true_us[got.frame])
    assert len(got.fitted) == 1
    assert np.quantile(error, 0.95) < 6


@pytest.mark.parametrize("slow", [1.0, 84 / 85])
@pytest.mark.parametrize(("before_us", "then_us"), [(166_667, 66_667), (66_667, 10_000)])
def test_messages_that_come_faster_than_most_are_not_late(slow: float, before_us: int, then_us: int) -> None:
    """A message with each frame, on a clock of 1 ms, and the frames' rate is changed."""
    rng = np.random.default_rng(1)
    at_us = np.cumsum(np.concatenate((np.full(800, before_us), np.full(700, then_us))))
    gap8_us = np.maximum.accumulate((at_us + 1477 + rng.exponential(300, len(at_us))).astype(np.int64))
    stm32_us = (at_us * slow).astype(np.int64) // 1000 * 1000
    frames = np.arange(at_us[0] + 500_000, at_us[-1] - 100_000, 66_667).astype(np.uint64)
    after = np.searchsorted(gap8_us, frames)
    got = stamp(stm32_us.astype(np.uint64), gap8_us.astype(np.uint64), frames, after, None, 1477.0, 1000.0)
    assert (len(got.fitted), got.sorted.dropped, got.refused) == (1, {}, {})
    assert not got.held_over.any()
    assert (np.abs(got.stm32_us - frames[got.frame] * slow) <= got.bound_us).all()


def test_hours() -> None:
    """84/85 against a right clock: 64 s apart in the end, and nothing overflows."""
    made = run(replace(LINK, seconds=5400, fps=0.1), 7)
    got = stamped(made)
    error = np.abs(got.stm32_us - made.frame_true_us)
    assert not got.refused
    assert np.quantile(error, 0.95) < 5
    assert got.fitted[0].is_slow


def test_what_is_too_little_is_refused_with_a_reason() -> None:
    made = run(LINK, 5)
    for kept, why in [(0, "no messages"), (1, "too few messages"), (2, "too few messages"), (30, "too few messages")]:
        few = models.take(made, np.arange(len(made.stm32_us)) < kept)
        got = stamped(few)
        assert len(got.frame) == 0
        assert set(got.refused.values()) == {why}
        assert len(got.refused) == len(made.frame_gap8_us)


def test_frames_far_from_every_message_are_refused() -> None:
    made = run(LINK, 5)
    some = models.take(made, (np.arange(len(made.stm32_us)) >= 2000) & (np.arange(len(made.stm32_us)) < 3500))
    got = stamped(some)
    error = np.abs(got.stm32_us - made.frame_true_us[got.frame])
    assert set(got.refused.values()) == {"before the first message", "after the last message"}
    assert (error <= got.bound_us).all()
    assert 0.35 < len(got.frame) / len(made.frame_gap8_us) < 0.65


@pytest.mark.parametrize("oscillator", models.OSCILLATORS)
@pytest.mark.parametrize("heard", [200, 1000, 4000])
def test_what_is_held_over_has_what_clocks_may_do_in_its_bound(oscillator: str, heard: int) -> None:
    """The rate at the last message is known so well only, and goes on changing."""
    for seed in SEEDS:
        made = run(replace(LINK, oscillator=oscillator, seconds=80), seed)
        place = np.arange(len(made.stm32_us))
        some = models.take(made, (place >= 2000) & (place < 2000 + heard))
        got = stamped(some)
        frames_us = some.frame_gap8_us[got.frame]
        outside_us = np.maximum(some.gap8_us[0] - frames_us, frames_us - some.gap8_us[-1])
        assert (got.held_over[outside_us > 260_000]).all()
        assert not got.held_over[outside_us < 240_000].any()
        error = np.abs(got.stm32_us - some.frame_true_us[got.frame])
        far = outside_us > 2_000_000
        assert far.sum() > 100
        assert (error <= got.bound_us)[far].mean() >= 0.985, f"seed {seed}"


def test_a_reset_after_the_last_message_is_wrong_only_where_it_is_marked() -> None:
    made = models.stm32_leap(run(LINK, 5), AT, -25_000_000)
    got = stamped(models.take(made, np.arange(len(made.stm32_us)) < AT - 100))
    wrong = np.abs(got.stm32_us - made.frame_true_us[got.frame]) > got.bound_us
    assert wrong.sum() > 100
    assert got.held_over[wrong].all()


def test_a_leap_is_not_hidden_by_the_robots_own_count() -> None:
    """The message says that the clock was reset, by so little that its times do not show it."""
    made = models.stm32_leap(run(LINK, 5), AT, -200)
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    resets = (np.arange(len(stm32)) >= AT).astype(np.int64)
    got = stamp(stm32, gap8, frames, made.frame_after, resets)
    assert len(got.fitted) == 2
    assert (np.abs(got.stm32_us - made.frame_true_us[got.frame]) < 2 * got.bound_us).all()


@pytest.mark.parametrize(
    ("heard", "told"),  # a handful that nobody explains are outliers
    [(1, True), (4, True), (20, True), (45, True), (20, False), (45, False)],
)
@pytest.mark.parametrize("after", [False, True])
def test_an_epoch_of_few_messages_is_no_part_of_its_neighbour(heard: int, after: bool, told: bool) -> None:
    """On a bad link hardly anything is heard before a reset, or after one: what is heard tells that there was one."""
    made = models.stm32_leap(run(LINK, 5), AT, -25_000_000)
    place = np.arange(len(made.stm32_us))
    few = (place >= AT) == after
    some = models.take(made, ~few | (np.cumsum(few) % (few.sum() // heard) == 1))
    stm32, gap8, frames = (each.astype(np.uint64) for each in (some.stm32_us, some.gap8_us, some.frame_gap8_us))
    resets = (some.stm32_us < some.gap8_us - 12_000_000).astype(np.int64) if told else None
    assert resets is None or 0 < resets.mean() < 1
    got = stamp(stm32, gap8, frames, some.frame_after, resets)
    assert len(got.fitted) == 1
    assert len(got.frame) > 0.4 * len(frames)
    assert (np.abs(got.stm32_us - some.frame_true_us[got.frame]) < 2 * got.bound_us).all()
    assert "too few messages" in got.refused.values()


@pytest.mark.parametrize(("ppm", "slow"), [(3000, False), (8000, False), (11_000, False), (4000, True), (0, True)])
def test_which_clock_is_the_wrong_one_is_found_or_in_the_bound(ppm: int, slow: bool) -> None:
    """What is taken off a message for the wire is in the STM32's us: 17 us more or less."""
    made = run(replace(LINK, oscillator=f"const{1e6 / 84 * slow + ppm}"), 5)
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    come_us = made.frame_us * (85 / 84 if slow else 1) + np.random.default_rng(5).exponential(5_000, len(frames))
    guessed = stamp(stm32, gap8, frames, made.frame_after, wire_us=1477)
    (each,) = guessed.fitted
    assert each.wire_stm32_us + each.wire_bound_us >= 1477 * (84 / 85 if slow else 1) >= 1477 * 84 / 85
    assert each.wire_bound_us == pytest.approx(1477 / 85)
    known = stamp(stm32, gap8, frames, made.frame_after, wire_us=1477, arrival_us=come_us)
    assert (known.fitted[0].is_slow, known.fitted[0].wire_bound_us) == (slow, 0)
    assert guessed.bound_us - known.bound_us == pytest.approx(1477 / 85, abs=1e-6)


def test_a_network_that_stalls_does_not_tell_which_clock_is_wrong() -> None:
    made = run(LINK, 5)
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    come_us = made.frame_us * 85 / 84 + 500_000 * (made.frame_us > 40e6)
    assert stamp(stm32, gap8, frames, made.frame_after, wire_us=1477, arrival_us=come_us).fitted[0].wire_bound_us


def test_unwrap() -> None:
    top = (1 << 32) - 1
    assert unwrap(np.array([top - 1, 1, 5], np.uint64)).tolist() == [top - 1, top + 2, top + 6]
    assert unwrap(np.array([top - 1, 1, top, 5], np.uint64)).tolist() == [top - 1, top + 2, top, top + 6]
    assert unwrap(np.array([10**12, 1, 5], np.uint64)).tolist() == [10**12, 1, 5]
    assert unwrap(np.array([], np.uint64)).tolist() == []


def test_ticks_of_what_is_sent_at_even_steps_are_not_seen() -> None:
    even = 12_345 + 10_000 * np.arange(1000)
    some = np.delete(even, [5, 6, 100, 700])
    at = np.arange(0, 10**7, 9_882)
    for readings in (even, even // 1000 * 1000, some // 1000 * 1000, at, at[:1]):
        assert sent_tick_us(readings.astype(np.uint64)) == 1.0
    assert sent_tick_us((at // 1000 * 1000).astype(np.uint64)) == 1000.0
    assert sent_tick_us((at * 32768 // 10**6 * 10**6 // 32768).astype(np.uint64)) == 1e6 / 32768


@pytest.mark.parametrize("loss", [0.5, 0.7, 0.9])
def test_even_steps_are_recognised_though_most_are_lost(loss: float) -> None:
    kept = np.random.default_rng(7).random(20_000) >= loss
    at = 10_000 * np.flatnonzero(kept)
    assert sent_tick_us(at.astype(np.uint64)) == 1.0
    at = 9_882 * np.flatnonzero(kept) // 1000 * 1000
    assert sent_tick_us(at.astype(np.uint64)) == 1000.0


def test_even_steps_are_recognised_beside_faults() -> None:
    at = 345 + 10_000 * np.arange(2000)
    at[300:500] = at[300]
    assert sent_tick_us(at.astype(np.uint64)) == 1.0, "it stood for 2 s"
    at = 10_000 * np.arange(2000)
    at[np.random.default_rng(7).random(2000) < 0.02] -= 7_777
    assert sent_tick_us(at.astype(np.uint64)) == 1.0, "one in 50 is wrong"


def test_even_steps_of_1_ms_are_taken_for_ticks() -> None:
    assert sent_tick_us(np.arange(0, 10**6, 1000).astype(np.uint64)) == 1000.0


@pytest.mark.parametrize("then_us", [5_000, 11_000, 15_000, 100_000])
def test_even_steps_may_change(then_us: int) -> None:
    at = 345 + np.cumsum(np.concatenate((np.full(500, 10_000), np.full(500, then_us))))
    assert sent_tick_us(at.astype(np.uint64)) == 1.0


@pytest.mark.parametrize("readings", [90_000, 150_000, 15_000_000])
def test_ticks_of_many_readings_are_recognised(readings: int) -> None:
    at = 9_973 * np.arange(readings)
    assert tick_us(at) == 1.0
    at -= at % 1000
    assert tick_us(at) == 1000.0


def test_ticks_are_recognised() -> None:
    at = np.arange(0, 10**7, 9_973)
    assert tick_us(at) == 1.0
    assert tick_us(at // 1000 * 1000) == 1000.0
    assert tick_us((at * 32768 // 10**6) * 10**6 // 32768) == 1e6 / 32768


@pytest.mark.parametrize("start", [0, 1, 17, 299_999, (1 << 32) - 5_000_000, 4_288_340_022])
@pytest.mark.parametrize("wraps", [False, True])
def test_ticks_are_recognised_wherever_they_begin(start: int, wraps: bool) -> None:
    rng = np.random.default_rng(start)
    at = 10_000 * np.arange(1000) + rng.exponential(300, 1000).astype(np.int64)
    for readings, tick in (
        (at, 1.0),
        (at // 1000 * 1000, 1000.0),
        ((at * 32768 // 10**6) * 10**6 // 32768, 1e6 / 32768),
    ):
        assert tick_us((readings + start) % (1 << 32 if wraps else 1 << 48)) == tick
    even = start + 10_000 * np.arange(1000)
    assert tick_us(even) == (1000.0 if start % 1000 == 0 else 1.0), "a clock of 1 us may hear every 10 ms"
