"""The offset between rendered frames and a gyro's log, from the pictures alone, against the simulator's truth."""

import functools
import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from host.clock.camera import Aligned, Refused, align
from host.clock.camera_model import FOCAL, LINE, MIDDLE
from sim.panorama import HALF, Optics, panorama
from sim.turned_camera import Flight, Gyro, Motion, flight

DATA = Path(os.environ.get("SPINDECK_DATA", Path(__file__).resolve().parents[3] / "shared/data"))


class Film:
    """Frames of a flight, rendered once, and not before somebody looks at them."""

    def __init__(self, made: Flight) -> None:
        self.made = made
        self.width, self.height = made.optics.width, made.optics.height
        self.stamp_us = made.stamp_s * 1e6

    @functools.cached_property
    def frames(self) -> list[np.ndarray]:
        return [self.made.frame(index) for index in range(len(self.made.stamp_s))]

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self.frames)


def short(seed: int, motion: Motion = "teeter", seconds: float = 3.0, fps: float = 15.0, **more: object) -> Flight:
    """All in one world: making one takes longest."""
    more = {"world": panorama(1, 183), "optics": HALF, **more}
    return flight(seed, motion, seconds=seconds, fps=fps, **more)  # type: ignore[arg-type]


@functools.cache
def shared() -> tuple[Flight, Film]:
    """One flight for tests that may look at the same."""
    made = short(4, "yaw", seconds=5, fps=12)
    return made, Film(made)


def swung(seed: int, deg_s: float, hz: float, **more: object) -> Flight:
    """To and fro, and nothing else."""
    made = short(seed, "still", **more)  # type: ignore[arg-type]
    made.turned.speed[:, 0] = np.radians(deg_s) * np.sin(2 * np.pi * hz * made.turned.time_s)
    steps = 0.5 * (made.turned.speed[1:] + made.turned.speed[:-1]) * np.diff(made.turned.time_s)[:, None]
    made.turned.angle[1:] = np.cumsum(steps, axis=0)
    return made


def solve(made: Flight, film: Film | None = None, **more: object) -> Aligned | Refused:
    rates = np.radians(made.gyro_deg_s)
    known = {
        "line_s": made.optics.line_s,
        "exposure_s": made.optics.exposure_s,
        "filtered": made.gyro.filtered,
        **more,
    }
    return align(film or Film(made), made.gyro_time_s * 1e6, rates, **known)  # type: ignore[arg-type]


@pytest.mark.parametrize(("motion", "fps", "pitch_deg"), [("teeter", 30, 0), ("yaw", 6, 45), ("yaw", 12, 90)])
def test_from_pictures(motion: Motion, fps: int, pitch_deg: int) -> None:
    made = short(2, motion, fps=fps, seconds=36 / fps + 1, pitch_deg=pitch_deg)
    got = solve(made)
    assert isinstance(got, Aligned), got
    assert abs(got.fitted.theta[MIDDLE] - made.body_middle_s) < 0.1e-3
    assert got.fitted.theta[FOCAL] == pytest.approx(made.optics.focal_px, rel=0.02)
    assert abs(got.line.theta[LINE] - made.optics.line_s) < max(5 * got.line.sigma[LINE], 1e-6)


def test_turns_that_are_too_far_for_a_tile() -> None:
    """Many frames see turns of 0.3 rad and more: tiles that are then found by chance must not outweigh others."""
    made = short(0, "yaw", fps=2.5, seconds=24)
    got = solve(made)
    assert isinstance(got, Aligned), got
    assert abs(got.fitted.theta[MIDDLE] - made.body_middle_s) < 0.1e-3


def test_in_front_of_a_photograph() -> None:
    photographs = sorted((DATA / "panoramas").glob("*.jpg"))
    if not photographs:
        pytest.skip(f"{DATA}/panoramas: no photographs here: they are not part of the project (SPINDECK_DATA)")
    with Image.open(photographs[0]) as image:
        world = np.asarray(image.convert("L").resize((732, 366))).astype(np.float32)
    made = short(3, "yaw", fps=10, seconds=4, world=world)
    got = solve(made)
    assert isinstance(got, Aligned), got
    assert abs(got.fitted.theta[MIDDLE] - made.body_middle_s) < 0.1e-3


def test_without_line_time_and_filters() -> None:
    """The gyro's lag is then in the offset; the middle row's time does not need the readout."""
    made, film = shared()
    got = solve(made, film, line_s=None, filtered=False)
    assert isinstance(got, Aligned), got
    assert not got.line_known
    assert abs(got.fitted.theta[MIDDLE] - made.middle_s) < 0.15e-3


def test_the_papers_procedure() -> None:
    """It tells the frame, and so is off by anything up to a frame's period, and all its readings together by half."""
    made = short(3, "teeter", seconds=5, fps=12)
    got = solve(made)
    assert isinstance(got, Aligned)
    assert got.onsets is not None
    assert len(got.onsets.late_s) >= 4
    late_s = got.onsets.mean_s + made.offset_s
    assert 0 < late_s < 0.1
    assert 0.003 < got.onsets.sd_s < 0.05


@pytest.mark.parametrize(
    ("reason", "made", "more"),
    [
        ("too few frames", {"seconds": 1.0}, {}),
        ("too little rotation", {"motion": "still"}, {}),
        ("too little texture", {"world": np.full((64, 128), 100, np.float32)}, {}),
        ("the pictures do not move with the gyro", {}, {"log_of": 9}),
        ("the log does not cover the frames", {}, {"later_s": 100.0}),
        ("too little rotation", {"motion": "spin", "fps": 30.0}, {}),
        ("too few frames", {"seconds": 32.0, "fps": 1.0}, {}),
        ("the log does not cover the frames", {}, {"rows": 0}),
        ("the log does not cover the frames", {}, {"rows": 1200}),
        ("the log does not cover the frames", {"seconds": 4.0}, {"every": 100}),
        ("too little texture", {"optics": Optics(width=40, height=30)}, {}),
    ],
    ids=lambda each: each if isinstance(each, str) else "",
)
def test_refused(reason: str, made: dict, more: dict) -> None:
    flown = short(1, **{"motion": "teeter", **made})
    log = short(more["log_of"], "yaw") if "log_of" in more else flown
    rates = np.radians(log.gyro_deg_s)
    rows = slice(None, more.get("rows"), more.get("every"))
    times_us = (log.gyro_time_s[rows] + more.get("later_s", 0)) * 1e6
    got = align(Film(flown), times_us, rates[rows], flown.optics.line_s)
    assert isinstance(got, Refused), got
    assert got.reason == reason, got
    assert got.detail


def test_radians_are_not_taken_for_degrees() -> None:
    """Slow ones look like rest; behind fast ones, the lens would have to be 57 times as long as it is."""
    for deg_s in (60.0, 220.0):
        made = swung(1, deg_s, 0.7, seconds=4.0)
        rates = np.radians(made.turned.rate(made.gyro_time_s))
        got = align(Film(made), made.gyro_time_s * 1e6, rates, made.optics.line_s, filtered=False)
        assert isinstance(got, Refused)
        assert "rad/s" in got.detail, got


def test_slow_swings_tell_too_little() -> None:
    made = swung(1, 3.0, 0.15, seconds=7.0, fps=8.0)
    rates = made.turned.rate(made.gyro_time_s)
    got = align(Film(made), made.gyro_time_s * 1e6, rates, made.optics.line_s, filtered=False)
    assert isinstance(got, Refused)
    assert got.reason == "not sure enough"


def test_a_rhythm_fits_at_several_offsets() -> None:
    made = swung(1, 57.3, 2.5)
    rates = made.turned.rate(made.gyro_time_s)
    film = Film(made)
    got = align(film, made.gyro_time_s * 1e6, rates, made.optics.line_s, filtered=False)
    assert isinstance(got, Refused)
    assert got.reason == "several offsets fit"
    near = align(film, made.gyro_time_s * 1e6, rates, made.optics.line_s, filtered=False, reach_s=0.1)
    assert isinstance(near, Aligned)
    assert abs(near.fitted.theta[MIDDLE] - made.body_middle_s) < 0.1e-3


def test_a_hole_in_the_log_costs_only_its_frames() -> None:
    made, film = shared()
    keep = (made.gyro_time_s < 2.0) | (made.gyro_time_s > 2.5)
    rates = np.radians(made.gyro_deg_s[keep])
    got = align(film, made.gyro_time_s[keep] * 1e6, rates, made.optics.line_s, None)
    assert isinstance(got, Aligned), got
    assert abs(got.fitted.theta[MIDDLE] - made.body_middle_s) < 0.15e-3


def test_rendered_rows_are_where_the_truth_says() -> None:
    """A world that is bright on one side of a line: the edge is in each row where that row's own time puts it."""
    half = np.zeros((180, 360), np.float32)
    half[:, :180] = 200
    made = flight(1, "spin", seconds=3, optics=HALF, gyro=Gyro(), world=half)
    index = next(k for k in range(60) if 60 < made.frame(k)[61].mean() < 140)
    picture = made.frame(index).astype(float)
    rows = np.arange(picture.shape[0])
    v = rows - (made.optics.height - 1) / 2
    at_s = made.stamp_s[index] + made.offset_s - made.optics.middle_to_end_s + v * made.optics.line_s
    yaw = made.turned.to_world(at_s)
    heading = np.unwrap(np.arctan2(yaw[:, 1, 0], yaw[:, 0, 0]))
    # Edges are at longitude 0 and 180 degrees; to the left of the picture is a larger longitude.
    edge = np.pi * np.round(heading / np.pi)
    u = np.tan(heading - edge) * made.optics.focal_px + (made.optics.width - 1) / 2
    bright = picture.sum(axis=1) / 200
    seen = bright if picture[61, 0] > 100 else made.optics.width - bright
    assert np.abs(seen - 0.5 - u).max() < 1.0
    assert np.ptp(u) > 0.5
