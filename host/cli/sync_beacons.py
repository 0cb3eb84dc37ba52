"""`host sync robots` with beacons: what it takes out of logs, and what it says."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import asdict, replace
from itertools import combinations
from typing import Any

import numpy as np

from ..clock.beacons import BEACONS_MIN, Against, Beacons, Between, against_host, between, collect
from ..protocol.errors import PeerError
from ..usd.host_log import EVENT as SENT
from ..usd.log import Log
from . import sync_resets
from .as_json import line
from .sync_plot import Draw
from .sync_robots_plot import by_beacons

EVENT = "beacon"
VALUES = ("sequence", "hostUs", "hostUsHigh")
QUICK = 0.75
"""Of the beacons that a host's log tells of. Fewer would be sharper, and too few."""


def has_beacons(log: Log) -> bool:
    rows = log.rows.get(event_of(log))
    return rows is not None and len(rows) > 0 and set(VALUES) <= set(rows.data.dtype.names or ())


def event_of(log: Log) -> str:
    """What a robot has heard; of a host's own log, what it has sent."""
    return SENT if is_host(log) else EVENT


def is_host(log: Log) -> bool:
    return EVENT not in log.rows and SENT in log.rows


def compare(labels: Sequence[str], logs: Sequence[Log], arguments: argparse.Namespace, draw: Draw | None) -> int:
    """Prints what beacons tell of these robots."""
    chosen = quick(logs)
    heard = [noted(log) for log in logs]
    fits = [against(*each, chosen) for each in zip(labels, heard, strict=True)]
    pairs = []
    for first, second in combinations(range(len(fits)), 2):
        pair = between(first, second, fits[first], fits[second])
        if pair is None:
            raise PeerError(f"{labels[first]} and {labels[second]}: not one beacon in common: logs of two runs?")
        pairs.append(pair)
    if arguments.json:
        for record in records(labels, heard, fits, pairs):
            print(line(record))
    else:
        print("\n".join(lines(labels, heard, fits, pairs)))
    if draw:
        draw(by_beacons(labels, fits), 3)
    robots = [number for number, log in enumerate(logs) if not is_host(log)]
    own, names = [logs[each] for each in robots], [labels[each] for each in robots]
    if arguments.reset or sync_resets.were_reset(own):
        sync_resets.tell(names, own, [zero(fits[each], logs[each]) for each in robots], arguments)
    return 0


def zero(fit: Against, log: Log) -> tuple[float, float]:
    """The host's time at which the robot's clock was at 0, and its bound: infinite if not its last reset is meant."""
    if epoch_of(log) != len(log.epochs) - 1:
        return 0.0, np.inf
    host_us = float(fit.beacons.host_us[0])
    for _ in range(4):
        offset, bound = fit.at(np.array([host_us]))
        host_us -= float(host_us + offset[0])
    return host_us, float(bound[0])


def noted(log: Log) -> Beacons:
    """The beacons of the epoch that has most of them: between two resets of the robot's clock."""
    rows = log.rows[event_of(log)]
    part = rows.epochs[epoch_of(log)]
    mine = slice(part.start, part.stop)
    sequence, low, high = (rows.data[name][mine].astype(np.int64) for name in VALUES)
    return collect(sequence, low + (high << 32), rows.stamp_us[mine].astype(np.int64))


def quick(logs: Sequence[Log]) -> set[tuple[int, int]] | None:
    """Number and time of those that were quickest to the dongle, by the hosts' own logs. None: there is no such log.

    How late a host sends is in all robots alike, but differently each time, which blurs the edge that all fits go by.
    Its own log says of each beacon how late it was at most."""
    hosts = [noted(log) for log in logs if is_host(log)]
    found: set[tuple[int, int]] = set()
    for each in hosts:
        took_us = each.local_us - each.host_us
        fast = took_us <= np.quantile(took_us, QUICK)
        found |= set(zip(each.sequence[fast].tolist(), each.host_us[fast].tolist(), strict=True))
    return found if hosts else None


def against(label: str, heard: Beacons, chosen: set[tuple[int, int]] | None) -> Against:
    """By the chosen ones, if they are enough."""
    fit = None
    if chosen is not None:
        kept = np.array([each in chosen for each in zip(heard.sequence.tolist(), heard.host_us.tolist(), strict=True)])
        fit = against_host(
            replace(heard, sequence=heard.sequence[kept], host_us=heard.host_us[kept], local_us=heard.local_us[kept])
        )
    fit = fit or against_host(heard)
    if fit is None:
        raise PeerError(
            f"{label}: {len(heard)} beacons of one run of the host; at least {BEACONS_MIN} are needed"
            " (--variable goes by broadcasts of motion capture)"
        )
    return fit


def epoch_of(log: Log) -> int:
    parts = log.rows[event_of(log)].epochs
    return max(range(len(parts)), key=lambda number: len(parts[number]))


def to_host(fit: Against) -> tuple[float, float, float, float]:
    """In the middle of its beacons: host's time, offset, bound; and the greatest bound from first to last."""
    host_us = np.linspace(fit.beacons.host_us[0], fit.beacons.host_us[-1], 201)
    offset, bound = fit.at(host_us)
    middle = len(host_us) // 2
    return float(host_us[middle]), float(offset[middle]), float(bound[middle]), float(bound.max())


def records(
    labels: Sequence[str], heard: Sequence[Beacons], fits: Sequence[Against], pairs: Sequence[Between]
) -> Iterator[dict[str, Any]]:
    for label, beacons, fit in zip(labels, heard, fits, strict=True):
        at_us, offset, bound, worst = to_host(fit)
        yield {
            "event": "robot",
            "log": label,
            "beacons": len(beacons),
            "lost": beacons.lost,
            "left_out_as_slow": len(beacons) - len(fit.beacons),
            "repeated": fit.beacons.repeated,
            "of_other_runs": fit.beacons.other_runs,
            "drift_ppm": round(fit.drift_ppm, 3),
            "counts_84_of_85": fit.is_slow if fit.is_clear else None,
            "delay_us": round(fit.delay_us, 1),
            "at_host_us": round(at_us),
            "host_offset_us": round(offset, 1),
            "host_bound_us": bounded(bound),
            "host_bound_us_max": bounded(worst),
        }
    for pair in pairs:
        values = {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(pair).items()}
        values |= {"bound_us": bounded(pair.bound_us), "worst_us": bounded(pair.worst_us)}
        values |= {"slope_bound_ppm": bounded(pair.slope_bound_ppm)}
        yield {"event": "pair", **values, "first": labels[pair.first], "second": labels[pair.second]}


def bounded(value: float) -> float | None:
    """None: no beacon is near, and there is no bound."""
    return round(value, 3) if np.isfinite(value) else None


def lines(
    labels: Sequence[str], heard: Sequence[Beacons], fits: Sequence[Against], pairs: Sequence[Between]
) -> Iterator[str]:
    wide = max(32, *(len(f"{labels[pair.second]} against {labels[pair.first]}") for pair in pairs)) + 1
    ends = f"{'offset, us':>18}{'± us':>8}{'worst':>8}"
    yield f"{'robot against host':{wide}}{'beacons':>8}{'lost':>6}{'drift, ppm':>12}{ends}"
    for label, beacons, fit in zip(labels, heard, fits, strict=True):
        _, offset, bound, worst = to_host(fit)
        yield (
            f"{label:{wide}}{len(beacons):8}{beacons.lost:6}{fit.drift_ppm:+12.2f}{offset:+18.1f}"
            f"{shown(bound)}{shown(worst)}"
        )
    for label, beacons, fit in zip(labels, heard, fits, strict=True):
        yield from (f"  {label}: {each}" for each in notes(beacons, fit))
    yield ""
    yield f"{'second against first':{wide}}{'common':>8}{'slope, ppm':>18}{ends}"
    for pair in pairs:
        name = f"{labels[pair.second]} against {labels[pair.first]}"
        slope = f"{pair.slope_ppm:+.3f} ±{shown(pair.slope_bound_ppm, 3).strip():>6}"
        yield (
            f"{name:{wide}}{pair.common:8}{slope:>18}{pair.offset_us:+18.1f}{shown(pair.bound_us)}{shown(pair.worst_us)}"
        )
    yield "Offsets are in the middle of what was heard; bounds hold for 99 %. How late the host itself sends is in none"
    yield "against the host; what comes later on one robot always is in none at all."


def shown(value: float, digits: int = 0) -> str:
    return f"{value:8.{digits}f}" if np.isfinite(value) else f"{'-':>8}"


def notes(beacons: Beacons, fit: Against) -> Iterator[str]:
    if len(fit.beacons) < len(beacons):
        yield f"by {len(fit.beacons)} of them: the others were slow to the dongle, says the host's log"
    if not fit.is_clear:
        yield f"its clock is {fit.drift_ppm:+.0f} ppm off the host's: neither right nor 84/85"
    elif fit.is_slow:
        yield "it counts 84 where 85 have passed"
    if fit.beacons.other_runs:
        yield f"{fit.beacons.other_runs} beacons left out: of another run of the host, or with times that cannot be"
