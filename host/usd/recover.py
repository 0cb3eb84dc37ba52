"""What can be trusted of a log whose own CRC is bad or absent.

Rows are walked with suspicion: known ids, times that go on. Where that ends, the next place is searched at which some
rows follow each other again. Status rows then say which bytes are as they were written, and whose: those between two of
them are verified when the second one's CRC is good and it bears this log's session. Stale data of an older log may lie
in a file, row by row as good as this log's own; its session betrays it, or, without one, times that do not go on behind
a damage. It is not returned.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from ..native import lib
from .header import BACK_US, Header
from .log import ByteRange, Damage
from .rows import CRC_BYTES, Piece, RowReader, Walk, crc32, filling

LONG_HOLE_US = 3_600_000_000
"""A last row further ahead than this has a damaged time."""
SLACK_US, SLACK = 5_000_000, 4
"""Rows behind damage come as much later as the bytes in between take, times this, plus this."""
JUST_RESET_US = 10_000_000
"""So has one that is further back than a reset of the clock leads."""


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


@dataclass(frozen=True, slots=True)
class Recovered:
    pieces: list[Piece]
    damages: list[Damage]
    verified: list[ByteRange]
    session: int | None
    crc: Literal["good", "bad", "absent"]


def recover(reader: RowReader) -> Recovered:
    """Everything, of a log with this header."""
    runs, damages = find_runs(reader)
    leading = next((number for number, run in enumerate(runs) if run.after == "damage"), len(runs))
    crc, closed_at = closed(reader, runs[:leading], runs)
    sessions = reader.sessions(tuple(at for run in runs[:leading] for at in run.walk.statuses))
    if closed_at is not None and len(sessions) > 1:
        why = "the file's CRC: it matches, but status rows of two logs are in the file, and then it proves nothing"
        damages = [replace(each, why=why) if each.offset == closed_at else each for each in damages]
        crc, closed_at = "bad", None
    if closed_at is not None:
        runs = runs[:leading]
        damages = tail(reader.data, closed_at + CRC_BYTES)
    statuses = read_statuses(reader, runs)
    header_good = closed_at is not None or bool(statuses and statuses[0].good and statuses[0].begin == 0)
    session = own_session(statuses)
    verified = [ByteRange(each.begin, each.end) for each in statuses if each.good and each.session == session]
    if closed_at is not None:
        verified = [ByteRange(0, closed_at)]
    elif not header_good:
        if statuses:
            damages.insert(0, header_doubt(statuses[0], reader.header))
        verified = []
    verified = merged(verified)
    stale = [] if closed_at is not None else find_stale(reader, runs, statuses, session)
    pieces = cut(reader, runs, verified, stale)
    kept = [damage for damage in damages if not any(within(damage, each) for each in verified) or not damage.offset]
    return Recovered(pieces, sorted([*kept, *stale], key=lambda damage: damage.offset), verified, session, crc)


def within(damage: Damage, good: ByteRange) -> bool:
    """What the walk did not believe, the CRC says was written so."""
    return good.begin <= damage.offset and damage.offset + damage.size <= good.end


def find_runs(reader: RowReader) -> tuple[list[Run], list[Damage]]:
    size = len(reader.data)
    runs: list[Run] = []
    damages: list[Damage] = []
    pace = Pace(reader.header.unit_us)
    at, last = reader.header.size, None
    after: Literal["start", "damage", "time"] = "start"
    likely = True
    while at < size:
        walk = reader.walk(at, size, last, strict=True)
        if walk.end > walk.begin:
            runs.append(Run(walk, after, likely))
            last = walk.last
        at = walk.end
        if walk.why == lib.USD_END:
            break
        if walk.why == lib.USD_TIME and last is not None:
            behind = at + reader.row_bytes_at(at)
            if behind <= size and reader.follows(behind, last):
                damages.append(Damage(at, behind - at, "a row whose time makes no sense: the rows behind it go on"))
                at, after = behind, "damage"
                continue
            if goes_on(reader, at, last):
                after, last = "time", None
                continue
        begin, found = search(reader, walk, last)
        if begin < at:
            runs[-1] = replace(runs[-1], walk=reader.walk(walk.begin, begin, None, strict=False))
        damages.append(Damage(begin, found - begin, reason(reader, walk, begin, found)))
        if runs and likely:
            pace.add(reader.stamp_at(runs[-1].walk.begin), runs[-1].walk)
        if found < size:
            likely = pace.expects(reader.stamp_at(found), found)
        at, after, last = found, "damage", None
    return runs, damages


class Pace:
    """How much time a log's bytes take: what a stamp behind damage is held against."""

    def __init__(self, unit_us: int) -> None:
        self._unit_us = unit_us
        self._bytes = 0
        self._time = 0
        self._last: int | None = None
        self._end = 0

    def add(self, first: int, walk: Walk) -> None:
        """A likely run."""
        if walk.last is None or walk.end == walk.begin:
            return
        self._bytes += walk.end - walk.begin
        self._time += walk.last - first
        self._last, self._end = walk.last, walk.end

    def expects(self, stamp: int, at: int) -> bool:
        """Is it neither before the last likely row nor much later than the bytes since then would take?"""
        if self._last is None:
            return True
        passed_us = (stamp - self._last) * self._unit_us
        usual_us = (at - self._end) * self._time * self._unit_us / max(self._bytes, 1)
        return -BACK_US <= passed_us <= SLACK_US + SLACK * usual_us


def goes_on(reader: RowReader, at: int, last: int) -> bool:
    """Is the odd time of the row at `at` the new time, and no damage?"""
    if reader.follows(at, None):
        return True
    # The last rows of the file: a hole before them, or a reset.
    rows, ends = reader.chain(at, None, lib.USD_CHAIN_LONG_END)
    stamp_us, last_us = (stamp * reader.header.unit_us for stamp in (reader.stamp_at(at), last))
    return ends and rows > 0 and (last_us < stamp_us <= last_us + LONG_HOLE_US or stamp_us <= JUST_RESET_US)


def search(reader: RowReader, walk: Walk, last: int | None) -> tuple[int, int]:
    """Where the damage begins and ends. It may begin with the row before, if that one's id was damaged: then its size
    is wrong, and what follows it is not where it was thought to be."""
    size = len(reader.data)
    suspect = walk.last_row if walk.end > walk.begin and walk.last_row not in walk.statuses else None
    begin = walk.end
    found = begin if suspect is None else reader.find(suspect + 1, last)
    if found == begin:
        found = reader.find(begin + 1, last)
    if suspect is None:
        return begin, found
    sizes = {lib.USD_ID_BYTES + each.row_bytes for each in reader.header.types}
    wrong_id = found < begin or (found < size and found - suspect in sizes and found - begin not in sizes)
    return (suspect, found) if wrong_id else (begin, found)


def reason(reader: RowReader, walk: Walk, begin: int, end: int) -> str:
    """What is wrong with these bytes, for people."""
    size = len(reader.data)
    if end == size and size - begin == CRC_BYTES:
        return "the file's CRC, which does not match; or the beginning of a row"
    if kind := filling(reader.data[begin:end]):
        return kind
    if end == size and walk.why == lib.USD_CUT:
        return "cut off inside a row"
    rest = "" if end < size else ", and no rows follow"
    if walk.why == lib.USD_TIME:
        return f"a row whose time makes no sense{rest}"
    return f"no row begins here{rest}"


def closed(
    reader: RowReader, leading: list[Run], runs: list[Run]
) -> tuple[Literal["good", "bad", "absent"], int | None]:
    """The file's own CRC may lie where the rows end for the first time, with something else behind it."""
    data = reader.data
    end = leading[-1].walk.end if leading else reader.header.size
    if end + CRC_BYTES <= len(data) and crc32(data, 0, end) == int.from_bytes(data[end : end + CRC_BYTES], "little"):
        return "good", end
    last = runs[-1].walk.end if runs else reader.header.size
    return ("bad" if last + CRC_BYTES == len(data) else "absent"), None


def tail(data: memoryview, begin: int) -> list[Damage]:
    why = filling(data[begin:]) or "not of this log, which is complete: it ends before"
    return [Damage(begin, len(data) - begin, f"behind the log's end: {why}")] if begin < len(data) else []


def read_statuses(reader: RowReader, runs: list[Run]) -> list[Status]:
    """In the order of the file. Each one's CRC covers what lies between the one before and its own."""
    found: list[Status] = []
    begin = 0
    for number, run in enumerate(runs):
        for offset in run.walk.statuses:
            end = offset + reader.row_bytes_at(offset)
            session, crc = (int.from_bytes(reader.data[at : at + 4], "little") for at in (end - 8, end - 4))
            good = crc32(reader.data, begin, end - CRC_BYTES) == crc
            found.append(Status(offset, end, number, session, begin, good))
            begin = end
    return found


def own_session(statuses: list[Status]) -> int | None:
    """The first row of a log is a status row. If that one is damaged: what most of the good ones say."""
    if not statuses:
        return None
    if statuses[0].good:
        return statuses[0].session
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


def merged(ranges: list[ByteRange]) -> list[ByteRange]:
    found: list[ByteRange] = []
    for each in sorted(ranges, key=lambda r: r.begin):
        if found and each.begin <= found[-1].end:
            found[-1] = ByteRange(found[-1].begin, max(found[-1].end, each.end))
        else:
            found.append(each)
    return found


def cut(reader: RowReader, runs: list[Run], verified: list[ByteRange], stale: list[Damage]) -> list[Piece]:
    """Everything verified, and of the runs what is neither verified nor stale; each piece in one epoch."""
    good = [reader.walk(max(each.begin, reader.header.size), each.end, None, strict=False) for each in verified]
    good = [walk for walk, each in zip(good, verified, strict=True) if walk.end == each.end]
    barred = merged([ByteRange(walk.begin, walk.end) for walk in good]
                    + [ByteRange(each.offset, each.offset + each.size) for each in stale])  # fmt: skip
    walks = [(walk, True) for walk in good]
    for run in runs:
        for begin, end in without(run.walk.begin, run.walk.end, barred):
            walks.append((reader.walk(begin, end, None, strict=False), False))
    pieces: list[Piece] = []
    epoch, last = 0, None
    back = BACK_US // reader.header.unit_us
    for walk, is_good in sorted(walks, key=lambda each: each[0].begin):
        if walk.begin == walk.end:
            continue
        epoch += last is not None and reader.stamp_at(walk.begin) + back < last
        for number, part in enumerate(reader.parts(walk)):
            epoch += number > 0
            pieces.append(Piece(part, is_good, epoch))
            last = part.last
    return pieces


def without(begin: int, end: int, barred: list[ByteRange]) -> Iterator[tuple[int, int]]:
    """What is left of some bytes; `barred` is sorted, its ranges do not touch."""
    number = max(bisect_right(barred, begin, key=lambda each: each.begin) - 1, 0)
    while number < len(barred) and barred[number].begin < end:
        if begin < barred[number].begin:
            yield begin, barred[number].begin
        begin = max(begin, barred[number].end)
        number += 1
    if begin < end:
        yield begin, end
