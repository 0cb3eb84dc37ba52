"""What a packet or a message says: fields by name, with their values in words where they are codes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from construct import Array, ConstructError

from ..spec import image, native, tables
from ..spec.values import Value

Codes = Mapping[str, tuple[Value, ...]]
"""The values that a field can have, by its name."""
CODES: Codes = {
    "encoding": image.ENCODINGS,
    "type": image.ENCODINGS,
    "request": native.KINDS,
    "dialect": (Value(0, "stock", ""), Value(1, "native", "")),
}


class Field(NamedTuple):
    """One decoded field."""

    name: str
    value: Any
    """As JSON can hold it."""
    meaning: str
    """With the unit; from the specification."""
    words: str = ""
    """Of a code."""


@dataclass
class Meaning:
    """Of one piece."""

    about: str
    fields: list[Field] = field(default_factory=list)


def parsed_or_none(struct: Any, data: bytes) -> Any:
    try:
        return struct.parse(data)
    except ConstructError:
        return None


def unreadable(about: str, data: bytes, error: Exception) -> Meaning:
    """Its start is right and the rest is not."""
    reason = next((line for line in str(error).splitlines() if line and not line.startswith("Error in path")), "")
    return Meaning(f"{about}, unreadable: {reason or type(error).__name__}", data_field(data))


def data_field(data: bytes) -> list[Field]:
    """What has no names inside."""
    return [Field("data", data.hex(), f"{len(data)} bytes")] if data else []


def fields_of(struct: Any, parsed: Any, codes: Codes = CODES) -> Iterator[Field]:
    """Every field that says something, those of a part in its place; constants, spare bytes and bodies do not."""
    values = flat(parsed)
    for each in tables.fields(struct):
        if not each.name or tables.constant(each) or each.name not in values:
            continue
        value = values[each.name]
        if isinstance(value, bytes):
            continue
        if isinstance(tables.unwrap(each), Array):
            yield Field(each.name, [row_of(row) for row in value], each.docs)
            continue
        yield Field(each.name, finite(value), each.docs, words(each.name, value, codes))


def flat(parsed: Any) -> dict[str, Any]:
    """The values of a container and of those in it."""
    values: dict[str, Any] = {}
    for name, value in parsed.items():
        values |= flat(value) if isinstance(value, dict) else {name: value}
    return values


def row_of(row: Any) -> Any:
    """Of a list: a number, or the fields of one of its rows."""
    return (
        {name: value for name, value in row.items() if not name.startswith("_")}
        if isinstance(row, dict)
        else finite(row)
    )


def finite(value: Any) -> Any:
    """JSON has no number for the others."""
    return str(value) if isinstance(value, float) and not math.isfinite(value) else value


def words(name: str, value: int, codes: Codes) -> str:
    """Of a code: its name, or its names when it is a sum of flags."""
    if name == "flags":
        return ", ".join(flag.name.removeprefix("FRAME_") for flag in native.FLAGS if value & flag.number) or "none"
    return next((code.name.partition("_")[2] or code.name for code in codes.get(name, ()) if code.number == value), "")
