"""`host sync camera`: what it takes out of a recording and a log, and what it says."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..clock.camera import Aligned, Refused, align
from ..clock.camera_model import BEND, FOCAL, LINE, MIDDLE, MOUNT, SKEW, rotation
from ..clock.gyro_filter import LAG_LESS_US, LAG_MORE_US
from ..protocol.errors import LocalError, PeerError
from . import sync_camera_film, sync_stamps
from .as_json import line
from .sync_camera_film import Recorded
from .sync_gyro import source_of
from .sync_stamps_read import read
from .usd import load, warn

END, MIDDLE_ROW = "end of frame", "middle of exposure of the middle row"
UNSEEN = "parallax of a robot that is carried about; how late rows of the log are stamped"
ASSUMED = (
    f"how many poles the sensor's own filter has: with one the log would be {LAG_LESS_US / 1000:.1f} ms less late, with"
    f" three {LAG_MORE_US / 1000:.1f} ms more"
)
LEFT_IN = "the lag of the gyro's filters, if it has any"


def run(arguments: argparse.Namespace) -> int:
    """4 if the offset is refused."""
    from ..link.replay import Recording
    from .sync_camera_plot import shapes
    from .sync_plot import new_picture

    check(arguments)
    with new_picture(arguments.plot, arguments.force) as draw:
        recording = Recording(arguments.file)
        robot = recording.source(arguments.robot).number
        several = len(recording.sources) > 1 and arguments.robot is None
        recording.close()
        if several:
            raise LocalError(f"{arguments.file}: of several robots: choose the log's with --robot")
        log = load(arguments.log, examined=False)[0]
        source = source_of(arguments.log, arguments.log, log)
        warn(arguments.log, log)
        times = None if arguments.own_times else restamped(arguments.file, robot)
        film = sync_camera_film.read(arguments.file, robot, times, arguments.line_time_us, arguments.exposure_us)
        found = align(
            film,
            source.gyro.time_us / film.stm32_per_s,
            np.radians(source.gyro.rate_dps),
            None if film.line_us is None else film.line_us * 1e-6,
            None if film.exposure_us is None else film.exposure_us * 1e-6,
            not arguments.raw_gyro,
            arguments.within_ms * 1e-3,
        )
        record = {
            "event": "camera",
            "file": arguments.file,
            "log": arguments.log,
            "robot": robot,
            "frames": len(film.index),
            "frames_left_out": dict(film.left_out),
            "rows_left_out": source.left_out,
            "times": "stamped" if times is None else "restamped",
            "bound_us_median": None if film.bound_us is None else round(film.bound_us, 1),
        }
        if isinstance(found, Refused):
            if arguments.json:
                print(line({**record, "refused": found.reason, "detail": found.detail}))
            raise PeerError(f"{arguments.file} and {arguments.log}: {found.reason}: {found.detail}")
        record |= estimates(film, found)
        print(line(record) if arguments.json else "\n".join(lines(record)))
        if draw:
            draw(shapes(found, film.stm32_per_s), 3)
    return 0


def check(arguments: argparse.Namespace) -> None:
    for option, value in (("--line-time-us", arguments.line_time_us), ("--exposure-us", arguments.exposure_us)):
        if value is not None and not 0 < value < 1e6:
            raise LocalError(f"{option} {value:g}: microseconds, more than 0")
    if not 1 <= arguments.within_ms <= 10_000:
        raise LocalError(f"--within-ms {arguments.within_ms:g}: 1 to 10000")


def restamped(file: str, robot: int) -> dict[int, tuple[float, float]] | None:
    """Times and bounds by frame, from all messages; None when the frames' own times are all there is."""
    source = read(file, robot)
    made = sync_stamps.work_out(source) if "native" in source.dialects or "nanocockpit" in source.dialects else None
    if made is None or not len(made.frame):
        return None
    times = zip(made.frame.tolist(), made.stm32_us.tolist(), made.bound_us.tolist(), strict=True)
    return {source.index[place]: (at_us, bound_us) for place, at_us, bound_us in times}


def estimates(film: Recorded, found: Aligned) -> dict[str, Any]:
    """The fit in the units of the clocks."""
    theta, sigma = found.fitted.theta, found.fitted.sigma
    ahead = (rotation(theta[MOUNT : MOUNT + 3]) @ found.assumed)[2]
    known = film.before_end_us is not None
    begun = found.onsets
    stm32_us = 1e6 * film.stm32_per_s  # What is added to a stamp has to be on its clock.
    return {
        "of": END if known else MIDDLE_ROW,
        "offset_us": round(float(theta[MIDDLE]) * stm32_us, 1),
        "offset_sigma_us": round(float(sigma[MIDDLE]) * stm32_us, 1),
        "skew_ppm": round(float(theta[SKEW]) * 1e6, 2),
        "skew_sigma_ppm": round(float(sigma[SKEW]) * 1e6, 2),
        "end_after_middle_us": film.before_end_us and round(film.before_end_us, 1),
        "line_time_us": None if film.line_us is None else round(film.line_us, 3),
        "line_time_seen_us": round(float(found.line.theta[LINE]) * 1e6, 3),
        "line_time_seen_sigma_us": round(float(found.line.sigma[LINE]) * 1e6, 3),
        "focal_px": round(float(theta[FOCAL]), 2),
        "focal_sigma_px": round(float(sigma[FOCAL]), 2),
        "lens_bend": round(float(theta[BEND]), 4),
        "looks_up_deg": round(float(np.degrees(np.arcsin(np.clip(ahead[2], -1, 1)))), 1),
        "picture_turned_deg": found.first.roll_deg,
        "gyro_lag_us": round(found.gyro_late_us, 1),
        "pairs": len(np.unique(found.places.pair)),
        "patches": len(found.places.pair),
        "residual_px": round(float(np.median(np.abs(found.fitted.residual_px))) * 1.4826, 4),
        "explained": round(found.explained, 5),
        "paper": None
        if begun is None
        else {
            "events": len(begun.late_s),
            "mean_us": round(begun.mean_s * 1e6 + (film.before_end_us or 0)),
            "sd_us": round(begun.sd_s * 1e6),
        },
        "not_in_sigma": f"{UNSEEN}; {ASSUMED if found.gyro_late_us else LEFT_IN}",
    }


def lines(record: dict[str, Any]) -> Iterator[str]:
    """For people."""
    yield f"{record['file']}, robot {record['robot']}, against {record['log']}: {record['frames']} frames"
    for why, count in record["frames_left_out"].items():
        yield f"  left out  {count} frames {why}"
    if record["rows_left_out"]:
        yield f"  left out  {record['rows_left_out']} rows of the log: of another epoch, out of order, or no number"
    bound = "" if record["bound_us_median"] is None else f", ± {record['bound_us_median']:.1f} us"
    whose = "the robot's own" if record["times"] == "stamped" else "worked out from all messages"
    yield f"  times     {whose}{bound}; taken for the {record['of']}"
    later = "later" if record["offset_us"] >= 0 else "earlier"
    yield (
        f"  offset    frames were {abs(record['offset_us']):.1f} us {later} by the gyro's log, ±"
        f" {record['offset_sigma_us']:.1f} us (one sigma)"
    )
    yield f"  skew      {record['skew_ppm']:+.1f} ± {record['skew_sigma_ppm']:.1f} ppm (the log against the frames)"
    if record["gyro_lag_us"]:
        yield f"  filters   {record['gyro_lag_us']:.0f} us taken off: the gyro's, of 116 Hz (two poles) and 80"
    said = "not known" if record["line_time_us"] is None else f"said to be {record['line_time_us']:.2f} us"
    seen = f"{record['line_time_seen_us']:.2f} ± {record['line_time_seen_sigma_us']:.2f} us"
    yield f"  rows      from row to row {said}; pictures say {seen}{doubt(record)}"
    yield (
        f"  camera    focal length {record['focal_px']:.1f} ± {record['focal_sigma_px']:.1f} px, looks up by"
        f" {record['looks_up_deg']:.0f} degrees, picture turned by {record['picture_turned_deg']:.0f}"
    )
    yield (
        f"  patches   {record['patches']} in {record['pairs']} pairs of frames, to {record['residual_px']:.3f} px;"
        f" {record['explained']:.2%} of their motion goes with the gyro"
    )
    if record["paper"]:
        paper = record["paper"]
        yield (
            f"  paper     first frame that has moved, less the gyro's onset: {paper['mean_us'] / 1000:+.1f} ±"
            f" {paper['sd_us'] / 1000:.1f} ms in {paper['events']} events"
        )
    yield f"  unseen    {record['not_in_sigma']}"


def doubt(record: dict[str, Any]) -> str:
    """A line time that the pictures contradict puts the end of frame off, not the middle row."""
    if record["line_time_us"] is None:
        return ""
    away = abs(record["line_time_us"] - record["line_time_seen_us"])
    return ": they do not agree" if away > 5 * record["line_time_seen_sigma_us"] + 0.01 * record["line_time_us"] else ""
