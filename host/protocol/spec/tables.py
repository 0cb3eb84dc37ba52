"""Writes the tables of docs/PROTOCOL.md: python -m host.protocol.spec.tables docs/PROTOCOL.md [--check]

Each is put between its markers, `<!-- table: NAME -->` and `<!-- end -->`. With --check nothing is written, and the
exit status is 1 when a table is stale.
"""

import argparse
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import construct

from . import beacon, control, cpx, cpx_link, cpx_uart, image, nanocockpit, native, paper, stamp, usd
from .values import Value

LAYOUTS: dict[str, Any] = {
    "route": cpx.ROUTE,
    "uart frame": cpx_uart.FRAME,
    "uart credit": cpx_uart.CREDIT,
    "link frame": cpx_link.FRAME,
    "link idle": cpx_link.IDLE,
    "stamp": stamp.STAMP,
    "echo question": stamp.QUESTION,
    "echo answer": stamp.ANSWER,
    "stock header": image.STOCK_HEADER,
    "native frame": native.FRAME,
    "native data": native.DATA,
    "native pairs": native.PAIRS,
    "native pair": native.PAIR,
    "native status": native.STATUS,
    "native reply": native.REPLY,
    "native log": native.LOG,
    "native stream": native.STREAM,
    "native camera": native.CAMERA,
    "paper stamp": paper.STAMP,
    "paper header": paper.HEADER,
    "paper camera": paper.CAMERA,
    "nanocockpit state": nanocockpit.STATE_MESSAGE,
    "nanocockpit noise": nanocockpit.NOISE_MESSAGE,
    "nanocockpit ranges": nanocockpit.RANGES_MESSAGE,
    "nanocockpit frame": nanocockpit.FRAME,
    "nanocockpit begin": nanocockpit.BEGIN,
    "nanocockpit more": nanocockpit.MORE,
    "nanocockpit metadata": nanocockpit.METADATA,
    "nanocockpit reply": nanocockpit.REPLY,
    "beacon": beacon.BEACON,
    "usd row": usd.ROW,
    "usd status": usd.STATUS,
}

CODES: dict[str, tuple[Value, ...]] = {
    "targets": cpx.TARGETS,
    "functions": cpx.FUNCTIONS,
    "wifi commands": control.WIFI_COMMANDS,
    "system commands": control.SYSTEM_COMMANDS,
    "encodings": image.ENCODINGS,
    "native kinds": native.KINDS,
    "native flags": native.FLAGS,
    "native log states": native.LOG_STATES,
    "nanocockpit commands": nanocockpit.COMMANDS,
    "nanocockpit types": nanocockpit.TYPES,
}

LIMITS: dict[str, tuple[Value, ...]] = {
    "cpx limits": cpx.LIMITS,
    "uart times": cpx_uart.TIMES,
    "stamp times": stamp.TIMES,
    "image limits": image.LIMITS,
    "native limits": native.LIMITS,
    "paper limits": paper.LIMITS,
    "nanocockpit limits": nanocockpit.LIMITS,
}

NUMBERS = {"B": "u8", "H": "u16", "L": "u32", "Q": "u64", "h": "i16", "l": "i32", "f": "f32"}
"""By the letters of the struct module."""
MARKED = re.compile(r"(<!-- table: (?P<name>[^>]+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def unwrap(part: Any) -> Any:
    """The construct that lays out the bytes, inside those that name, check or fill it."""
    layouts = construct.Array | construct.Padded | construct.Transformed
    while True:
        if isinstance(part, construct.IfThenElse):
            part = part.thensubcon  # the longer form
        elif isinstance(part, construct.Subconstruct) and not isinstance(part, layouts):
            part = part.subcon
        else:
            return part


def fields(part: Any) -> Iterator[Any]:
    """The fields of a Struct, those of a covered part in its place."""
    for field in unwrap(part).subcons:
        inner = unwrap(field)
        if isinstance(inner, construct.Struct):
            yield from fields(inner)
        elif field.docs or field.name:
            yield field


def size_and_type(field: Any) -> tuple[int | str, str]:
    """A size that varies is a text."""
    part = unwrap(field)
    if isinstance(part, construct.Checksum):
        part = part.checksumfield
    match part:
        case construct.FormatField():
            return part.sizeof(), NUMBERS[part.fmtstr[-1]]
        case construct.Padded():
            return part.length if isinstance(part.length, int) else repr(part.length), "spare"
        case construct.Transformed():
            return part.sizeof(), "bits"
        case construct.Array(count=int(count)):
            return count * part.subcon.sizeof(), f"{count} x {size_and_type(part.subcon)[1]}"
        case construct.Array():
            return f"{part.count!r} x {part.subcon.sizeof()}", "list"
        case construct.Bytes():
            return part.length if isinstance(part.length, int) else repr(part.length), "bytes"
    return "the rest", "bytes"


def constant(field: Any) -> str:
    """` = 0x4E` for a field that has one value."""
    while isinstance(field, construct.Subconstruct):
        if isinstance(field, construct.Const):
            value = field.value
            if isinstance(value, bytes):
                return f" = {value.hex(' ').upper()}"
            return f" = 0x{value:02X}" if field.sizeof() == 1 else f" = {value}"
        field = field.subcon
    return ""


def plain(expression: str) -> str:
    """(this['length'] - 2) as a person writes it."""
    named = re.sub(r"this(?:\['_'\])*(?:\['covered'\]\['value'\])?\['(\w+)'\]", r"\1", expression)
    return named.removeprefix("(").removesuffix(")")


def bit_rows(part: Any) -> Iterator[tuple[str, ...]]:
    """Bits are counted from the most significant one of the first byte, and shown as byte and bit numbers."""
    at = 0
    for field in part.subcons:
        size = field.sizeof()
        high, low = 7 - at % 8, 7 - (at + size - 1) % 8
        where = f"bit {high}" if size == 1 else f"bits {high}..{low}"
        yield f"{at // 8}, {where}", f"{size} bit{'s' * (size > 1)}", f"u{size}", field.name, field.docs
        at += size


def byte_rows(part: Any) -> Iterator[tuple[str, ...]]:
    at: int | None = 0
    for field in fields(part):
        size, kind = size_and_type(field)
        yield "next" if at is None else str(at), plain(str(size)), kind + constant(field), field.name or "", field.docs
        at = at + size if isinstance(size, int) and at is not None else None


def layout(part: Any) -> str:
    rows = bit_rows(part.subcon) if isinstance(part, construct.Transformed) else byte_rows(part)
    return grid(("offset", "size", "type", "field", "meaning, unit"), rows)


def numbers(listed: tuple[Value, ...], form: str) -> str:
    return grid(("value", "name", "meaning"), ((form.format(v.number), v.name, v.meaning) for v in listed))


def grid(head: tuple[str, ...], rows: Iterator[tuple[str, ...]]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "".join("| " + " | ".join(cells) + " |\n" for cells in lines)


def fill(text: str) -> str:
    """`text` with every table as the specification has it. KeyError for a marker of an unknown name."""

    def table(match: re.Match[str]) -> str:
        name = match["name"]
        if name in LAYOUTS:
            made = layout(LAYOUTS[name])
        else:
            made = numbers(CODES[name], "0x{:02X}") if name in CODES else numbers(LIMITS[name], "{}")
        return match[1] + made + match[3]

    return MARKED.sub(table, text)


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("file", type=Path)
    arguments.add_argument("--check", action="store_true")
    given = arguments.parse_args()
    old = given.file.read_text(encoding="utf-8")
    new = fill(old)
    if new == old:
        return 0
    if given.check:
        print(f"{given.file} is stale: python -m host.protocol.spec.tables {given.file}", file=sys.stderr)
        return 1
    given.file.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
