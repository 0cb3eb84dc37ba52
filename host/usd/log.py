"""What is in a µSD log: records that every reader and every tool of it shares."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

Version = Literal[1, 2, 2019]
"""2019: the format before version 1, which has no number."""
Array = np.ndarray[Any, np.dtype[Any]]

STAMP_US = "stamp_stm32_us"
STAMP_MS = "stamp_stm32_ms"
STATUS_EVENT = "log.status"
REPAIRED_EVENT = "log.repaired"
"""Of rows that repair() adds: each speaks of the rows since the one before it."""
REPAIRED_VARIABLES = ("rows", "unverified", "lost_bytes")
STATUS_VARIABLES = ("requested", "accepted", "dropped", "stall_us", "syncs", "errors", "session", "crc")


@dataclass(frozen=True, slots=True)
class Variable:
    name: str
    letter: str
    """Of its type, as in the file and in Python's struct module; e is a half-precision float."""


@dataclass(frozen=True, slots=True)
class EventType:
    """A kind of row: `fixedFrequency`, or an event."""

    id: int
    name: str
    """Unique in its log: a second type of the same name has #ID behind it."""
    variables: tuple[Variable, ...]
    dtype: np.dtype[Any]
    """Packed: the stamp (the first field), then each variable by its name."""

    @property
    def row_bytes(self) -> int:
        """In the file; the id, which the 2019 format does not have, is not counted."""
        return int(self.dtype.itemsize)


@dataclass(frozen=True, slots=True)
class ByteRange:
    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Damage:
    """Bytes of the file of which nothing is returned, or which cannot be what they should be."""

    offset: int
    size: int
    why: str


@dataclass(frozen=True, slots=True)
class Epoch:
    """Rows between two resets of the stamp clock: within it, time only goes on."""

    offset: int
    """Of its first row in the file."""
    first_us: int
    last_us: int
    why: str
    """What it begins with: the log, or a reset and how far the time went back."""


@dataclass(frozen=True)
class Rows:
    """All rows of one type that were recovered, as they follow each other in the file."""

    type: EventType
    data: Array
    """Structured, of type.dtype; the caller may write to it."""
    verified: tuple[range, ...]
    """Row numbers that a good CRC covers."""
    epochs: tuple[range, ...]
    """Row numbers of each of the log's epochs."""

    def __len__(self) -> int:
        return len(self.data)

    @cached_property
    def stamp_us(self) -> np.ndarray[Any, np.dtype[np.uint64]]:
        """Time of each row; version 1 counts in milliseconds."""
        if STAMP_US in (self.data.dtype.names or ()):
            return self.data[STAMP_US].astype(np.uint64)
        return self.data[STAMP_MS].astype(np.uint64) * np.uint64(1000)

    @cached_property
    def is_verified(self) -> np.ndarray[Any, np.dtype[np.bool_]]:
        """For each row."""
        mask = np.zeros(len(self.data), np.bool_)
        for part in self.verified:
            mask[part.start : part.stop] = True
        return mask

    @cached_property
    def epoch(self) -> np.ndarray[Any, np.dtype[np.uint32]]:
        """For each row, the number of its epoch."""
        numbers = np.zeros(len(self.data), np.uint32)
        for number, part in enumerate(self.epochs):
            numbers[part.start : part.stop] = number
        return numbers


@dataclass(frozen=True, slots=True)
class Log:
    """A decoded log: everything that can be trusted, and what cannot and why."""

    size: int
    """Of the file."""
    version: Version | None
    """None: there is no header that makes sense, and so nothing else."""
    header_bytes: int
    types: tuple[EventType, ...]
    rows: dict[str, Rows]
    """By the name of their type; every type of the header is there."""
    parts: tuple[ByteRange, ...]
    """Where the returned rows lie in the file, in order: every byte in them belongs to one."""
    verified: tuple[ByteRange, ...]
    """Bytes that a good CRC covers, and that are this log's."""
    damages: tuple[Damage, ...]
    epochs: tuple[Epoch, ...]
    crc: Literal["good", "bad", "absent"]
    """The file's own, at its end (2019: all blocks'). Absent: the log was never closed, or its end is gone."""
    session: int | None
    """Of the status rows. None: the firmware writes none."""

    @property
    def is_whole(self) -> bool:
        """Closed by the logger, and every byte as it was written."""
        return self.crc == "good" and not self.damages

    @property
    def row_count(self) -> int:
        return sum(len(each) for each in self.rows.values())

    @property
    def verified_count(self) -> int:
        return sum(len(part) for each in self.rows.values() for part in each.verified)
