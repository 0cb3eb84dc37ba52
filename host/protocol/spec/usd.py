"""The µSD log, version 2: header, rows in the order of the file, CRC-32 of all before it."""

from typing import Any

from construct import (
    Array,
    Const,
    Container,
    CString,
    Error,
    Float16l,
    Float32l,
    GreedyRange,
    Int8sl,
    Int8ul,
    Int16sl,
    Int16ul,
    Int32sl,
    Int32ul,
    Int64ul,
    Sequence,
    Struct,
    Switch,
    Tell,
    this,
)

from .checks import crc32

LETTERS = {
    "B": Int8ul, "b": Int8sl, "H": Int16ul, "h": Int16sl, "I": Int32ul, "i": Int32sl, "f": Float32l, "e": Float16l
}  # fmt: skip
TYPE = Struct(
    "id" / Int16ul * "of the rows of this type; means nothing in another file",
    "name" / CString("ascii") * "fixedFrequency, or an event",
    "count" / Int16ul * "variables in a row",
    "variables" / Array(this.count, CString("ascii")) * "name(T), T as in Python's struct module",
)

HEADER = Struct(
    "magic" / Const(0xBC, Int8ul),
    "version" / Const(2, Int16ul) * "1: stamps are u32, in ms",
    "count" / Int16ul * "types of rows",
    "types" / Array(this.count, TYPE) * "each as below",
)

ROW = Struct(
    "id" / Int16ul * "of its type",
    "stm32_us" / Int64ul * "us, STM32 stamp clock; rows are not quite in its order",
)

STATUS = Struct(
    "requested" / Int32ul * "rows since the log was opened, but status rows: accepted + dropped",
    "accepted" / Int32ul * "of these, written",
    "dropped" / Int32ul * "of these, not: there was no room",
    "stall_us" / Int32ul * "longest time that a storage operation has taken",
    "syncs" / Int32ul * "completed",
    "errors" / Int32ul * "storage operations that failed",
    "session" / Int32ul * "of the file, never 0: rows with another are an older log's",
    "crc" / Int32ul * "CRC-32 of all bytes behind the status row before (or from the first on) to here",
)


def values_of(each: Any) -> Any:
    """The values of a row of this type, packed."""
    return Sequence(*(LETTERS[variable[-2]] for variable in each.variables))


def parse(data: bytes) -> list[tuple[str, int, list[Any]]]:
    """Name, stamp and values of each row of a whole log. ValueError, ConstructError or KeyError: it is none."""
    body, stored = data[:-4], Int32ul.parse(data[-4:])
    if crc32(body) != stored:
        raise ValueError("CRC")
    head = Struct("header" / HEADER, "end" / Tell).parse(body)
    types = {each.id: each for each in head.header.types}
    values = Switch(this.head.id, {number: values_of(each) for number, each in types.items()}, default=Error)
    rows = Struct("rows" / GreedyRange(Struct("head" / ROW, "values" / values)), "end" / Tell).parse(body[head.end :])
    if rows.end != len(body) - head.end:
        raise ValueError("a row is cut off, or of no type")
    return [(types[row.head.id].name, row.head.stm32_us, list(row["values"])) for row in rows.rows]


def build(types: list[dict[str, Any]], rows: list[tuple[int, int, list[Any]]]) -> bytes:
    """A whole log of rows with id, stamp and values."""
    body = HEADER.build({"count": len(types), "types": types})
    known = {each["id"]: values_of(Container(each)) for each in types}
    for number, stamp, values in rows:
        body += ROW.build({"id": number, "stm32_us": stamp}) + known[number].build(values)
    return bytes(body + Int32ul.build(crc32(body)))
