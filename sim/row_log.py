"""A log of the µSD card from rows that are at hand: the bytes that the STM32's own logger makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from host.native import ffi, lib
from host.protocol.errors import LocalError

FIXED = "fixedFrequency"
LETTERS = {"B": "u1", "b": "i1", "H": "<u2", "h": "<i2", "I": "<u4", "i": "<i4", "f": "<f4"}
RING_BYTES = 65535
ROWS_AT_ONCE = 200
"""Fit the ring, whatever is in a row; each ends with a status row."""


@dataclass(frozen=True, slots=True)
class Block:
    """Rows of one kind: FIXED, or an event of the STM32's table."""

    name: str
    stamp_us: NDArray[np.int64]
    """In order."""
    columns: Mapping[str, NDArray[Any]]
    """By variables of the STM32's table, as "gyro.x"."""


def row_log(blocks: Sequence[Block], hz: int = 1000, session: int = 1) -> bytes:
    """The file. Rows of several blocks follow each other by their stamps. `hz`: what config.txt asks of FIXED rows; a
    power of ten by 1, 2 or 5, or a divisor of 1000."""
    table = ffi.new("usd_table_t *", lib.stm32_table())  # The configuration refers to it.
    config = parsed(blocks, table, hz)
    places = {ffi.string(table.variables[n].name).decode(): n for n in range(table.variable_count)}
    size = ffi.sizeof("stm32_values_t")
    memories = []
    for block in blocks:
        memory = np.zeros((len(block.stamp_us), size), np.uint8)
        for name, values in block.columns.items():
            variable = table.variables[places[name]]
            kind = np.dtype(LETTERS[variable.type.decode()])
            memory[:, variable.offset : variable.offset + kind.itemsize] = (
                np.ascontiguousarray(values, kind).view(np.uint8).reshape(len(values), kind.itemsize)
            )
        memories.append(memory)
    stamps = np.concatenate([block.stamp_us for block in blocks])
    owner = np.repeat(np.arange(len(blocks)), [len(block.stamp_us) for block in blocks])
    row = np.concatenate([np.arange(len(block.stamp_us)) for block in blocks])
    order = np.argsort(stamps, kind="stable")
    return logged(config, memories, owner[order].tolist(), row[order].tolist(), stamps[order].tolist(), session)


def parsed(blocks: Sequence[Block], table: Any, hz: int) -> Any:
    """config.txt for these blocks, as the logger has read it."""
    head = f"1\n{RING_BYTES}\nlog\n1\n"
    text = head + "".join(
        f"on:{each.name}\n"
        + (f"{hz}\n1\n" if each.name == FIXED else "")
        + "".join(f"{name}\n" for name in each.columns)
        for each in blocks
    )
    config = ffi.new("usd_config_t *")
    lib.usd_config_init(config, table)
    lib.usd_config_put(config, (ffi.from_buffer("uint8_t[]", text.encode()), len(text)))
    if lib.usd_config_end(config) < 0 or config.errors:
        raise LocalError(f"the STM32's logger does not take line {config.findings[0].line} of: {text}")
    return config


def logged(
    config: Any,
    memories: Sequence[NDArray[np.uint8]],
    owner: list[int],
    row: list[int],
    stamps: list[int],
    session: int,
) -> bytes:
    state = ffi.new("usd_log_t *")
    ring = ffi.new("uint8_t[]", RING_BYTES)
    start = ffi.new("usd_counters_t *", {"session": session})
    room = ffi.new("uint8_t[]", RING_BYTES)
    file = bytearray()

    def write() -> None:
        while got := lib.usd_log_peek(state, (room, RING_BYTES)):
            file.extend(ffi.buffer(room, got))
            lib.usd_log_taken(state, got)

    lib.usd_log_begin(state, config, ring, start, stamps[0])
    values = [ffi.cast("uint8_t *", ffi.from_buffer(memory)) for memory in memories]
    size = ffi.sizeof("stm32_values_t")
    for count, (block, place, stamp) in enumerate(zip(owner, row, stamps, strict=True), 1):
        lib.usd_log_row(state, config.blocks + block, stamp, values[block] + place * size)
        if count % ROWS_AT_ONCE == 0:
            write()
            lib.usd_log_status(state, stamp)
            write()
    write()
    lib.usd_log_end(state, stamps[-1])
    write()
    return bytes(file)
