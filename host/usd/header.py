"""The header of a log, version 1 and 2: which types of rows there are and how each is laid out."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..native import ffi, lib
from .log import (
    REPAIRED_EVENT,
    REPAIRED_VARIABLES,
    STAMP_MS,
    STAMP_US,
    STATUS_EVENT,
    STATUS_VARIABLES,
    EventType,
    Variable,
)

MAGIC = 0xBC
PREFIX = struct.Struct("<BHH")
U16 = struct.Struct("<H")
NAME_MAX = 255
VARIABLES_MAX = 1024
"""The firmware takes 20 events of 20 variables, the paper's fork 54; more than this is no header."""
NUMPY = {"B": "<u1", "b": "<i1", "H": "<u2", "h": "<i2", "I": "<u4", "i": "<i4", "f": "<f4", "e": "<f2"}

BACK_US = 100_000
"""Stamps are taken before the logger's lock, so rows may come a little out of order; further back is a reset."""
AHEAD_US = 600_000_000
"""No row for so long: the next one is believed only with others that follow it."""
NEAR_US = 10_000_000
"""The same for rows behind damage."""


class HeaderError(Exception):
    """The bytes are not a header. `at`: where that shows."""

    def __init__(self, at: int, why: str) -> None:
        super().__init__(why)
        self.at = at
        self.why = why


@dataclass(frozen=True, slots=True)
class Header:
    version: int
    size: int
    types: tuple[EventType, ...]
    layout: Any
    """usd_layout_t of the C."""
    status: int | None
    """Which of the types is that of status rows."""
    repaired: int | None
    """And that of repair()'s notes."""
    borrowed: bool = False
    """It is another log's."""

    @property
    def unit_us(self) -> int:
        """Of stamps."""
        return 1 if self.version == 2 else 1000


class Cursor:
    def __init__(self, data: memoryview, at: int) -> None:
        self._data = data
        self.at = at

    def number(self) -> int:
        if self.at + U16.size > len(self._data):
            raise HeaderError(self.at, "the file is cut off in the header")
        self.at += U16.size
        return int(U16.unpack_from(self._data, self.at - U16.size)[0])

    def name(self) -> str:
        """Printable ASCII, as the firmware's names are: anything else is a sign of damage."""
        begin = self.at
        window = bytes(self._data[begin : begin + NAME_MAX + 1])
        size = window.find(0)
        if size < 0:
            short = len(window) <= NAME_MAX
            raise HeaderError(begin, "the file is cut off in the header" if short else "a name that does not end")
        if not size or any(not 0x21 <= byte <= 0x7E for byte in window[:size]):
            raise HeaderError(begin, "a name in the header is damaged")
        self.at += size + 1
        return window[:size].decode("ascii")


def read_header(data: memoryview) -> Header:
    """HeaderError when there is none."""
    if not data:
        raise HeaderError(0, "empty: what the stock firmware leaves behind when power goes before the log is closed")
    if data[0] != MAGIC:
        raise HeaderError(0, f"not a log: it begins with 0x{data[0]:02X}, a log with 0x{MAGIC:02X}")
    if len(data) < PREFIX.size:
        raise HeaderError(0, "cut off in the header")
    _, version, count = PREFIX.unpack_from(data)
    if version not in (1, 2):
        raise HeaderError(1, f"version {version} is not known (1 and 2 are), or the header is damaged")
    if not 0 < count <= lib.USD_TYPES_MAX:
        raise HeaderError(3, f"{count} types of rows: the header is damaged")
    cursor = Cursor(data, PREFIX.size)
    types: list[EventType] = []
    for _ in range(count):
        begin = cursor.at
        each = read_type(cursor, STAMP_US if version == 2 else STAMP_MS)
        if any(other.id == each.id for other in types):
            raise HeaderError(begin, f"two types of rows have the id {each.id}: the header is damaged")
        types.append(unique(each, types))
    status, repaired = (
        next((number for number, each in enumerate(types) if is_one(each, name, variables)), None)
        for name, variables in ((STATUS_EVENT, STATUS_VARIABLES), (REPAIRED_EVENT, REPAIRED_VARIABLES))
    )
    return Header(version, cursor.at, tuple(types), layout(version, types, status), status, repaired)


def read_type(cursor: Cursor, stamp: str) -> EventType:
    number, name, begin = cursor.number(), cursor.name(), cursor.at
    count = cursor.number()
    if count > VARIABLES_MAX:
        raise HeaderError(begin, f"{count} variables in a row: the header is damaged")
    return event_type(number, name, [variable(cursor.name(), cursor.at) for _ in range(count)], stamp)


def variable(text: str, end: int) -> Variable:
    """From `name(T)`."""
    name, bracket, letter = text[:-3], text[-3:-2], text[-2:-1]
    if not name or bracket != "(" or text[-1] != ")" or letter not in NUMPY:
        raise HeaderError(end - len(text) - 1, f"{text!r} is not a variable with its type: the header is damaged")
    return Variable(name, letter)


def event_type(number: int, name: str, variables: Iterable[Variable], stamp: str) -> EventType:
    """With its dtype. Fields of a dtype need different names: a second one gets #2 behind it."""
    fields: dict[str, str] = {stamp: "<u4" if stamp == STAMP_MS else "<u8"}
    named: list[Variable] = []
    for each in variables:
        free = each.name
        copies = 2
        while free in fields:
            free = f"{each.name}#{copies}"
            copies += 1
        fields[free] = NUMPY[each.letter]
        named.append(Variable(free, each.letter))
    return EventType(number, name, tuple(named), np.dtype(list(fields.items())))


def unique(each: EventType, others: list[EventType]) -> EventType:
    if all(other.name != each.name for other in others):
        return each
    return EventType(each.id, f"{each.name}#{each.id}", each.variables, each.dtype)


def is_one(each: EventType, name: str, variables: tuple[str, ...]) -> bool:
    """Of our own: exactly that name with exactly these counters."""
    return each.name == name and each.variables == tuple(Variable(variable, "I") for variable in variables)


def layout(version: int, types: list[EventType], status: int | None) -> Any:
    made = ffi.new("usd_layout_t *")
    made.stamp_bytes = 8 if version == 2 else 4
    made.types = len(types)
    made.status = len(types) if status is None else status
    unit_us = 1 if version == 2 else 1000
    made.back, made.ahead, made.near = (each // unit_us for each in (BACK_US, AHEAD_US, NEAR_US))
    for number, each in enumerate(types):
        made.row_bytes[number] = lib.USD_ID_BYTES + each.row_bytes
        made.type_of_id[each.id] = number + 1
    return made
