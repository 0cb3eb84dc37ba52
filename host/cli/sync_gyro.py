"""`host sync gyro`: what it takes out of two logs, and what it says."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..clock.gyro import Gyro, Refused, Shift, compare
from ..clock.gyro_align import RATES
from ..clock.gyro_paper import PaperShift, paper_shift
from ..clock.ticks import Floats
from ..protocol.errors import LocalError, PeerError
from ..usd.log import Log, Rows
from ..usd.units import unit_of
from .as_json import line
from .sync_robots import labelled
from .usd import load, warn

GYROS = (("gyro", ("x", "y", "z")), ("stateEstimateZ", ("rateRoll", "ratePitch", "rateYaw")))
"""Groups of variables, the first that is there; each logged as the firmware's filter left it."""
IN_DPS = {"deg/s": 1.0, "mrad/s": 0.18 / np.pi, "rad/s": 180 / np.pi}
UNSEEN = (
    "a delay of one gyro that the other does not have (stamps taken late, asynchronous logging, another filter): no"
    " gyro tells it from the clock"
)


@dataclass(frozen=True, slots=True)
class Source:
    """What one log has."""

    label: str
    names: tuple[str, ...]
    gyro: Gyro
    left_out: int
    """Rows of other epochs, and those whose stamps do not go on."""


def run(arguments: argparse.Namespace) -> int:
    """4 if the shift is refused."""
    from .sync_gyro_plot import shapes
    from .sync_plot import new_picture

    if arguments.first == arguments.second:
        raise LocalError(f"{arguments.first}: given twice: give the logs of two robots")
    with new_picture(arguments.plot, arguments.force) as draw:
        files = [arguments.first, arguments.second]
        logs = [load(name, examined=False)[0] for name in files]
        first, second = (
            source_of(label, name, log) for label, name, log in zip(labelled(files), files, logs, strict=True)
        )
        for name, log in zip(files, logs, strict=True):
            warn(name, log)
        found = compare(first.gyro, second.gyro)
        if isinstance(found, Refused):
            if arguments.json:
                print(line({**heading(first, second), "refused": found.why}))
            raise PeerError(f"{first.label} and {second.label}: {found.why}")
        paper = paper_shift(found.first, found.second, found.shift_us)
        if arguments.json:
            print(line(as_record(first, second, found, paper)))
        else:
            print("\n".join(lines(first, second, found, paper)))
        if draw:
            draw(shapes(found, first.label, second.label), 3)
    return 0


def source_of(label: str, file: str, log: Log) -> Source:
    """The gyro's rows of the log's longest epoch. PeerError if it has none."""
    if not any(len(rows) for rows in log.rows.values()):
        raise PeerError(f"{file}: no rows: see 'host usd check'")
    for group, axes in GYROS:
        names = tuple(f"{group}.{axis}" for axis in axes)
        having = [rows for rows in log.rows.values() if set(names) <= set(rows.data.dtype.names or ()) and len(rows)]
        if having:
            return of_rows(label, max(having, key=len), names)
    raise PeerError(f"{file}: no gyro in it: log gyro.x, gyro.y and gyro.z, at 500 Hz or more")


def of_rows(label: str, rows: Rows, names: tuple[str, ...]) -> Source:
    part = max(rows.epochs, key=len)
    data = rows.data[part.start : part.stop]
    time_us = rows.stamp_us[part.start : part.stop].astype(np.float64)
    rate = np.stack([data[name].astype(np.float64) * IN_DPS[unit_of(name)] for name in names], axis=1)
    good = goes_on(time_us) & np.isfinite(rate).all(axis=1)
    return Source(label, names, Gyro(time_us[good], rate[good]), len(rows) - int(good.sum()))


def goes_on(time_us: Floats) -> NDArray[np.bool_]:
    """Where a time is later than all before it."""
    return np.diff(np.maximum.accumulate(time_us), prepend=-np.inf) > 0


def heading(first: Source, second: Source) -> dict[str, Any]:
    return {
        "event": "gyro",
        "first": first.label,
        "second": second.label,
        "variables": list(first.names),
        "rows": [len(first.gyro.time_us), len(second.gyro.time_us)],
        "rows_left_out": [first.left_out, second.left_out],
    }


def as_record(first: Source, second: Source, found: Shift, paper: PaperShift | None) -> dict[str, Any]:
    """For a program."""
    return {
        **heading(first, second),
        "shift_us": round(found.shift_us, 3),
        "sigma_us": round(found.sigma_us, 3),
        "at_us": round(found.at_us, 1),
        "slope_ppm": round(found.skew_ppm, 4),
        "slope_sigma_ppm": round(found.skew_sigma_ppm, 4),
        "bend_ppm": round(found.bend_ppm, 4),
        "start_us": round(found.start_us, 3),
        "start_sigma_us": round(found.start_sigma_us, 3),
        "counts_84_of_85": counts_84_of_85(first, second, found),
        "gain": round(found.gain, 5),
        "bias_dps": round(found.bias_dps, 4),
        "noise_dps": round(found.noise_dps, 4),
        "explained": round(found.explained, 5),
        "filter_us": round(found.filter_us, 3),
        "span_s": round(found.span_s, 3),
        "events": [
            {"at_us": round(each.at_us), "weight": round(each.weight, 4), "shift_us": round(each.shift_us, 2)}
            for each in found.events
        ],
        "paper_us": paper and paper.mean_us,
        "paper_sd_us": paper and round(paper.sd_us, 1),
        "paper_cases_us": paper and list(paper.cases_us),
        "not_in_sigma": UNSEEN,
    }


def counts_84_of_85(first: Source, second: Source, found: Shift) -> str | None:
    """Whose clock does, if only one does."""
    ratio = 1 + found.skew_ppm * 1e-6
    near = min(RATES, key=lambda rate: abs(rate * ratio - 1))
    return None if near == 1 else first.label if near < 1 else second.label


def lines(first: Source, second: Source, found: Shift, paper: PaperShift | None) -> Iterator[str]:
    """For people."""
    yield f"{second.label} against {first.label}, by {', '.join(first.names)}"
    yield (
        f"  turned    alike in {len(found.events)} events over {found.span_s:.1f} s: one gyro explains"
        f" {found.explained:.2%} of the other, {found.noise_dps:.2g} deg/s are left"
    )
    yield (
        f"  shift     {found.shift_us:+.1f} ± {found.sigma_us:.1f} us (second clock less first) when the first says"
        f" {found.at_us * 1e-6:.3f} s"
    )
    yield f"            {found.start_us:+.1f} ± {found.start_sigma_us:.1f} us at 0, had both run as now since then"
    slow = counts_84_of_85(first, second, found)
    said = f"; {slow} counts 84 where 85 have passed" if slow else ""
    yield f"  slope     {found.skew_ppm:+.3f} ± {found.skew_sigma_ppm:.3f} ppm{said}"
    if found.bend_ppm:
        yield f"  bends     the slope changes by {abs(found.bend_ppm):.3f} ppm to a usual event: that is in each ±"
    yield f"  gain      {found.gain:.4f}, bias {found.bias_dps:+.3f} deg/s (first against second)"
    yield (
        f"  filters   {found.filter_us:+.2f} us taken off: so much later is the second gyro, as its samples come at"
        " another rate"
    )
    if paper:
        cases = ", ".join(f"{each:+.0f}" for each in paper.cases_us)
        yield f"  paper's   {paper.mean_us:+.0f} ± {paper.sd_us:.0f} us: one shift each for four quarters: {cases}"
    yield "  ± is one sigma, by leaving out each event in turn (paper's: the quarters' scatter)"
    yield f"  unseen    {UNSEEN}"
    for each in (first, second):
        if each.left_out:
            yield f"  left out  {each.left_out} rows of {each.label}: of other epochs, out of order, or no number"
