"""Interpolation: against scipy, against simulated flights whose truth is known, and every refusal."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from logs import real
from scipy.interpolate import BarycentricInterpolator, CubicSpline
from scipy.spatial.transform import Rotation, Slerp

from host.usd import runs
from host.usd.decode import decode
from host.usd.interpolate import Refusal, interpolate
from host.usd.track import Track, read_track

Truth = Callable[[Any], Any]


def track(stamps: Any, position: Any = None, attitude: Any = None, epochs: tuple[range, ...] = ()) -> Track:
    stamps = np.asarray(stamps, np.uint64)
    whole = (range(len(stamps)),)
    return Track("made", stamps, 1, epochs or whole, np.ones(len(stamps), bool), position, attitude)


class Flight:
    """Sums of sines up to 4 Hz, positions of decimetres to metres."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.hz = rng.uniform(0.1, 4, (2, 3, 6))
        self.size = rng.normal(0, 0.5, (2, 3, 6)) / (1 + self.hz**1.5)
        self.phase = rng.uniform(0, 2 * np.pi, (2, 3, 6))

    def _sines(self, which: int, at_us: Any) -> Any:
        angle = 2 * np.pi * self.hz[which] * np.asarray(at_us)[:, None, None] / 1e6 + self.phase[which]
        return (self.size[which] * np.sin(angle)).sum(axis=2)

    def position(self, at_us: Any) -> Any:
        return self._sines(0, at_us)

    def attitude(self, at_us: Any) -> Any:
        return Rotation.from_euler("ZYX", 2 * self._sines(1, at_us))

    def log(self, seed: int, period_us: float, jitter_us: float, late_us: float, seconds: float = 5) -> Track:
        """Rows whose values are up to late_us older than their stamps; signs of quaternions are as they come."""
        rng = np.random.default_rng(seed)
        stamps = np.arange(int(seconds * 1e6 / period_us)) * period_us + rng.uniform(
            0, jitter_us, int(seconds * 1e6 / period_us)
        )
        then = stamps - rng.uniform(0, late_us, len(stamps))
        signs = rng.choice([-1, 1], (len(stamps), 1))
        return track(np.round(stamps) + 1e6, self.position(then + 1e6), self.attitude(then + 1e6).as_quat() * signs)


RNG = np.random.default_rng(11)


def test_attitudes_are_scipys_slerp() -> None:
    stamps = np.cumsum(RNG.integers(900, 1100, 200))
    turns = Rotation.from_rotvec(np.cumsum(RNG.normal(0, 0.2, (200, 3)), axis=0))
    signed = turns.as_quat() * RNG.choice([-1, 1], (200, 1))
    at = RNG.uniform(stamps[0], stamps[-1], 1000)
    found = interpolate(track(stamps, attitude=signed), at)
    assert not found.refusal.any()
    assert (Rotation.from_quat(found.attitude).inv() * Slerp(stamps, turns)(at)).magnitude().max() < 1e-7
    assert np.abs(np.linalg.norm(found.attitude, axis=1) - 1).max() < 1e-12


def test_equal_attitudes() -> None:
    signed = np.array([[0, 0, 0, 1.0], [0, 0, 0, -1], [0, 0, 0, 1]])
    found = interpolate(track([1000, 2000, 3000], attitude=signed), np.array([1500.0, 2000, 2999]))
    assert np.abs(found.attitude[:, 3]).tolist() == [1, 1, 1]


def test_linear_positions_are_numpys_interp() -> None:
    stamps = np.cumsum(RNG.integers(900, 1100, 200))
    values = RNG.normal(0, 1, (200, 3))
    at = RNG.uniform(stamps[0], stamps[-1], 1000)
    found = interpolate(track(stamps, values), at)
    expected = np.stack([np.interp(at, stamps, values[:, axis]) for axis in range(3)], axis=1)
    assert np.abs(found.position_m - expected).max() < 1e-12
    assert np.array_equal(found.gap_us, np.diff(stamps)[np.searchsorted(stamps, at) - 1])


def test_cubic_positions_go_through_the_four_nearest_rows() -> None:
    stamps = np.cumsum(RNG.integers(900, 1100, 60))
    values = RNG.normal(0, 1, (60, 3))
    at = RNG.uniform(stamps[0], stamps[-1], 300)
    found = interpolate(track(stamps, values), at, "cubic")
    for time, position in zip(at, found.position_m, strict=True):
        first = min(max(int(np.searchsorted(stamps, time)) - 2, 0), 56)
        nodes = slice(first, first + 4)
        assert np.abs(position - BarycentricInterpolator(stamps[nodes], values[nodes])(time)).max() < 1e-9


def test_cubic_positions_are_near_scipys_spline() -> None:
    """A spline knows all rows; on what is sampled well, the difference is within the error that is given."""
    flight = Flight(3)
    made = flight.log(3, 10_000, 500, 0)
    at = RNG.uniform(float(made.stamp_us[2]), float(made.stamp_us[-3]), 1000)
    found = interpolate(made, at, "cubic", row_error_us=0)
    spline = CubicSpline(made.stamp_us.astype(float), made.position_m)(at)
    assert (np.linalg.norm(found.position_m - spline, axis=1) <= found.position_error_m).mean() > 0.99
    assert np.abs(found.position_m - spline).max() < 2e-4


def covered(period_us: float, late_us: float, bound_us: float, method: Any, seed: int) -> tuple[float, float, float]:
    """Shares of times at which position and attitude are within the error; its median, of the position."""
    flight = Flight(seed)
    made = flight.log(seed, period_us, 0.1 * period_us, late_us)
    rng = np.random.default_rng(seed)
    at = rng.uniform(float(made.stamp_us[0]), float(made.stamp_us[-1]), 2000)
    found = interpolate(made, at, method, bound_us=bound_us, row_error_us=late_us)
    assert not found.refusal.any()
    then = at + rng.uniform(-bound_us, bound_us, len(at))
    off = np.linalg.norm(found.position_m - flight.position(then), axis=1)
    turned = (Rotation.from_quat(found.attitude).inv() * flight.attitude(then)).magnitude()
    ratio = float(np.median(found.position_error_m / np.maximum(off, 1e-9)))
    return (off <= found.position_error_m).mean(), (turned <= found.attitude_error_rad).mean(), ratio


CASES = [(1000, 0, 0), (2000, 1000, 0), (4000, 1000, 2500), (10_000, 0, 0), (10_000, 1000, 500), (20_000, 0, 2500)]


@pytest.mark.parametrize(("period_us", "late_us", "bound_us"), CASES)
@pytest.mark.parametrize("method", ["linear", "cubic"])
def test_the_error_covers_the_truth(period_us: float, late_us: float, bound_us: float, method: str) -> None:
    """At nearly every time, and without being much larger than it has to be."""
    shares = np.array([covered(period_us, late_us, bound_us, method, seed) for seed in range(8)])
    assert shares[:, 0].mean() > 0.998
    assert shares[:, 1].mean() > 0.998
    assert shares[:, 2].max() < 12


def test_an_error_that_is_too_small_would_be_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runs, "MARGIN", 0.5)
    assert covered(20_000, 0, 0, "linear", 1)[0] < 0.8
    monkeypatch.undo()
    flight = Flight(1)
    late = flight.log(1, 2000, 200, 1000)
    at = late.stamp_us[10:-10].astype(float)
    found = interpolate(late, at, row_error_us=100)
    assert (np.linalg.norm(found.position_m - flight.position(at), axis=1) <= found.position_error_m).mean() < 0.8


# Rows every 1000 us from 10000 on; a hole; 8 rows; a reset to 2000; 10 rows; a hole; 2 rows.
STAMPS = [*range(10_000, 20_000, 1000), *range(30_000, 38_000, 1000), *range(2000, 12_000, 1000), 50_000, 51_000]
EPOCHS = (range(18), range(18, 30))
REFUSALS: list[tuple[float, Refusal]] = [
    (1999, Refusal.BEFORE), (2000, Refusal.NONE), (2500, Refusal.NONE), (9999, Refusal.NONE),
    (10_000, Refusal.EPOCH), (11_500, Refusal.EPOCH), (12_500, Refusal.EPOCH), (60_000, Refusal.AFTER),
    (40_000, Refusal.HOLE), (50_500, Refusal.FEW), (51_000, Refusal.FEW), (51_001, Refusal.AFTER),
    (float("nan"), Refusal.INVALID),
]  # fmt: skip
IN_FIRST: list[tuple[float, Refusal]] = [
    (9999, Refusal.BEFORE), (10_000, Refusal.NONE), (19_000, Refusal.NONE), (19_001, Refusal.HOLE),
    (29_999, Refusal.HOLE), (30_000, Refusal.NONE), (37_000, Refusal.NONE), (37_001, Refusal.AFTER),
]  # fmt: skip


@pytest.mark.parametrize(("cases", "epoch"), [(REFUSALS, None), (IN_FIRST, 0)])
@pytest.mark.parametrize("method", ["linear", "cubic"])
def test_refusals(cases: list[tuple[float, Refusal]], epoch: int | None, method: Any) -> None:
    rows = np.arange(len(STAMPS))
    made = track(
        STAMPS, np.stack([rows, -rows, rows * 0], axis=1).astype(float), np.tile([0, 0, 0, 1.0], (30, 1)), EPOCHS
    )
    found = interpolate(made, np.array([each[0] for each in cases]), method, epoch=epoch)
    assert [Refusal(code).name for code in found.refusal] == [each[1].name for each in cases]
    for values in (found.position_m, found.position_error_m, found.attitude, found.attitude_error_rad, found.gap_us):
        assert (np.isfinite(values).reshape(len(cases), -1).all(axis=1) == (found.refusal == 0)).all()


def test_unverified_rows_are_used_only_when_allowed() -> None:
    made = track(range(0, 20_000, 1000), np.arange(60.0).reshape(20, 3))
    made.is_verified[10] = False
    at = np.array([7500, 8000, 8500, 9000, 9500, 10_000, 10_500, 11_500, 12_500])
    refused = [bool(code) for code in interpolate(made, at).refusal]
    assert refused == [False, False, False, True, True, True, True, False, False]
    cubic = interpolate(made, at, "cubic").refusal
    assert [Refusal(code).name for code in cubic] == ["NONE"] + ["UNVERIFIED"] * 7 + ["NONE"]
    assert not interpolate(made, at, unverified=True).refusal.any()


def test_rows_that_hold_no_number() -> None:
    position, attitude = np.arange(60.0).reshape(20, 3), np.tile([0, 0, 0, 1.0], (20, 1))
    position[5, 1], attitude[15] = np.inf, np.nan
    found = interpolate(track(range(0, 20_000, 1000), position, attitude), np.array([1500.0, 5500, 10_500, 15_500]))
    assert [Refusal(code).name for code in found.refusal] == ["NONE", "INVALID", "NONE", "INVALID"]


@pytest.mark.parametrize("seed", range(20))
def test_never_outside_of_two_good_rows_that_are_near(seed: int) -> None:
    """Rows as they come: out of order, doubled, with holes, resets and unverified stretches."""
    rng = np.random.default_rng(seed)
    steps = [rng.choice([500, 1000, 1000, 1000, 1100, 9000], 60) for _ in range(3)]
    parts = [np.cumsum(step) + start for step, start in zip(steps, (0, 500_000, 450_000), strict=True)]
    stamps = np.concatenate([part[np.argsort(np.arange(60) + rng.choice([0, 1.5], 60))] for part in parts])
    doubled = rng.random(180) < 0.1
    stamps[1:][doubled[1:]] = stamps[:-1][doubled[1:]]
    epochs = tuple(range(begin, begin + 60) for begin in (0, 60, 120))
    made = replace(track(stamps, rng.normal(0, 1, (180, 3)), epochs=epochs), is_verified=rng.random(180) < 0.95)
    at = rng.uniform(0, 700_000, 500)
    for method in ("linear", "cubic"):
        found = interpolate(made, at, method, hole_us=2500)  # type: ignore[arg-type]
        assert 0 < (found.refusal == 0).sum() < 500, f"seed {seed}"
        for time, refusal, epoch in zip(at, found.refusal, found.epoch, strict=True):
            inside = [number for number, part in enumerate(parts_of(made)) if part.min() <= time <= part.max()]
            if refusal:
                continue
            assert inside == [epoch], f"seed {seed}"
            rows = parts_of(made)[epoch]
            before, behind = rows[rows <= time].max(), rows[rows >= time].min()
            assert behind - before <= 2500, f"seed {seed}"
            first = np.flatnonzero(made.stamp_us == before)
            assert made.is_verified[first[first >= epochs[epoch].start][0]], f"seed {seed}"


def parts_of(made: Track) -> list[Any]:
    return [made.stamp_us[part.start : part.stop].astype(float) for part in made.epochs]


@pytest.mark.parametrize("rows", range(4))
def test_hardly_any_rows(rows: int) -> None:
    made = track(
        [1000 * number for number in range(rows)],
        np.arange(3.0 * rows).reshape(rows, 3),
        np.tile([0, 0, 0, 1.0], (rows, 1)),
    )
    found = interpolate(made, np.array([0.0, 500]))
    assert found.refusal.all() if rows < 3 else not found.refusal.any()
    assert not len(interpolate(made, np.zeros(0)).refusal)


def test_rows_that_repeat_an_estimate_do_not_pass_for_new_ones() -> None:
    """A log at 500 Hz of an estimator at 125 Hz: values are up to 8 ms older than their stamps."""
    flight = Flight(5)
    at = np.arange(0.0, 4e6, 2000)
    ran = np.floor(at / 8000) * 8000
    made = track(at + 1e6 + 700, flight.position(ran), flight.attitude(ran).as_quat())
    asked = np.random.default_rng(5).uniform(1.01e6, 4.9e6, 3000)
    found = interpolate(made, asked)
    off = np.linalg.norm(found.position_m - flight.position(asked - 1e6), axis=1)
    assert not found.refusal.any()
    assert (off <= found.position_error_m).mean() > 0.998
    naive = np.stack([np.interp(asked, made.stamp_us, made.position_m[:, axis]) for axis in range(3)], axis=1)
    assert np.median(off) < 0.5 * np.median(np.linalg.norm(naive - flight.position(asked - 1e6), axis=1))


def test_a_robot_that_stands_still_is_where_it_stands() -> None:
    """And not in a hole, though all its rows repeat the first."""
    made = track(range(0, 200_000, 2000), np.ones((100, 3)), np.tile([0, 0, 0, 1.0], (100, 1)))
    found = interpolate(made, np.arange(0.0, 198_000, 333))
    assert not found.refusal.any()
    assert (found.position_m == 1).all()
    assert found.position_error_m.max() == 0


@pytest.mark.parametrize("name", ["flights/jana00", "flights/jana20"])
def test_estimates_of_real_flights_that_were_left_out(name: str) -> None:
    """Every second one, at the times of the others. What motion capture corrects in between is seen in neither."""
    whole = read_track(decode(real(name)))
    rows = np.arange(len(whole.stamp_us))
    new = np.flatnonzero(runs.is_new(whole, rows, rows * 0))
    assert len(new) < 0.6 * len(rows)
    half = track(whole.stamp_us[new[::2]], whole.position_m[new[::2]], whole.attitude[new[::2]])
    others = new[11:-11:2]
    found = interpolate(half, whole.stamp_us[others].astype(float))
    good = found.refusal == 0
    assert good.mean() > 0.95
    off = np.linalg.norm(found.position_m - whole.position_m[others], axis=1)[good]
    assert (off <= found.position_error_m[good]).mean() > 0.8
    assert np.median(off) < 0.0005


def test_estimate_and_motion_capture_agree() -> None:
    log = decode(real("flights/eckart12"))
    poses = read_track(log, "estPose")
    found = interpolate(read_track(log), poses.stamp_us.astype(float))
    good = found.refusal == 0
    assert good.mean() > 0.9
    assert np.median(np.linalg.norm(found.position_m - poses.position_m, axis=1)[good]) < 0.01
