"""The C's walk over the rows of one log, as Python sees it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ..native import ffi, lib
from .arrays import Arrays
from .header import Header
from .log import STATUS_VARIABLES, EventType

MARKS_MAX = 4096
CRC_BYTES = 4
SECTOR_BYTES = 512
U32_BYTES = 4
STAMP_BYTES = {1: 4, 2: 8}


@dataclass(frozen=True, slots=True)
class Mark:
    """A status row, or one whose time goes back."""

    offset: int
    before: int
    stamp: int


@dataclass(frozen=True, slots=True)
class Walk:
    """Rows that follow each other without a break."""

    begin: int
    end: int
    why: int
    """What stands behind them: USD_END, USD_UNKNOWN, USD_CUT, USD_TIME."""
    last_row: int
    last: int | None
    """The latest stamp, in the file's unit; of the rows before, if there are none."""
    statuses: tuple[int, ...]
    """Where status rows begin."""
    backs: tuple[Mark, ...]
    rows: tuple[int, ...]
    """Passed, by type."""
    crc: int | None = None
    """Of all bytes from the file's first to `end`, if it was asked for."""


def crc32(data: memoryview, begin: int = 0, end: int | None = None) -> int:
    view = data[begin:end]
    return int(lib.crc32_host(0, (ffi.from_buffer("uint8_t[]", view), len(view))))


def filling(data: memoryview) -> str | None:
    """Of bytes that nobody has written."""
    if len(data) < CRC_BYTES:
        return None
    values = np.frombuffer(data, np.uint8)
    if not values.any():
        return "zeros: never written"
    return "0xFF only: an erased part of the card" if values.min() == 0xFF else None


def unwritten(data: memoryview, begin: int, end: int) -> str | None:
    """Of bytes that nobody has written among others: the longest such part, if it has a sector's size."""
    values = np.frombuffer(data, np.uint8)[begin:end]
    for byte in (0, 0xFF):
        borders = np.flatnonzero(np.concatenate([[True], values != byte, [True]]))
        longest = int(np.argmax(np.diff(borders)))
        first, behind = begin + int(borders[longest]), begin + int(borders[longest + 1]) - 1
        if behind - first >= SECTOR_BYTES:
            return f"bytes {first} to {behind} are {filling(data[first:behind])}"
    return None


class RowReader:
    """Bytes and their layout; every offset is one of the file."""

    def __init__(self, data: memoryview, header: Header) -> None:
        self.data = data
        self.header = header
        self._layout = header.layout
        self._bytes = ffi.from_buffer("uint8_t[]", data)
        self._marks = ffi.new("usd_mark_t[]", MARKS_MAX)

    def walk(
        self, begin: int, end: int, last: int | None, strict: bool, check: bool = False, into: Arrays | None = None
    ) -> Walk:
        """`into`: the rows are copied there, behind those that it has."""
        state = ffi.new("usd_walk_t *")
        state.at, state.marks, state.marks_max = begin, self._marks, MARKS_MAX
        state.has_last, state.last = last is not None, last or 0
        state.check = check
        if into is not None:
            state.out, state.room = into.out, into.room
        statuses: list[int] = []
        backs: list[Mark] = []
        why = lib.USD_MARKS
        while why in (lib.USD_MARKS, lib.USD_ROOM):
            if why == lib.USD_ROOM and into is not None:
                into.enlarge(self.number_at(state.at) or 0, (end - state.at) // self.row_bytes_at(state.at))
            state.marks_count = 0
            why = lib.usd_walk(self._layout, (self._bytes, end), strict, state)
            for mark in self._marks[0 : state.marks_count]:
                if mark.kind == lib.USD_STATUS:
                    statuses.append(mark.offset)
                else:
                    backs.append(Mark(mark.offset, mark.before, mark.stamp))
        latest = state.last if state.has_last else None
        rows = tuple(state.rows[0 : len(self.header.types)])
        crc = int(state.crc) if check else None
        if into is not None:
            into.add(rows)
        return Walk(begin, state.at, why, state.row, latest, tuple(statuses), tuple(backs), rows, crc)

    def chain(self, at: int, last: int | None, most: int) -> tuple[int, bool]:
        """How many rows follow each other there, and whether the end is behind them."""
        before = ffi.NULL if last is None else ffi.new("uint64_t *", last)
        ends = ffi.new("bool *")
        rows = lib.usd_chain(self._layout, (self._bytes, len(self.data)), at, before, most, ends)
        return int(rows), bool(ends[0])

    def follows(self, at: int, last: int | None) -> bool:
        """Do enough rows follow each other there, to believe that they are rows?"""
        enough, at_end = lib.USD_CHAIN, lib.USD_CHAIN_END
        if last is None:
            enough, at_end = lib.USD_CHAIN_LONG, lib.USD_CHAIN_LONG_END
        rows, ends = self.chain(at, last, enough)
        return bool(rows >= enough or (ends and rows >= at_end))

    def find(self, at: int, last: int | None) -> int:
        before = ffi.NULL if last is None else ffi.new("uint64_t *", last)
        return int(lib.usd_find(self._layout, (self._bytes, len(self.data)), at, before))

    def number_at(self, at: int) -> int | None:
        """Which type the row is of."""
        number = self._layout.type_of_id[int.from_bytes(self.data[at : at + lib.USD_ID_BYTES], "little")]
        return number - 1 if number else None

    def type_at(self, at: int) -> EventType | None:
        number = self.number_at(at)
        return None if number is None else self.header.types[number]

    def row_bytes_at(self, at: int) -> int:
        """Of a row with a known id."""
        each = self.type_at(at)
        return lib.USD_ID_BYTES + each.row_bytes if each else 0

    def stamp_at(self, at: int) -> int:
        begin = at + lib.USD_ID_BYTES
        return int.from_bytes(self.data[begin : begin + self._layout.stamp_bytes], "little")

    def parts(self, walk: Walk) -> list[Walk]:
        """The same rows, cut where the clock was reset."""
        resets = [mark.offset for mark in walk.backs if mark.offset > walk.begin and not self.is_return(mark)]
        if not resets:
            return [walk]
        return [self.walk(*part, None, strict=False) for part in pairwise([walk.begin, *resets, walk.end])]

    def is_return(self, mark: Mark) -> bool:
        """A single time that went back, and not the clock: the rows behind it go on from where it was."""
        return self.follows(mark.offset + self.row_bytes_at(mark.offset), mark.before)

    def crc32(self, begin: int, end: int) -> int:
        return int(lib.crc32_host(0, (self._bytes + begin, end - begin)))

    @property
    def status_bytes(self) -> int:
        """Of a status row."""
        return int(lib.USD_ID_BYTES) + STAMP_BYTES[self.header.version] + U32_BYTES * len(STATUS_VARIABLES)

    def status_fields(self, statuses: tuple[int, ...], names: tuple[str, ...]) -> list[list[int]]:
        """These variables of the status rows at these places."""
        first = self.status_bytes - U32_BYTES * len(STATUS_VARIABLES)
        bytes_ = np.frombuffer(self.data, np.uint8)
        starts = np.array(statuses, np.int64)[:, None] + first
        offsets = [U32_BYTES * STATUS_VARIABLES.index(name) + np.arange(U32_BYTES) for name in names]
        return [bytes_[starts + each].view("<u4").ravel().tolist() for each in offsets]

    def places(self, number: int, walk: Walk) -> tuple[int, ...]:
        """Where the rows of that type begin, among rows that were walked before."""
        if not walk.rows[number]:
            return ()
        status = self._layout.status
        self._layout.status = number
        try:
            return self.walk(walk.begin, walk.end, None, strict=False).statuses
        finally:
            self._layout.status = status
