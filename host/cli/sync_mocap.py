"""`host sync mocap`: what it takes out of a log, and what it says."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..clock.gyro import Refused
from ..clock.gyro_filter import LAG_LESS_US, LAG_MORE_US, late_us, sample_us
from ..clock.lag import Attitudes, Lag, lag_of
from ..protocol.errors import LocalError, PeerError
from ..usd.log import Log
from ..usd.track import Track, read_track
from .as_json import line
from .sync_gyro import Source, goes_on, source_of
from .usd import load, warn

SOURCES = ("estPose", "stateEstimate", "stateEstimateZ")
"""Attitudes that are looked for: motion capture's as it was received, and the estimator's."""


def run(arguments: argparse.Namespace) -> int:
    """4 if nothing is known of any."""
    from .sync_mocap_plot import SHOWN, shapes
    from .sync_plot import new_picture

    with new_picture(arguments.plot, arguments.force) as draw:
        log, _ = load(arguments.file, examined=False)
        gyro = source_of(arguments.file, arguments.file, log)
        tracks = tracks_of(arguments.file, log, arguments.source)
        warn(arguments.file, log)
        found = {track.name: measure(track, gyro) for track in tracks}
        known = {name: each for name, each in found.items() if isinstance(each, Lag)}
        if arguments.json:
            for record in records(arguments.file, gyro, found):
                print(line(record))
        elif known:
            print("\n".join(lines(arguments.file, gyro, found)))
        if not known:
            reasons = dict.fromkeys(why(each) for each in found.values())
            raise PeerError(f"{arguments.file}: no lag of {', '.join(found)} is known: {'; '.join(reasons)}")
        if draw:
            draw(shapes(known), 1 + min(len(known), SHOWN))
    return 0


def tracks_of(file: str, log: Log, source: str | None) -> list[Track]:
    """Those with attitudes. PeerError if there are none; LocalError if `source` is none."""
    tracks = []
    for name in [source] if source else SOURCES:
        try:
            track = read_track(log, name)
        except LocalError as error:
            if source:
                raise LocalError(f"{file}: {error}") from error
            continue
        if track.attitude is not None:
            tracks.append(track)
    if not tracks:
        raise PeerError(f"{file}: no attitude in it: log locSrv.qx to .qw on:estPose, or stateEstimate.qx to .qw")
    return tracks


def measure(track: Track, gyro: Source) -> Lag | Refused:
    return lag_of(attitudes_of(track, gyro), gyro.gyro)


def attitudes_of(track: Track, gyro: Source) -> Attitudes:
    """In the gyro's epoch; a row that repeats the one before is left out, as its attitude is older than its stamp."""
    assert track.attitude is not None
    first_us, last_us = gyro.gyro.time_us[0], gyro.gyro.time_us[-1]
    part = max(
        track.epochs,
        key=lambda rows: overlap(track.stamp_us[rows.start : rows.stop].astype(np.float64), first_us, last_us),
    )
    time_us = track.stamp_us[part.start : part.stop].astype(np.float64)
    attitude = track.attitude[part.start : part.stop]
    kept = goes_on(time_us) & (np.diff(attitude, axis=0, prepend=np.nan) != 0).any(axis=1)
    return Attitudes(time_us[kept], attitude[kept])


def overlap(time_us: Any, first_us: float, last_us: float) -> int:
    return int(((time_us >= first_us) & (time_us <= last_us)).sum())


def why(each: Lag | Refused) -> str:
    return each.why if isinstance(each, Refused) else ""


def records(file: str, gyro: Source, found: dict[str, Lag | Refused]) -> Iterator[dict[str, Any]]:
    """For a program."""
    for name, each in found.items():
        record = {"event": "lag", "file": file, "source": name, "gyro": list(gyro.names)}
        if isinstance(each, Refused):
            yield {**record, "refused": each.why}
            continue
        yield {
            **record,
            "lag_us": round(each.behind_motion_us, 1),
            "sigma_us": round(each.sigma_us, 1),
            "behind_gyro_us": round(each.lag_us, 1),
            "gyro_behind_motion_us": round(each.behind_motion_us - each.lag_us, 1),
            "gain": round(each.gain, 4),
            "mount_deg": [round(axis, 2) for axis in each.mount_deg],
            "noise_deg": round(each.noise_deg, 4),
            "rate_dps": round(each.rate_dps, 2),
            "poses": each.poses,
            "outliers": each.outliers,
            "segments": each.segments,
        }


def lines(file: str, gyro: Source, found: dict[str, Lag | Refused]) -> Iterator[str]:
    """For people."""
    yield f"{file}: attitudes against the integral of {', '.join(gyro.names)}"
    for name, each in found.items():
        if isinstance(each, Refused):
            yield f"  {name:26} refused: {each.why}"
            continue
        yield (
            f"  {name:26} {each.behind_motion_us / 1000:+.3f} ± {each.sigma_us / 1000:.3f} ms behind the motion"
            f" ({each.lag_us / 1000:+.3f} behind the gyro)"
        )
        mount = ", ".join(f"{axis:+.1f}" for axis in each.mount_deg)
        yield (
            f"  {'':26} {each.poses} attitudes in {each.segments} s, turning {each.rate_dps:.0f} deg/s rms;"
            f" {each.noise_deg:.2g} deg left; gain {each.gain:.3f}, mount {mount} deg"
        )
    yield "  ± is one sigma, by leaving out each second in turn"
    filters_us = late_us(sample_us(gyro.gyro.time_us))
    yield (
        f"  the gyro's filters are taken to be {filters_us / 1000:.2f} ms late: 80 Hz in the firmware, 116 Hz in the"
        f" sensor, with two poles (one: {LAG_LESS_US / 1000:.1f} ms less, three: {LAG_MORE_US / 1000:.1f} ms more)"
    )
    for name, each in found.items():
        if isinstance(each, Lag):
            lag = f"{each.behind_motion_us:.0f}±{each.sigma_us:.0f}"
            yield f"  to annotate: host usd interpolate LOG --source {name} --lag-us {lag}"
