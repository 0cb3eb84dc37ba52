"""What can be trusted of a log whose own CRC is bad or absent.

Rows are walked with suspicion: known ids, times that go on. Where that ends, the next place is searched at which some
rows follow each other again. Status rows then say which bytes are as they were written, and whose: those between two of
them are verified when the second one's CRC is good and it bears this log's session. What is stale is not returned.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

from ..native import lib
from .header import BACK_US
from .headerless import WHY
from .log import ByteRange, Damage
from .pieces import Piece
from .rows import CRC_BYTES, RowReader, Walk, filling, unwritten
from .statuses import Run, find_stale, header_doubt, own_session, read_statuses, sessions

LONG_HOLE_US = 3_600_000_000
"""A last row further ahead than this has a damaged time."""
JUST_RESET_US = 10_000_000
"""So has one that goes back, and not to about zero as a reset does."""
SLACK_US, SLACK = 5_000_000, 4
"""Rows behind damage come as much later as the bytes in between take, times this, plus this."""
LEAP = "a row whose time leaps ahead: the rows behind go on from before it"


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
    if closed_at is not None and len(sessions(reader, runs[:leading])) > 1:
        why = "the file's CRC: it matches, but status rows of two logs are in the file, and then it proves nothing"
        damages = [replace(each, why=why) if each.offset == closed_at else each for each in damages]
        crc, closed_at = "bad", None
    if closed_at is not None:
        runs = runs[:leading]
        damages = tail(reader.data, closed_at + CRC_BYTES)
    statuses = read_statuses(reader, runs)
    header_good = closed_at is not None or bool(statuses and statuses[0].good and statuses[0].begin == 0)
    session = own_session(statuses, reader.header.borrowed)
    verified = [ByteRange(each.begin, each.end) for each in statuses if each.good and each.session == session]
    if closed_at is not None:
        verified = [ByteRange(0, closed_at)]
    elif reader.header.borrowed:
        damages.insert(0, Damage(0, reader.header.size, WHY))
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
            shorter = before_leap(reader, pace, runs[-1].walk, at) if likely else None
            if shorter and shorter.last is not None and reader.follows(at, shorter.last):
                damages.append(Damage(shorter.end, at - shorter.end, LEAP))
                runs[-1] = replace(runs[-1], walk=shorter)
                after, last = "damage", shorter.last
                continue
            if goes_on(reader, at, last):
                after, last = "time", None
                continue
        begin, found = search(reader, walk, last)
        if begin < at:
            runs[-1] = replace(runs[-1], walk=reader.walk(walk.begin, begin, None, strict=False))
        why = reason(reader, walk, begin, found)
        if runs and likely:
            if begin == at and (shorter := before_leap(reader, pace, runs[-1].walk, found)):
                begin, why = shorter.end, LEAP
                runs[-1:] = [replace(runs[-1], walk=shorter)] if shorter.end > shorter.begin else []
            if runs:
                pace.add(reader.stamp_at(runs[-1].walk.begin), runs[-1].walk)
        damages.append(Damage(begin, found - begin, why))
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


def before_leap(reader: RowReader, pace: Pace, walk: Walk, found: int) -> Walk | None:
    """Without its last row, if that one's time alone keeps the rows at `found` from going on. The walk has believed it,
    as there might have been a hole."""
    if found == len(reader.data) or walk.last is None or walk.end == walk.begin:
        return None
    stamp = reader.stamp_at(found)
    if stamp + BACK_US // reader.header.unit_us >= walk.last:
        return None
    shorter = reader.walk(walk.begin, walk.last_row, None, strict=False)
    without = copy(pace)
    without.add(reader.stamp_at(walk.begin), shorter)
    return shorter if without.expects(stamp, found) else None


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
    why = f"a row whose time makes no sense{rest}" if walk.why == lib.USD_TIME else f"no row begins here{rest}"
    part = unwritten(reader.data, begin, end)
    return f"{why}: {part}" if part else why


def closed(
    reader: RowReader, leading: list[Run], runs: list[Run]
) -> tuple[Literal["good", "bad", "absent"], int | None]:
    """The file's own CRC may lie where the rows end for the first time, with something else behind it."""
    data = reader.data
    end = leading[-1].walk.end if leading else reader.header.size
    if reader.header.borrowed:
        pass  # Nothing of the beginning, which it covers, can be as it was.
    elif end + CRC_BYTES <= len(data) and reader.crc32(0, end) == int.from_bytes(data[end : end + CRC_BYTES], "little"):
        return "good", end
    last = runs[-1].walk.end if runs else reader.header.size
    return ("bad" if last + CRC_BYTES == len(data) else "absent"), None


def tail(data: memoryview, begin: int) -> list[Damage]:
    why = filling(data[begin:]) or "not of this log, which is complete: it ends before"
    return [Damage(begin, len(data) - begin, f"behind the log's end: {why}")] if begin < len(data) else []


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
