"""`host sync robots` where one broadcast has set all clocks to 0: what that alone tells, and when each obeyed it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Any

from ..clock.resets import DRIFT_PPM, SPREAD_US, Taken, bound_us, late, missed, resets, taken
from ..protocol.errors import PeerError
from ..usd.examine import find_period
from ..usd.log import Log
from .as_json import line


def were_reset(logs: Sequence[Log]) -> bool:
    """Does at least one log say so?"""
    return any(resets(spans(log)) for log in logs)


def spans(log: Log) -> list[tuple[int, int]]:
    return [(each.first_us, each.last_us) for each in log.epochs]


def compare(labels: Sequence[str], logs: Sequence[Log], as_json: bool) -> int:
    """Prints what the resets alone tell. PeerError where they tell nothing."""
    why = odd_one(labels, logs)
    if why:
        raise PeerError(
            f"{why}, and nothing else tells its time against the others': log beacons, or poses that all hear"
        )
    slow = [is_slow(log) for log in logs]
    if {True, False} <= set(slow):
        raise PeerError(
            f"{labels[slow.index(True)]} counts 84 where 85 have passed and {labels[slow.index(False)]} does not: after"
            " a reset they part by 11.8 ms a second, and nothing tells how exactly"
        )
    last_us = [log.epochs[-1].last_us for log in logs]
    if as_json:
        for first, second in combinations(range(len(labels)), 2):
            print(line(record(labels[first], labels[second], min(last_us[first], last_us[second]) * 1e-6)))
    else:
        print("\n".join(lines(labels, logs, min(last_us) * 1e-6)))
    return 0


def odd_one(labels: Sequence[str], logs: Sequence[Log]) -> str:
    """Which log does not tell of the resets that others do, and how that shows; empty: none."""
    found = [resets(spans(log)) for log in logs]
    odd = missed(found)
    if odd is not None:
        counts = ", ".join(f"{label} {len(each)}" for label, each in zip(labels, found, strict=True))
        return f"{labels[odd]} has missed a reset, or had one alone (resets in the logs: {counts})"
    odd = late([log.epochs[-1].first_us for log in logs])
    if odd is not None:
        began = ", ".join(
            f"{label} at {log.epochs[-1].first_us * 1e-6:.3f} s" for label, log in zip(labels, logs, strict=True)
        )
        return f"{labels[odd]} has missed the reset, or logged later than the others (the logs begin: {began})"
    return ""


def is_slow(log: Log) -> bool | None:
    """By rows of a rate that is known; None: there are none."""
    periods = [find_period(name, rows) for name, rows in log.rows.items()]
    clear = [each for each in periods if each is not None and each.is_clear]
    return max(clear, key=lambda each: each.coherence).is_slow if clear else None


def record(first: str, second: str, span_s: float) -> dict[str, Any]:
    return {
        "event": "pair",
        "by": "reset",
        "first": first,
        "second": second,
        "at_us": 0,
        "offset_us": 0,
        "bound_us": SPREAD_US,
        "bound_growth_ppm": DRIFT_PPM,
        "span_s": round(span_s, 3),
        "bound_us_at_end": round(bound_us(span_s), 1),
    }


def lines(labels: Sequence[str], logs: Sequence[Log], span_s: float) -> Iterator[str]:
    yield "by the reset alone: nothing that all have heard is in the logs"
    for label, log in zip(labels, logs, strict=True):
        begun = resets(spans(log))
        if begun:
            yield f"  {label}: set to 0 when it had counted to {begun[-1].before_us * 1e-6:.3f} s"
        else:
            yield f"  {label}: its log begins {log.epochs[-1].first_us * 1e-6:.3f} s after its clock was at 0"
    yield f"each two of them: 0 ± {SPREAD_US:.0f} us at the reset, ± {DRIFT_PPM:.0f} us more for each second since:"
    yield f"± {bound_us(span_s) / 1000:.1f} ms after {span_s:.1f} s. A repeat that one has heard and another has not is"
    yield "in no bound: log what all hear (beacons, poses of motion capture), and it is measured."


def tell(
    labels: Sequence[str],
    logs: Sequence[Log],
    zeros_us: Sequence[tuple[float, float]],
    arguments: argparse.Namespace,
) -> None:
    """Prints when each has carried the reset out: `zeros_us`, when its clock was at 0 by what all have heard, with the
    bound of that."""
    why = odd_one(labels, logs)
    unknown = [label for label, (_, bound) in zip(labels, zeros_us, strict=True) if not math.isfinite(bound)]
    if not why and unknown:
        why = f"{unknown[0]} has heard too little near its last reset: when that was is not known"
    found = [] if why else taken([each for each, _ in zeros_us], [each for _, each in zeros_us], arguments.every_us)
    if arguments.json and why:
        print(line({"event": "reset", "not_told": why}))
    elif arguments.json:
        for label, each in zip(labels, found, strict=True):
            print(line({"event": "reset", "log": label, **taken_record(each)}))
    else:
        print("\n".join(["", f"reset: {why}"] if why else taken_lines(labels, found)))


def taken_record(each: Taken) -> dict[str, Any]:
    rounded = {"after_us": round(each.after_us, 1), "bound_us": round(each.bound_us, 1)}
    return {**rounded, "repeat": each.repeat, "of_another_packet": each.is_other}


def taken_lines(labels: Sequence[str], found: Sequence[Taken]) -> Iterator[str]:
    yield ""
    yield "all were set to 0 by a broadcast; by what they heard, after the first of them:"
    for label, each in zip(labels, found, strict=True):
        which = "" if each.repeat is None else f": {each.repeat} repeats later" if each.repeat else ": the same packet"
        other = ": by another packet" if each.is_other else ""
        yield f"  {label}  {each.after_us:+.0f} ± {each.bound_us:.0f} us{which or other}"
