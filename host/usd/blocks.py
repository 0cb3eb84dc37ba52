"""The format of 2019, before version 1: one type of rows, in blocks of up to 255, each with its own CRC-32.

u8 number of variables; `name(T),` for each, the first one `tick(I),`; CRC. Then blocks: u8 number of rows, the rows,
CRC. Each CRC covers everything since the one before, and is stored inverted. `tick` is in microseconds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from .header import AHEAD_US, BACK_US, HeaderError, event_type, variable
from .log import STAMP_US, ByteRange, Damage, Epoch, EventType, Log, Rows
from .rows import crc32, filling

FIRST = b"tick(I),"
NAME = "fixedFrequency"
FIXED_FREQUENCY = 0xFFFF
"""Its id in later versions; here it has none."""
HEADER_MAX = 1 + 255 * 64
PRINTABLE = bytes(byte if 0x21 <= byte <= 0x7E else 0x3F for byte in range(256))
"""What of a damaged name no log of version 2 could have becomes a question mark."""
CRC_BYTES = 4
GOOD = 0xFFFFFFFF
"""CRC of some bytes and their inverted CRC behind them."""


@dataclass(frozen=True, slots=True)
class Block:
    begin: int
    """Of its rows."""
    rows: int
    good: bool


def decode_blocks(data: memoryview) -> Log | None:
    """None: not of this format."""
    if bytes(data[1 : 1 + len(FIRST)]) != FIRST:
        return None
    try:
        rows_type, size = read_header(data)
    except HeaderError as error:
        damage = Damage(0, len(data), f"{error.why} (byte {error.at})")
        return Log(len(data), 2019, 0, (), {}, (), (), (damage,), (), "absent", None)
    header_good = crc32(data, 0, size) == GOOD
    blocks, damages = find_blocks(data, size, rows_type.row_bytes)
    if not header_good:
        damages.insert(0, Damage(0, size, "the header's CRC is bad: nothing is verified, names and sizes may be wrong"))
        blocks = [replace(each, good=False) for each in blocks]
    return assemble(data, rows_type, size, blocks, damages)


def read_header(data: memoryview) -> tuple[EventType, int]:
    """Of the rows, and how long the header is with its CRC."""
    at = 1
    text = bytes(data[:HEADER_MAX])
    variables = []
    for _ in range(data[0]):
        end = text.find(b",", at)
        if end < 0:
            raise HeaderError(at, "the file is cut off in the header")
        variables.append(variable(text[at:end].translate(PRINTABLE).decode("ascii"), end))
        at = end + 1
    if at + CRC_BYTES > len(data):
        raise HeaderError(at, "the file is cut off in the header")
    made = event_type(FIXED_FREQUENCY, NAME, variables[1:], STAMP_US)
    dtype: list[Any] = [(name, made.dtype[name]) for name in made.dtype.names or ()]
    dtype[0] = (STAMP_US, "<u4")
    return EventType(made.id, made.name, made.variables, np.dtype(dtype)), at + CRC_BYTES


def find_blocks(data: memoryview, at: int, row: int) -> tuple[list[Block], list[Damage]]:
    blocks: list[Block] = []
    damages: list[Damage] = []
    last: int | None = None
    while at < len(data):
        block = block_at(data, at, row)
        if block is None or (not block.good and not leads_on(data, block, row, last)):
            found = next_block(data, at + 1, row, last)
            rows = plausible_rows(data, at, min(found, len(data)), row, last)
            if rows:
                blocks.append(Block(at + 1, rows, False))
            begin = at + (1 + rows * row if rows else 0)
            why = "cut off inside a block" if found == len(data) else "no block with a good CRC begins here"
            if kind := filling(data[begin:found]):
                why = kind
            damages.append(Damage(begin, found - begin, why))
            at = found
            continue
        end = block_end(block, row)
        if not block.good:
            why = "a block's CRC, which does not match: its rows are unverified"
            damages.append(Damage(end - CRC_BYTES, CRC_BYTES, why))
        blocks.append(block)
        last = tick(data, block.begin + (block.rows - 1) * row)
        at = end
    return blocks, damages


def block_at(data: memoryview, at: int, row: int) -> Block | None:
    rows = data[at]
    end = at + 1 + rows * row + CRC_BYTES
    if rows == 0 or end > len(data):
        return None
    return Block(at + 1, rows, crc32(data, at, end) == GOOD)


def block_end(block: Block, row: int) -> int:
    return block.begin + block.rows * row + CRC_BYTES


def leads_on(data: memoryview, block: Block, row: int, last: int | None) -> bool:
    """Is a block with a bad CRC at least as long as it says? Then a good one, or the end, is behind it."""
    end = block_end(block, row)
    if plausible_rows(data, block.begin - 1, end, row, last) != block.rows:
        return False
    if end == len(data):
        return True
    behind = block_at(data, end, row)
    return behind is not None and behind.good


def plausible_rows(data: memoryview, at: int, end: int, row: int, last: int | None) -> int:
    """How many rows of a block that begins at `at` and is cut off before `end` have times that go on."""
    count = 0
    for number in range(data[at]):
        begin = at + 1 + number * row
        if begin + row > end:
            break
        stamp = tick(data, begin)
        if last is not None and not -BACK_US <= stamp - last <= AHEAD_US:
            break
        last = stamp
        count += 1
    return count


def next_block(data: memoryview, at: int, row: int, last: int | None) -> int:
    """The first place from `at` on where a block with a good CRC begins; the end if there is none."""
    size = len(data) - 1 - row - CRC_BYTES
    if size < at:
        return len(data)
    # At every byte: a number of rows, and a tick that goes on.
    counts = np.frombuffer(data, np.uint8)[at : size + 1]
    ticks = np.ndarray(len(counts), "<u4", data, at + 1, (1,)).astype(np.int64)
    likely = counts > 0
    if last is not None:
        likely &= (ticks >= last - BACK_US) & (ticks <= last + AHEAD_US)
    for place in np.flatnonzero(likely):
        found = block_at(data, at + int(place), row)
        if found is not None and found.good:
            return at + int(place)
    return len(data)


def tick(data: memoryview, at: int) -> int:
    return int.from_bytes(data[at : at + 4], "little")


def assemble(data: memoryview, rows_type: EventType, size: int, blocks: list[Block], damages: list[Damage]) -> Log:
    row = rows_type.row_bytes
    taken = bytearray().join(data[each.begin : each.begin + each.rows * row] for each in blocks)
    rows = np.frombuffer(taken, rows_type.dtype)
    starts = np.cumsum([0, *(each.rows for each in blocks)])
    verified: list[range] = []
    for number, each in enumerate(blocks):
        first, behind = int(starts[number]), int(starts[number + 1])
        if each.good and verified and verified[-1].stop == first:
            verified[-1] = range(verified[-1].start, behind)
        elif each.good:
            verified.append(range(first, behind))
    epochs, numbers = epochs_of(rows, blocks, starts)
    return Log(
        size=len(data),
        version=2019,
        header_bytes=size,
        types=(rows_type,),
        rows={NAME: Rows(rows_type, rows, tuple(verified), numbers)},
        parts=tuple(ByteRange(each.begin, each.begin + each.rows * row) for each in blocks),
        verified=tuple(ByteRange(each.begin - 1, block_end(each, row)) for each in blocks if each.good),
        damages=tuple(damages),
        epochs=epochs,
        crc="bad" if damages else "good",
        session=None,
    )


def epochs_of(rows: Any, blocks: list[Block], starts: Any) -> tuple[tuple[Epoch, ...], tuple[range, ...]]:
    stamps = rows[STAMP_US].astype(np.int64)
    borders = [0, *(int(at) + 1 for at in np.flatnonzero(np.diff(stamps) < -BACK_US)), len(rows)]
    epochs: list[Epoch] = []
    numbers: list[range] = []
    for first, behind in pairwise(borders):
        if first == behind:
            continue
        block = int(np.searchsorted(starts, first, side="right")) - 1
        offset = blocks[block].begin + (first - int(starts[block])) * rows.dtype.itemsize
        why = f"the clock was reset: it had counted to {epochs[-1].last_us} us" if epochs else "the log begins"
        part = stamps[first:behind]
        epochs.append(Epoch(offset, int(part[0]), int(part.max()), why))
        numbers.append(range(first, behind))
    return tuple(epochs), tuple(numbers)
