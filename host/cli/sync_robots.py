"""`host sync robots`: what it takes out of logs, and what it says."""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from ..clock.robots import Heard, Pair, closures, compare
from ..protocol.errors import LocalError, PeerError
from ..usd.examine import NEAR, NOMINAL_HZ, Period, best_fit
from ..usd.log import Log, Rows
from . import sync_resets
from .as_json import line
from .sync_beacons import compare as beacons
from .sync_beacons import has_beacons
from .sync_plot import Draw, new_picture
from .sync_robots_plot import by_broadcasts
from .usd import load

FLOATS = "fd"
SIGMAS = 2.58
DISTINCT_MIN = 5
SHARED = 0.9
"""Of a variable's values: so many must be the same in another log to the last bit."""
EVENTS_MIN = 100


def run(arguments: argparse.Namespace) -> int:
    """4 if two logs have nothing in common."""
    if len(arguments.files) < 2:
        raise LocalError("one log: give the logs of two robots or more")
    for name, count in Counter(arguments.files).items():
        if count > 1:
            raise LocalError(f"{name}: given {count} times: give the logs of two robots or more")
    if arguments.every_us is not None and not arguments.every_us > 0:
        raise LocalError(f"--reset-every-us {arguments.every_us:g}: allowed is more than 0")
    with new_picture(arguments.plot, arguments.force) as draw:
        logs = [load(name, examined=False)[0] for name in arguments.files]
        for name, log in zip(arguments.files, logs, strict=True):
            if not log.row_count:
                raise PeerError(f"{name}: no rows: see 'host usd check'")
        return judge(arguments, logs, draw)


def judge(arguments: argparse.Namespace, logs: Sequence[Log], draw: Draw | None) -> int:
    labels = labelled(arguments.files)
    if not arguments.variable and all(has_beacons(log) for log in logs):
        return beacons(labels, logs, arguments, draw)
    reset = arguments.reset or sync_resets.were_reset(logs)
    kind, names = named(logs, arguments.files, arguments.variable) if arguments.variable else shared(logs)
    heard = [hear(label, log.rows[kind], names) for label, log in zip(labels, logs, strict=True) if names]
    found = compare(heard)
    pairs = [each for each in found if isinstance(each, Pair)]
    if not pairs and not arguments.variable:
        # Equal values at times that fit no line were nobody's broadcast: robots that did the same.
        if reset and draw:
            raise LocalError("--plot: a reset alone leaves nothing to draw")
        if reset:
            return sync_resets.compare(labels, logs, arguments.json)
        raise PeerError(
            "no variable has the same values in all logs: did the robots hear the same broadcasts, in one run, and log"
            " them (a pose of motion capture, or an object's that all are told)? Or did all of them log beacons?"
        )
    periods = [period_of(each) for each in heard]
    if arguments.json:
        for record in records(heard, names, found, periods):
            print(line(record))
    else:
        print("\n".join(lines(heard, names, found, periods)))
    if draw and pairs:
        draw(by_broadcasts(heard, pairs), 2)
    if reset and len(pairs) == len(found):
        sync_resets.tell(labels, logs, zeros(pairs), arguments)
    if len(pairs) < len(found):
        missing = next(each for each in found if not isinstance(each, Pair))
        raise PeerError(
            f"{heard[missing[0]].name} and {heard[missing[1]].name}: {missing[2]} broadcasts in common are too few"
        )
    return 0


def zeros(pairs: Sequence[Pair]) -> list[tuple[float, float]]:
    """When each clock was at 0, on the first robot's, and its bound of 99 %."""
    own = [each for each in pairs if each.first == 0]
    return [(0.0, 0.0), *((-each.start_us, SIGMAS * each.start_sigma_us) for each in own)]


def labelled(files: Sequence[str]) -> list[str]:
    """The files' names, or their whole paths where those are the same."""
    short = [Path(name).name for name in files]
    return short if len(set(short)) == len(short) else list(files)


def named(logs: Sequence[Log], files: Sequence[str], wanted: str) -> tuple[str, list[str]]:
    """The type of rows, and the variables, that the user has named."""
    words = [word.strip() for word in wanted.split(",") if word.strip()]
    for kind in logs[0].rows:
        own = [each.name for each in logs[0].rows[kind].type.variables]
        chosen = [name for name in own if any(name == word or name.startswith(f"{word}.") for word in words)]
        if chosen and all(any(name == word or name.startswith(f"{word}.") for name in own) for word in words):
            for file, log in zip(files, logs, strict=True):
                rows = log.rows.get(kind)
                missing = set(chosen) - {each.name for each in rows.type.variables} if rows else set(chosen)
                if missing:
                    raise LocalError(f"{file}: has no {sorted(missing)[0]}: name variables that are in all logs")
            return kind, chosen
    raise LocalError(f"{files[0]}: no rows with {wanted}: 'host usd info' lists the variables")


def shared(logs: Sequence[Log]) -> tuple[str, list[str]]:
    """Variables whose values are the same in all logs, to the last bit, as only what was broadcast is; maybe none."""
    best: tuple[str, list[str]] = ("", [])
    for kind, rows in logs[0].rows.items():
        if not all(kind in log.rows for log in logs):
            continue
        names = [each.name for each in rows.type.variables if each.letter in FLOATS]
        names = [name for name in names if all(name in (log.rows[kind].data.dtype.names or ()) for log in logs)]
        chosen = [name for name in names if is_shared([log.rows[kind].data[name] for log in logs])]
        if len(chosen) > len(best[1]):
            best = kind, chosen
    return best


def is_shared(columns: Sequence[Any]) -> bool:
    sets = [np.unique(column) for column in columns]
    return all(len(each) >= DISTINCT_MIN for each in sets) and all(
        len(np.intersect1d(sets[0], other)) >= SHARED * min(len(sets[0]), len(other)) for other in sets[1:]
    )


def hear(label: str, rows: Rows, names: Sequence[str]) -> Heard:
    """Each row in which something is new."""
    table = np.stack([rows.data[name].astype(np.float64) for name in names], axis=1)
    new = np.concatenate(([True], (np.diff(table, axis=0) != 0).any(axis=1)))
    new[0] = False  # It was there before the log began.
    at = np.flatnonzero(new & (rows.epoch == rows.epoch[-1]))
    return Heard(label, rows.stamp_us[at].astype(np.float64), [tuple(row) for row in table[at].tolist()])


def period_of(heard: Heard) -> Period | None:
    """That of the broadcasts on this robot's clock, if they come at a rate that is usual."""
    if len(heard.time_us) < EVENTS_MIN:
        return None
    usual = float(np.median(np.diff(heard.time_us)))
    near = min(NOMINAL_HZ, key=lambda hz: abs(usual * hz / 1e6 - 1))
    if abs(usual * near / 1e6 - 1) > NEAR:
        return None
    return best_fit("broadcasts", heard.time_us - heard.time_us[0], near)


def records(
    heard: Sequence[Heard], names: Sequence[str], found: Sequence[Any], periods: Sequence[Period | None]
) -> Iterator[dict[str, Any]]:
    for each, period in zip(heard, periods, strict=True):
        yield {
            "event": "robot",
            "log": each.name,
            "variables": list(names),
            "broadcasts": len(each.time_us),
            "interval_us": period and round(period.interval_us, 3),
            "nominal_hz": period and period.nominal_hz,
            "against_nominal_ppm": period and round((period.ratio - 1) * 1e6, 1),
            "counts_84_of_85": period.is_slow if period and period.is_clear else None,
        }
    pairs = [each for each in found if isinstance(each, Pair)]
    for pair in pairs:
        values = {key: round(value, 3) if isinstance(value, float) else value for key, value in asdict(pair).items()}
        yield {"event": "pair", **values, "first": heard[pair.first].name, "second": heard[pair.second].name}
    for robots, closure in closures(pairs).items():
        yield {"event": "closure", "robots": [heard[each].name for each in robots], "closure_ppm": round(closure, 3)}


def lines(
    heard: Sequence[Heard], names: Sequence[str], found: Sequence[Any], periods: Sequence[Period | None]
) -> Iterator[str]:
    yield f"broadcasts told by {', '.join(names)}"
    for each, period in zip(heard, periods, strict=True):
        yield f"  {each.name}: {len(each.time_us)} broadcasts{clock_of(period)}"
    yield ""
    wide = max(32, *(len(f"{a.name} against {b.name}") for a, b in combinations(heard, 2))) + 1
    columns = f"{'common':>7}{'slope, ppm':>18}{'offset, us':>20}{'at 0, us':>16}{'sd, us':>8}"
    yield f"{'second against first':{wide}}{columns}"
    pairs = [each for each in found if isinstance(each, Pair)]
    for pair in pairs:
        name = f"{heard[pair.second].name} against {heard[pair.first].name}"
        slope = f"{pair.slope_ppm:+.1f} ± {pair.slope_sigma_ppm:.1f}"
        offset = f"{pair.offset_us:+.0f} ± {pair.offset_sigma_us:.0f}"
        start = f"{pair.start_us:+.0f} ± {pair.start_sigma_us:.0f}"
        yield f"{name:{wide}}{pair.common:7}{slope:>18}{offset:>20}{start:>16}{pair.residual_us:8.0f}"
    for robots, closure in closures(pairs).items():
        yield f"closure of {', '.join(heard[each].name for each in robots)}: {closure:+.2f} ppm"
    yield "Offsets are in the middle of what both heard. ± is one sigma; a reception that always is later is in none."


def clock_of(period: Period | None) -> str:
    if period is None:
        return ""
    rate = f"if that is {period.nominal_hz:.6g} Hz, the clock runs at {period.ratio:.5f}"
    said = f", every {period.interval_us:.3f} us; {rate}"
    if not period.is_clear:
        return f"{said}: neither right nor 84/85"
    return f"{said}: {'it counts 84 where 85 have passed' if period.is_slow else 'right'}"
