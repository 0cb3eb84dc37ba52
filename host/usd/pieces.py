"""What a log's rows are returned from: stretches of the file that were walked, and what is known of each."""

from __future__ import annotations

from dataclasses import dataclass, replace

from .arrays import Arrays
from .log import Array, Epoch, EventType, Rows
from .rows import RowReader, Walk

SAMPLE_BYTES = 1 << 20
"""What a log has in its first part, it has in the rest: so much memory is asked for, and a little more."""
SPARE, SPARE_ROWS = 1.05, 1000


@dataclass(frozen=True, slots=True)
class Piece:
    """Rows to be returned."""

    walk: Walk
    verified: bool
    epoch: int


@dataclass(frozen=True, slots=True)
class Taken:
    """All rows from the header on, as far as they go, copied while they were walked: bytes are read once."""

    walk: Walk
    arrays: Arrays

    def has(self, pieces: list[Piece]) -> bool:
        """Are the pieces what it begins with, without a gap?"""
        ends = [self.walk.begin, *(piece.walk.end for piece in pieces)]
        begins = [*(piece.walk.begin for piece in pieces), ends[-1]]
        return begins == ends and ends[-1] <= self.walk.end


def take(reader: RowReader) -> Taken:
    begin, end = reader.header.size, len(reader.data)
    sample = reader.walk(begin, min(end, begin + SAMPLE_BYTES), None, strict=False)
    share = SPARE * (end - begin) / max(sample.end - begin, 1)
    arrays = Arrays(reader.header.types, [int(rows * share) + SPARE_ROWS for rows in sample.rows])
    return Taken(reader.walk(begin, end, None, strict=False, check=True, into=arrays), arrays)


def rows_of(reader: RowReader, pieces: list[Piece], taken: Taken) -> dict[str, Rows]:
    """Of all pieces, by type. What was taken is used up."""
    types = reader.header.types
    index = Index(len(types))
    counts = [0] * len(types)
    for piece in pieces:
        before, counts = counts, [count + more for count, more in zip(counts, piece.walk.rows, strict=True)]
        index.add(piece, before, counts)
    if taken.has(pieces):
        return index.rows(types, taken.arrays.first(counts))
    taken.arrays.first([0] * len(types))
    arrays = Arrays(types, counts)
    for piece in pieces:
        reader.walk(piece.walk.begin, piece.walk.end, None, strict=False, into=arrays)
    return index.rows(types, arrays.first(counts))


class Index:
    """Row numbers that are verified, and those of each epoch."""

    def __init__(self, types: int) -> None:
        self._verified: list[list[range]] = [[] for _ in range(types)]
        self._epochs: list[list[range]] = [[] for _ in range(types)]

    def add(self, piece: Piece, before: list[int], after: list[int]) -> None:
        for number, (first, behind) in enumerate(zip(before, after, strict=True)):
            epochs = self._epochs[number]
            while len(epochs) <= piece.epoch:
                epochs.append(range(first, first))
            epochs[-1] = range(epochs[-1].start, behind)
            verified = self._verified[number]
            if piece.verified and first < behind:
                if verified and verified[-1].stop == first:
                    first = verified.pop().start
                verified.append(range(first, behind))

    def rows(self, types: tuple[EventType, ...], arrays: list[Array]) -> dict[str, Rows]:
        return {
            each.name: Rows(each, arrays[number], tuple(self._verified[number]), tuple(self._epochs[number]))
            for number, each in enumerate(types)
        }


def epochs_of(reader: RowReader, pieces: list[Piece]) -> tuple[Epoch, ...]:
    """One for each number that the pieces bear."""
    found: list[Epoch] = []
    unit_us = reader.header.unit_us
    for piece in pieces:
        first, last = reader.stamp_at(piece.walk.begin) * unit_us, (piece.walk.last or 0) * unit_us
        if piece.epoch < len(found):
            old = found[-1]
            found[-1] = replace(old, last_us=max(old.last_us, last))
        else:
            why = f"the clock was reset: it had counted to {found[-1].last_us} us" if found else "the log begins"
            found.append(Epoch(piece.walk.begin, first, last, why))
    return tuple(found)
