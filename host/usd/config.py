"""config.txt of the µSD card, read by the firmware's own parser: what it makes of it, and what is wrong with each line.

The parser needs to know which variables and events there are. Only the firmware itself knows for sure: see Names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..native import ffi, lib
from ..protocol.errors import LocalError
from .config_findings import RING_PLACE, Finding, beyond, digits, explain, nothing
from .header import NUMPY
from .log import STATUS_EVENT, Log, Rows, Variable

FIXED = "fixedFrequency"
IMU_HZ = 1000.0
"""Of the events that come with each of its samples."""
TABLE_MAX = 255
"""Names that the parser's table takes."""
PAYLOADS: Mapping[str, str] = {
    "activeMarkerModeChanged": "B",
    "estAbsoluteHeight": "",
    "estAcceleration": "",
    "estBarometer": "",
    "estDistance": "Bf",
    "estFlow": "",
    "estGyroscope": "",
    "estPose": "",
    "estPosition": "B",
    "estSweepAngle": "BBBff",
    "estTDOA": "BBf",
    "estTOF": "",
    "estYawError": "f",
}
"""Types of what the events of the Crazyflie's firmware carry of their own (estimator.c)."""


@dataclass(frozen=True, slots=True)
class Names:
    """What can be logged."""

    source: str
    """Who says so, for messages."""
    variables: Mapping[str, str]
    """Types by name, as in the file."""
    payloads: Mapping[str, str]
    """By event: types of the values that it carries of its own."""
    rates_hz: Mapping[str, float] = field(default_factory=dict)
    """By event, where they were seen."""
    is_ours: bool = False
    """Of this project's firmware."""
    typed: bool = True
    """False: types are not known, and the largest ones are taken."""


@dataclass(frozen=True, slots=True)
class Block:
    """A kind of row."""

    event: str
    variables: tuple[Variable, ...]
    lines: tuple[int, ...]
    """Of each variable."""
    row_bytes: int
    """With id, time and what the event carries of its own."""


@dataclass(frozen=True, slots=True)
class Config:
    """What the firmware makes of a config.txt."""

    usable: bool
    """False: nothing is logged."""
    ring_bytes: int
    stock_ring_bytes: int
    """That the Crazyflie's firmware makes: as many as there stand."""
    name: str
    on_startup: bool
    fixed_hz: float
    """Of the rows of fixedFrequency; 0: there are none."""
    blocks: tuple[Block, ...]
    findings: tuple[Finding, ...]

    @property
    def errors(self) -> int:
        return sum(each.severity == "error" for each in self.findings)

    @property
    def warnings(self) -> int:
        return len(self.findings) - self.errors


def names_of_firmware() -> Names:
    """What this project's firmware offers (firmware/stm32/values.h)."""
    table = lib.stm32_table()
    return Names(
        "this project's firmware",
        {text(each.name): each.type.decode() for each in table.variables[0 : table.variable_count]},
        {
            text(each.name): "".join(value.type.decode() for value in each.payload[0 : each.payload_count])
            for each in table.events[0 : table.event_count]
        },
        {"estGyroscope": IMU_HZ, "estAcceleration": IMU_HZ},
        is_ours=True,
    )


def names_of_log(log: Log, source: str) -> Names:
    """What a robot has logged before; an event's own values have no group in their names."""
    variables: dict[str, str] = {}
    payloads: dict[str, str] = {}
    rates: dict[str, float] = {}
    for each in log.types:
        if each.name == STATUS_EVENT:
            continue
        variables |= {variable.name: variable.letter for variable in each.variables if "." in variable.name}
        if each.name != FIXED:
            payloads[each.name] = "".join(variable.letter for variable in each.variables if "." not in variable.name)
            rates[each.name] = float(most_in_a_second(log.rows[each.name]))
    if not log.types:
        raise LocalError(f"{source}: no names in it: {log.damages[0].why if log.damages else 'it has no header'}")
    return Names(source, variables, payloads, rates)


def most_in_a_second(rows: Rows) -> int:
    """Events come and go: the ring has to bear them when they come."""
    most = 0
    for part in rows.epochs:
        stamps = np.sort(rows.stamp_us[part.start : part.stop])
        behind = np.searchsorted(stamps, stamps + np.uint64(1_000_000))
        most = max(most, int((behind - np.arange(len(stamps))).max(initial=0)))
    return most


def names_of_text(text: bytes) -> Names:
    """Whatever it asks for exists, unless it is a known event in other letters. Types are not known: no value takes
    more than a float."""
    said = [line.decode("ascii", "replace") for _, line in lines_of(text)]
    variables = {each: "f" for each in said if re.fullmatch(r"\w+\.\w+", each)}
    known = {each.lower() for each in (FIXED, *PAYLOADS)}
    asked = {each[3:]: "" for each in said if re.fullmatch(r"on:\w+", each) and each[3:].lower() not in known}
    return Names("", variables, {**PAYLOADS, **asked}, typed=False)


def lines_of(text: bytes) -> Iterator[tuple[int, bytes]]:
    """Number and content of each line: neither white space nor comments count."""
    for number, line in enumerate(text.split(b"\n"), 1):
        yield number, b"".join(line.split(b"#")[0].split())


def read_config(text: bytes, names: Names) -> Config:
    """Never an exception for what is in it, but for more names than any firmware takes."""
    parser = Parser(text, names)
    for number, line in enumerate(re.findall(rb"[^\n]*\n|[^\n]+", text), 1):
        parser.put(number, line)
    return parser.end()


class Parser:
    """The C's, with all of its findings: it keeps sixteen, so they are taken out line by line."""

    def __init__(self, text: bytes, names: Names) -> None:
        said = dict(lines_of(text))
        self._said = {number: line.decode("latin-1") for number, line in said.items()}
        filled = [number for number, line in self._said.items() if line]
        self._places = {line: place for place, line in enumerate(filled, 1)}
        asked = {each for each in self._said.values() if len(each.removeprefix("on:")) <= lib.USD_CONFIG_LINE_MAX}
        self._names = names
        self._variables = [name for name in names.variables if name in asked]
        self._events = [name for name in names.payloads if f"on:{name}" in asked]
        if max(len(self._variables), len(self._events)) > TABLE_MAX:
            raise LocalError(f"more than {TABLE_MAX} different names: no firmware takes so many")
        self._keep = (
            ffi.new("usd_variable_t[]", [c_name(name) for name in self._variables]),
            ffi.new("usd_event_t[]", [c_name(name) for name in self._events]),
        )
        self._table = ffi.new("usd_table_t *", (*self._keep, len(self._variables), len(self._events)))
        self._state = ffi.new("usd_config_t *")
        self._findings: list[Finding] = []
        self._lines: dict[int, list[int]] = {}
        lib.usd_config_init(self._state, self._table)

    def put(self, number: int, line: bytes) -> None:
        before = self._counts()
        lib.usd_config_put(self._state, (ffi.from_buffer("uint8_t[]", line), len(line)))
        self._take(number, before)

    def _counts(self) -> list[int]:
        return [block.variable_count for block in self._state.blocks]

    def _take(self, number: int, before: list[int]) -> None:
        for block, (old, new) in enumerate(zip(before, self._counts(), strict=True)):
            if new > old:
                self._lines.setdefault(block, []).append(number)
        count = self._state.errors + self._state.warnings
        for found in self._state.findings[0:count]:
            text = self._said.get(found.line, "")
            place = self._places.get(found.line, 0)
            self._findings.append(explain(found.line, found.kind, text, place, self._names))
        self._state.errors = self._state.warnings = 0

    def end(self) -> Config:
        state = self._state
        before = self._counts()
        usable = lib.usd_config_end(state) == 0
        self._take(len(self._said), before)
        blocks = tuple(self._block(place, each) for place, each in enumerate(state.blocks[0 : state.block_count]))
        ring_line = next((line for line, place in self._places.items() if place == RING_PLACE), 0)
        if not usable and not any(each.severity == "error" for each in self._findings):
            self._findings.append(nothing(len(self._said)))
        return Config(
            usable=usable,
            ring_bytes=int(state.ring_bytes),
            stock_ring_bytes=int(digits(self._said.get(ring_line, "")) or 0),
            name=ffi.string(state.name).decode("ascii"),
            on_startup=bool(state.on_startup),
            fixed_hz=1e6 / state.period_us if state.period_us else 0.0,
            blocks=blocks,
            findings=tuple(sorted([*self._findings, *beyond(blocks, state.ring_bytes, ring_line)])),
        )

    def _block(self, place: int, block: Any) -> Block:
        event = FIXED if block.event == lib.USD_CONFIG_FIXED else self._events[block.event]
        picked = [self._variables[each] for each in block.variables[0 : block.variable_count]]
        letters = "".join(self._names.variables[name] for name in picked) + self._names.payloads.get(event, "")
        size = lib.USD_ROW_HEAD_BYTES + sum(np.dtype(NUMPY[letter]).itemsize for letter in letters)
        variables = tuple(Variable(name, self._names.variables[name]) for name in picked)
        return Block(event, variables, tuple(self._lines.get(place, ())), size)


def text(name: Any) -> str:
    return str(ffi.string(name).decode("ascii"))


def c_name(name: str) -> dict[str, bytes]:
    return {"name": name.encode("ascii")}
