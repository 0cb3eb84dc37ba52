"""Status rows: which bytes of a log are as they were written, and which are an older log's.

Each has a CRC over everything since the one before it, and the session of its file. Stale data of an older log may lie
in a file, row by row as good as this log's own; its session betrays it, or, without one, times that do not go on behind
a damage.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Literal

from .header import Header
from .log import Damage
from .rows import CRC_BYTES, RowReader, Walk


@dataclass(frozen=True, slots=True)
class Run:
    """Rows without a break, and what separates them from the rows before."""

    walk: Walk
    after: Literal["start", "damage", "time"]
    """`time`: the bytes go on, the times do not."""
    likely: bool
    """Of this log: its times go on, or nothing but a jump of time separates it from a likely run."""


@dataclass(frozen=True, slots=True)
class Status:
    """A status row, and whether its CRC is good."""

    offset: int
    end: int
    run: int
    session: int
    begin: int
    """Of the bytes that its CRC covers."""
    good: bool


def read_statuses(reader: RowReader, runs: list[Run]) -> list[Status]:
    """In the order of the file. Each one's CRC covers what lies between the one before and its own."""
    found: list[Status] = []
    begin = 0
    size = reader.status_bytes
    for number, run in enumerate(runs):
        fields = reader.status_fields(run.walk.statuses, ("session", "crc"))
        for offset, session, crc in zip(run.walk.statuses, *fields, strict=True):
            end = offset + size
            good = reader.crc32(begin, end - CRC_BYTES) == crc
            found.append(Status(offset, end, number, session, begin, good))
            begin = end
    return found


def sessions(reader: RowReader, runs: list[Run]) -> set[int]:
    return {each for run in runs for each in reader.status_fields(run.walk.statuses, ("session",))[0]}


def own_session(statuses: list[Status], headerless: bool) -> int | None:
    """The first row of a log is a status row. If that one is damaged: what most of the good ones say. If the beginning
    is lost: what the first good one says, for stale data lie behind a log's own."""
    if not statuses:
        return None
    first = next((each for each in statuses if each.good), statuses[0]) if headerless else statuses[0]
    if first.good:
        return first.session
    good = Counter(each.session for each in statuses if each.good) or Counter(each.session for each in statuses)
    return good.most_common(1)[0][0]


def header_doubt(first: Status, header: Header) -> Damage:
    why = "the header's CRC (in the first status row) is bad: nothing is verified, names and sizes may be wrong"
    return Damage(0, min(first.end, header.size), why)


def find_stale(reader: RowReader, runs: list[Run], statuses: list[Status], session: int | None) -> list[Damage]:
    """Bytes of an older log."""
    found: list[Damage] = []
    size = len(reader.data)
    own = [each for each in statuses if each.session == session]
    for each in statuses:
        if each.session == session or (found and covers(found[-1], each.offset)):
            continue
        before = max((status.run for status in own if status.offset < each.offset), default=-1)
        behind = min((status for status in own if status.offset > each.offset), key=lambda s: s.offset, default=None)
        if behind is not None and behind.run == each.run:
            continue  # One of this log's, with a damaged session.
        begin = runs[each.run].walk.begin if each.run > before else each.offset
        end = size if behind is None else runs[behind.run].walk.begin
        found.append(Damage(begin, end - begin, f"stale: of an older log (session {each.session:08x})"))
    vouched = {each.run for each in own}
    for number, run in enumerate(runs):
        begin, end = run.walk.begin, run.walk.end
        if not run.likely and number not in vouched and not any(covers(each, begin) for each in found):
            why = "rows whose times do not go on: of an older log, or the clock was reset in the damage before"
            found.append(Damage(begin, end - begin, why))
    return found


def covers(damage: Damage, at: int) -> bool:
    return damage.offset <= at < damage.offset + damage.size
