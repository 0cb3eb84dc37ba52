"""What `host usd info` and `host usd check` say of a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any

from ..usd.examine import SLOW, Findings, Period
from ..usd.log import REPAIRED_EVENT, Log

SHOWN = 10
VERSIONS = {1: "version 1", 2: "version 2", 2019: "the format of 2019", None: "not readable"}


def as_record(name: str, log: Log, findings: Findings) -> dict[str, Any]:
    """For a program."""
    return {
        "event": "log",
        "file": name,
        "size": log.size,
        "version": log.version,
        "whole": log.is_whole,
        "crc": log.crc,
        "session": log.session,
        "rows": log.row_count,
        "verified": log.verified_count,
        "types": [type_record(log, each.name) for each in log.types],
        "epochs": log.epochs,
        "damages": log.damages,
        "verified_bytes": log.verified,
        **asdict(findings),
    }


def type_record(log: Log, name: str) -> dict[str, Any]:
    rows = log.rows[name]
    return {
        "name": name,
        "id": rows.type.id,
        "rows": len(rows),
        "verified": sum(len(part) for part in rows.verified),
        "variables": {each.name: each.letter for each in rows.type.variables},
    }


def info_lines(name: str, log: Log, findings: Findings) -> Iterator[str]:
    """For people."""
    yield f"{name}: {log.size} bytes, {VERSIONS[log.version]}, {state(log)}"
    for number, epoch in enumerate(log.epochs):
        seconds = (epoch.last_us - epoch.first_us) / 1e6
        why = f" (epoch {number}: {epoch.why})" if number else ""
        yield f"  time      {epoch.first_us} to {epoch.last_us} us, {seconds:.3f} s{why}"
    periods = {each.type: each for each in findings.periods}
    for each in log.types:
        rate = f", every {periods[each.name].interval_us:.2f} us" if each.name in periods else ""
        yield f"  rows      {len(log.rows[each.name])} {each.name}{rate}"
        variables = ", ".join(f"{variable.name}({variable.letter})" for variable in each.variables)
        yield f"            {variables}"
    unverified = log.row_count - log.verified_count
    if log.version:
        yield f"  verified  {log.verified_count} rows{f'; {unverified} are not' * bool(unverified)}"
    if findings.counters:
        known = ", ".join(f"{key} {value}" for key, value in asdict(findings.counters).items())
        yield f"  logger    session {log.session:08x}: {known}"
    faults, notes = judge(log, findings)
    yield from (f"  note      {each['text']}" for each in notes[:SHOWN])
    if len(notes) > SHOWN:
        yield f"  notes     {len(notes) - SHOWN} more: see 'host usd check --json'"
    if faults:
        yield f"  faults    {len(faults)}: see 'host usd check'"


def state(log: Log) -> str:
    if log.is_whole:
        return "whole"
    if log.version is None or not log.row_count:
        return log.damages[0].why if log.damages else "no rows"
    return {"good": "closed, with something behind its end", "bad": "damaged", "absent": "never closed, or cut off"}[
        log.crc
    ]


def judge(log: Log, findings: Findings) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """What is wrong, and what is only worth knowing."""
    faults: list[dict[str, Any]] = []
    if log.crc == "absent" and log.version:
        faults.append(
            {"event": "open", "text": "the log was never closed, or its end is gone: no CRC of the whole file"}
        )
    for damage in log.damages:
        text = f"bytes {damage.offset} to {damage.offset + damage.size}: {damage.why}"
        faults.append({"event": "damage", "text": text, **asdict(damage)})
    if unverified := log.row_count - log.verified_count:
        faults.append({"event": "unverified", "rows": unverified, "text": f"{unverified} rows that no good CRC covers"})
    for hole in findings.holes:
        text = f"hole in {hole.type}: {hole.from_us} to {hole.to_us} us, about {hole.rows} rows"
        faults.append({"event": "hole", "text": text, **asdict(hole)})
    for drop in findings.drops:
        text = f"dropped by the logger: {drop.rows} rows, {drop.from_us} to {drop.to_us} us"
        faults.append({"event": "drop", "text": text, **asdict(drop)})
    if findings.counters and findings.counters.errors:
        text = f"{findings.counters.errors} storage operations failed"
        faults.append({"event": "errors", "text": text, "errors": findings.counters.errors})
    return faults, list(notes_of(log, findings))


def notes_of(log: Log, findings: Findings) -> Iterator[dict[str, Any]]:
    if log.version is None and log.size:
        text = "a log that has lost its beginning? --header-of OTHER reads it as rows of a log of the same config.txt"
        yield {"event": "no_header", "text": text}
    for epoch in log.epochs[1:]:
        yield {"event": "reset", "text": f"{epoch.why}; now {epoch.first_us} us (byte {epoch.offset})", **asdict(epoch)}
    for name, rows in findings.disorder.items():
        yield {
            "event": "disorder",
            "type": name,
            "rows": rows,
            "text": f"{rows} rows of {name} are not in the order of their times",
        }
    for period in findings.periods:
        yield {"event": "clock", "text": clock_text(period), "slow": period.is_slow, **asdict(period)}
    notes = log.rows.get(REPAIRED_EVENT)
    if notes is not None and len(notes):
        of, unverified, lost = (int(notes.data[name].sum()) for name in ("rows", "unverified", "lost_bytes"))
        text = f"repaired: of {of} rows {unverified} were not verified, and {lost} bytes were lost"
        yield {"event": "repaired", "text": text, "rows": of, "unverified": unverified, "lost_bytes": lost}


def clock_text(period: Period) -> str:
    """With how sure one can be: nothing in a log says what a rate was meant to be."""
    measured = (
        f"{period.type} comes every {period.interval_us:.3f} ± {period.error_us:.3f} us; "
        f"if that is {period.nominal_hz:.6g} Hz, the clock runs at {period.ratio:.5f} of real time"
    )
    if not period.is_clear:
        return f"{measured}: neither right nor 84/85 slow"
    if not period.is_slow:
        return f"{measured}: right, and not 84/85 (0.98824)"
    slow, right = (abs(period.ratio - each) * 100 for each in (SLOW, 1))
    return (
        f"{measured}: it counts 84 where 85 have passed (0.98824, {slow:.2f} % off; a right clock: {right:.2f} % off), "
        "as firmware before August 2026 does"
    )


def check_lines(name: str, log: Log, faults: list[dict[str, Any]], notes: list[dict[str, Any]]) -> Iterator[str]:
    """For people: the first of many of a kind, then how many more."""
    what = "good" if not faults else "whole, but with faults" if log.is_whole else state(log)
    yield f"{name}: {what}, {log.row_count} rows, {log.verified_count} verified"
    shown: Counter[str] = Counter()
    for each, mark in (*((fault, "") for fault in faults), *((note, "note: ") for note in notes)):
        shown[each["event"]] += 1
        if shown[each["event"]] <= SHOWN:
            yield f"  {mark}{each['text']}"
    yield from (f"  {kind}: {count - SHOWN} more, all with --json" for kind, count in shown.items() if count > SHOWN)
