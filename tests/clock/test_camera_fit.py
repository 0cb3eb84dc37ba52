"""The offset between frames and gyro from places in them, against the simulator's truth and a search by force."""

import dataclasses
import os

import numpy as np
import pytest

from host.clock.camera_fit import Fit, fit, start
from host.clock.camera_model import LINE, MIDDLE, Places, expected, mount, rotation
from host.clock.gyro_filter import LAG_US, NOMINAL_US, as_exposed
from host.clock.turning import Turning, from_vector, to_vector
from sim.turned_camera import Flight, Gyro, Motion, flight

PX = 0.2
DRAWS = int(os.environ.get("SPINDECK_DRAWS", "12"))
PERFECT = Gyro(noise_deg_s=0.0, bias_deg_s=0.0, gain=0.0, quantum_deg_s=1e-9, filtered=False)


def places(made: Flight, px: float = PX, bands: int = 12) -> tuple[Places, Turning, float]:
    """With the true middle_s, which counts from the mean of all stamps."""
    index, before, after = made.band_shifts(bands, px)
    zero_s = float(made.stamp_s.mean())
    stamps = np.stack([made.stamp_s[index], made.stamp_s[index + 1]], axis=1) - zero_s
    inside = (np.abs(after) < [made.optics.width / 2, made.optics.height / 2]).all(axis=1)
    sure = np.tile(np.eye(2) / max(px, 1e-3) ** 2, (len(index), 1, 1))
    time_s = made.gyro_time_s - zero_s
    turning = Turning(
        time_s, as_exposed(time_s, np.radians(made.gyro_deg_s), NOMINAL_US if made.gyro.filtered else None, 0.0)
    )
    return Places(index, stamps, before, after, sure).some(inside), turning, made.body_middle_s


def solve(made: Flight, px: float = PX, line_free: bool = False, off_s: float = 3e-3) -> tuple[Fit, float]:
    """With its error, s."""
    seen, turning, true_s = places(made, px)
    got = fit(seen, turning, mount(0), start(true_s + off_s, made.optics.line_s, 150.0), line_free)
    assert got is not None
    return got, float(got.theta[MIDDLE] - true_s)


@pytest.mark.parametrize("motion", ["teeter", "yaw"])
@pytest.mark.parametrize("fps", [30, 6])
def test_as_good_as_promised(motion: Motion, fps: int) -> None:
    """0.1 ms rms with 0.2 px for each of 12 bands; 40 s in benchmarks/camera_gyro.py."""
    errors = [solve(flight(seed, motion, fps=fps, seconds=12 if fps > 6 else 24))[1] for seed in range(2)]
    assert np.sqrt(np.mean(np.square(errors))) <= 0.1e-3, errors


def test_exact_without_noise() -> None:
    """Twelve unknowns, places to 0.00001 px, and 8 kHz of a perfect gyro: nothing is left but how rates are joined."""
    gyro = Gyro(rate_hz=5000, noise_deg_s=0, bias_deg_s=0, gain=0, quantum_deg_s=1e-9, filtered=False)
    got, error = solve(flight(5, "yaw", seconds=8, gyro=gyro), px=1e-5, line_free=True)
    assert abs(error) < 0.2e-6
    assert got.theta[LINE] == pytest.approx(62.667e-6, rel=1e-4)


def test_the_time_from_row_to_row_comes_out() -> None:
    made = flight(3, "teeter", seconds=20)
    got, error = solve(made, line_free=True)
    assert abs(got.theta[LINE] - made.optics.line_s) < 3.5 * got.sigma[LINE]
    assert got.sigma[LINE] * made.optics.height < 0.2e-3
    assert abs(error) < 0.1e-3


@pytest.mark.parametrize(("fps", "seconds"), [(30, 3), (6, 8)])
def test_the_stated_sigma_is_true(fps: int, seconds: float) -> None:
    """One that is 1.5 times too small, or too large, fails. Of DRAWS of noise in each of four flights;
    SPINDECK_DRAWS=50 for more."""
    off = []
    for seed in range(4):
        made = flight(seed, "yaw" if seed % 2 else "teeter", fps=fps, seconds=seconds)
        clean, turning, true_s = places(made, px=0.0)
        begin, rng = start(true_s + 3e-3, made.optics.line_s, 150.0), np.random.default_rng([seed, fps])
        sure = np.tile(np.eye(2) / PX**2, (len(clean.pair), 1, 1))
        for _ in range(DRAWS):
            after = clean.after + rng.normal(0, PX, clean.after.shape)
            seen = dataclasses.replace(clean, after=after, information=sure)
            got = fit(seen, turning, mount(0), begin, line_free=False)
            assert got is not None
            off.append((got.theta[MIDDLE] - true_s) / got.sigma[MIDDLE])
    assert 0.65 < np.sqrt(np.mean(np.square(off))) < 1.1, off
    assert (np.abs(off) < 2.58).mean() > 0.95, off


def test_a_search_by_force_finds_the_same() -> None:
    """A camera that turns about its upright alone sees u = -f tan(turn) in the middle of a row, wherever the row is.
    No rotation, quaternion or derivative in here: times on a grid of 5 us, and lines through points."""
    made = flight(7, "yaw", seconds=12, gyro=PERFECT)
    made.turned.speed[:, 1:] = 0
    made.turned.angle[:, 1:] = 0
    clean = np.degrees(made.turned.rate(made.gyro_time_s))
    noise = np.random.default_rng(7).normal(0, 0.1, clean.shape)
    made = Flight(made.turned, made.optics, made.to_camera, made.gyro_time_s, clean + noise, made.stamp_s,
                  made.offset_s, PERFECT, made.seed)  # fmt: skip
    seen, turning, true_s = places(made)
    yaw = np.concatenate([[0], np.cumsum(0.5 * np.diff(turning.time_s) * (turning.rate_rad_s[1:, 2] +
                                                                          turning.rate_rad_s[:-1, 2]))])  # fmt: skip

    def left(middle_s: float) -> float:
        at = seen.stamps_s + middle_s + made.optics.line_s * np.stack([seen.before[:, 1], seen.after[:, 1]], axis=1)
        turn = np.diff(np.interp(at, turning.time_s, yaw), axis=1)[:, 0]
        u = seen.after[:, 0]
        table = np.stack([np.tan(turn), np.diff(at, axis=1)[:, 0] / np.cos(turn) ** 2], axis=1)
        return float(np.sum((u - table @ np.linalg.lstsq(table, u, rcond=None)[0]) ** 2))

    around = true_s + np.arange(-60, 61) * 5e-6
    forced = around[np.argmin([left(each) for each in around])]
    got = fit(seen, turning, mount(0), start(true_s + 3e-3, made.optics.line_s, 150.0), line_free=False)
    assert got is not None
    assert abs(got.theta[MIDDLE] - forced) < 0.7 * got.sigma[MIDDLE] + 5e-6
    assert abs(forced - true_s) < 4 * got.sigma[MIDDLE]


def test_wild_places_hardly_count() -> None:
    made = flight(2, "teeter", seconds=20)
    seen, turning, true_s = places(made)
    rng = np.random.default_rng(0)
    wild = rng.random(len(seen.pair)) < 0.1
    seen.after[wild] += rng.normal(0, 20, (int(wild.sum()), 2))
    got = fit(seen, turning, mount(0), start(true_s + 2e-3, made.optics.line_s, 150.0), line_free=False)
    assert got is not None
    assert abs(got.theta[MIDDLE] - true_s) < 0.1e-3
    assert np.median(got.weight[wild]) < 0.01


@pytest.mark.parametrize("pitch_deg", [0, 45, 90])
def test_every_mount(pitch_deg: float) -> None:
    """Upwards, a spin turns the picture about its middle, where nothing moves: bands there see only roll and pitch."""
    made = flight(4, "yaw", seconds=20, pitch_deg=pitch_deg)
    seen, turning, true_s = places(made)
    begin = start(true_s - 2e-3, made.optics.line_s, 190.0)
    got = fit(seen, turning, mount(pitch_deg + 4, 3), begin, line_free=False)
    assert got is not None
    assert abs(got.theta[MIDDLE] - true_s) < 4 * got.sigma[MIDDLE] + 30e-6


def test_rotations_against_scipy() -> None:
    scipy = pytest.importorskip("scipy.spatial.transform")
    rng = np.random.default_rng(1)
    vectors = np.concatenate([rng.normal(size=(50, 3)), 1e-9 * rng.normal(size=(5, 3)), np.zeros((1, 3))])
    theirs = scipy.Rotation.from_rotvec(vectors)
    assert np.allclose([rotation(each) for each in vectors], theirs.as_matrix(), atol=1e-14)
    assert np.allclose(to_vector(from_vector(vectors)), theirs.as_rotvec(), atol=1e-12)
    time_s = np.sort(rng.uniform(0, 1, 200))
    rates = np.tile([1.0, -2.0, 0.5], (200, 1))
    turning = Turning(time_s, rates)
    between = turning.between(np.array([0.2, 0.9]), np.array([0.7, 0.3]))
    assert np.allclose(between, np.outer([0.5, -0.6], rates[0]), atol=1e-12)


def test_the_gyros_filters_are_undone() -> None:
    gyro = Gyro(noise_deg_s=0.0, bias_deg_s=0.0, gain=0.0, quantum_deg_s=1e-9)
    made = flight(1, "teeter", seconds=8, gyro=gyro)
    true, logged = made.turned.rate(made.gyro_time_s), np.radians(made.gyro_deg_s)
    back = as_exposed(made.gyro_time_s, logged, NOMINAL_US, 0.0)
    assert np.abs(np.cumsum(logged - true, axis=0)).max() > 5 * np.abs(np.cumsum(back - true, axis=0)).max()
    assert LAG_US * 1e-6 == pytest.approx(gyro.lag_s, rel=1e-6) == pytest.approx(4.52e-3, rel=1e-3)
    # Slow motion is late by that lag.
    slow = flight(1, "yaw", seconds=8, gyro=gyro)
    moved = slow.turned.rate(slow.gyro_time_s - gyro.lag_s)
    assert np.abs(np.radians(slow.gyro_deg_s) - moved).max() < 2e-3 * np.abs(moved).max()


def test_gaps_in_the_log_are_not_bridged() -> None:
    time_s = np.concatenate([np.arange(0, 1, 0.001), np.arange(1.2, 2, 0.001)])
    turning = Turning(time_s, np.zeros((len(time_s), 3)))
    first, last = np.array([0.1, 0.9, 1.1, 1.3, -0.1, 1.9]), np.array([0.5, 1.3, 1.15, 1.7, 0.2, 2.1])
    assert turning.is_known(first, last).tolist() == [True, False, False, True, False, False]


def test_where_things_are_expected_is_where_they_are() -> None:
    made = flight(6, "yaw", seconds=6, gyro=PERFECT)
    seen, turning, true_s = places(made, px=0.0)
    theta = start(true_s, made.optics.line_s, made.optics.focal_px)
    assert np.abs(expected(theta, mount(0), turning, seen.stamps_s, seen.before) - seen.after).max() < 0.01
