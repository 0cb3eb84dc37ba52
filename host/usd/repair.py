"""A valid version-2 log out of what was recovered from another.

Rows of a version-2 log are copied as they are, in their order; those of older formats get 64-bit stamps in
microseconds, in the order of their times. What the decoder does not return is left out, so every row of the new file
decodes. Its CRCs fit the new file: they vouch for what was written here, not for what the logger wrote. So a row of
type `log.repaired` follows each stretch of rows and says whether they were verified, and the decoder heeds it.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from ..protocol.errors import LocalError
from .decode import Buffer
from .header import MAGIC, PREFIX, U16, read_header
from .log import REPAIRED_EVENT, REPAIRED_VARIABLES, EventType, Log, Rows, Variable
from .rows import CRC_BYTES, RowReader

U32_MAX = 0xFFFFFFFF
V2_HEAD = np.dtype([("id", "<u2"), ("stamp", "<u8")])


@dataclass(frozen=True, slots=True)
class Stretch:
    """Rows that were verified, or were not."""

    data: bytes | memoryview
    rows: int
    verified: bool
    last_us: int
    statuses: tuple[int, ...]
    """Where status rows end in `data`."""


def repair(source: Buffer, log: Log, header_of: Buffer | None = None) -> bytes:
    """The new file. `log` is what decode() has made of the others. LocalError when there is nothing to keep."""
    if not log.row_count:
        raise LocalError(f"nothing can be recovered: {log.damages[0].why if log.damages else 'it has no rows'}")
    # Notes of an earlier repair have had their effect.
    types = [replace(each, name=f"{each.name}#old") if each.name == REPAIRED_EVENT else each for each in log.types]
    number = next(free for free in range(0xFFFE, 0, -1) if all(each.id != free for each in types))
    note = EventType(number, REPAIRED_EVENT, tuple(Variable(name, "I") for name in REPAIRED_VARIABLES), np.dtype([]))
    out = bytearray(encode_header([*types, note]))
    header = memoryview(source if header_of is None else header_of).cast("B")
    stretches = list(copied(memoryview(source).cast("B"), header, log) if log.version == 2 else converted(log))
    lost = min(sum(damage.size for damage in log.damages), U32_MAX)
    covered = rows = 0
    for place, each in enumerate(stretches):
        begin = len(out)
        out += each.data
        for status in each.statuses:
            end = begin + status
            out[end - CRC_BYTES : end] = struct.pack("<I", zlib.crc32(memoryview(out)[covered : end - CRC_BYTES]))
            covered = end
        rows += each.rows
        following = stretches[place + 1].verified if place + 1 < len(stretches) else None
        if following != each.verified:
            counts = (rows, 0 if each.verified else rows, 0 if following is not None else lost)
            out += struct.pack("<HQ3I", number, each.last_us, *counts)
            rows = 0
    return bytes(out) + struct.pack("<I", zlib.crc32(out))


def encode_header(types: list[EventType]) -> bytes:
    out = PREFIX.pack(MAGIC, 2, len(types))
    for each in types:
        out += U16.pack(each.id) + each.name.encode() + b"\0" + U16.pack(len(each.variables))
        out += b"".join(f"{variable.name}({variable.letter})".encode() + b"\0" for variable in each.variables)
    return out


def copied(data: memoryview, header: memoryview, log: Log) -> Iterator[Stretch]:
    """Rows as they lie in the file."""
    reader = RowReader(data, read_header(header))
    for part in log.parts:
        walk = reader.walk(part.begin, part.end, None, strict=False)
        verified = any(each.begin <= part.begin and part.end <= each.end for each in log.verified)
        ends = tuple(at + reader.row_bytes_at(at) - part.begin for at in walk.statuses)
        yield Stretch(data[part.begin : part.end], sum(walk.rows), verified, walk.last or 0, ends)


def converted(log: Log) -> Iterator[Stretch]:
    """Rows of an older version, epoch by epoch, all types in the order of their times."""
    for number in range(len(log.epochs)):
        parts = [(rows, rows.epochs[number]) for rows in log.rows.values() if number < len(rows.epochs)]
        sizes = np.concatenate([np.full(len(part), V2_HEAD.itemsize + values_of(rows)[1]) for rows, part in parts])
        stamps = np.concatenate([rows.stamp_us[part.start : part.stop] for rows, part in parts])
        verified = np.concatenate([rows.is_verified[part.start : part.stop] for rows, part in parts])
        order = np.argsort(stamps, kind="stable")
        offsets = np.empty(len(sizes), np.int64)
        offsets[order] = np.cumsum(sizes[order]) - sizes[order]
        block = np.empty(int(sizes.sum()), np.uint8)
        at = 0
        for rows, part in parts:
            made = encoded(rows, part)
            block[offsets[at : at + len(part), None] + np.arange(made.shape[1])] = made
            at += len(part)
        borders = [0, *(np.flatnonzero(np.diff(verified[order])) + 1).tolist(), len(order)]
        places = [*offsets[order].tolist(), len(block)]
        for first, behind in pairwise(borders):
            data = block[places[first] : places[behind]].tobytes()
            yield Stretch(data, behind - first, bool(verified[order[first]]), int(stamps[order[behind - 1]]), ())


def values_of(rows: Rows) -> tuple[int, int]:
    """Where the values begin in a row of the array, and their size."""
    stamp = rows.data.dtype[0].itemsize
    return stamp, rows.data.dtype.itemsize - stamp


def encoded(rows: Rows, part: range) -> Any:
    """Rows of version 2, one in each line of bytes."""
    begin, size = values_of(rows)
    heads = np.empty(len(part), V2_HEAD)
    heads["id"], heads["stamp"] = rows.type.id, rows.stamp_us[part.start : part.stop]
    values = np.ascontiguousarray(rows.data[part.start : part.stop]).view(np.uint8).reshape(len(part), begin + size)
    return np.hstack([heads.view(np.uint8).reshape(len(part), V2_HEAD.itemsize), values[:, begin:]])
