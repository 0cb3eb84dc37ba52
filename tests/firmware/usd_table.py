"""What an app could log, for tests of the core: one variable of each type, and events with values of their own."""

import struct
from itertools import pairwise
from typing import Any

from c_memory import Bytes

from host.native import ffi, lib

LETTERS = "BbHhIif"
VARIABLES = [(f"t.{letter}{number}", letter) for letter in LETTERS for number in range(2)] + [
    ("g.long_name_of_31_chars_12345", "f")
]
EVENTS: list[tuple[str, list[tuple[str, str]]]] = [
    ("estTDOA", [("idA", "B"), ("idB", "B"), ("distanceDiff", "f")]),
    ("estPose", []),
    *[(f"more{number}", []) for number in range(25)],
]
VALUE_BYTES = 4


class Table:
    """`view` is a usd_table_t; the value of variable n lies at 4 n, those of an event's own behind them."""

    def __init__(self) -> None:
        self.variables = ffi.new("usd_variable_t[]", [variable(*each, n) for n, each in enumerate(VARIABLES)])
        self.events = ffi.new(
            "usd_event_t[]",
            [
                {
                    "name": name.encode(),
                    "payload_count": len(payload),
                    "payload": [variable(*each, len(VARIABLES) + n) for n, each in enumerate(payload)],
                }
                for name, payload in EVENTS
            ],
        )
        self.view = ffi.new("usd_table_t *", (self.variables, self.events, len(VARIABLES), len(EVENTS)))


def variable(name: str, letter: str, place: int) -> dict[str, Any]:
    return {"name": name.encode(), "type": letter.encode(), "offset": VALUE_BYTES * place}


def values(numbers: list[float], payload: list[float], event: str = "") -> bytes:
    """Memory with these values of the variables, and of the event's own; 0xEE where there is none."""
    own = next((each for name, each in EVENTS if name == event), [])
    memory = b""
    for (_, letter), number in zip([*VARIABLES, *own], [*numbers, *payload], strict=True):
        memory += struct.pack("<" + letter, number).ljust(VALUE_BYTES, b"\xee")
    return memory


TABLE = Table()


class Config:
    """A parsed config.txt."""

    def __init__(self, text: bytes, pieces: list[int] | None = None) -> None:
        """`pieces`: where the text is cut."""
        self.table = TABLE
        self.state = ffi.new("usd_config_t *")
        ffi.buffer(self.state)[:] = b"\xa5" * ffi.sizeof("usd_config_t")
        lib.usd_config_init(self.state, self.table.view)
        cuts = [0, *(pieces or []), len(text)]
        for begin, end in pairwise(cuts):
            lib.usd_config_put(self.state, Bytes(text[begin:end]).view)
        self.result = int(lib.usd_config_end(self.state))

    @property
    def findings(self) -> list[tuple[int, int]]:
        """Line and kind."""
        count = min(self.state.errors + self.state.warnings, lib.USD_CONFIG_FINDINGS_MAX)
        return [(each.line, each.kind) for each in self.state.findings[0:count]]

    @property
    def blocks(self) -> list[tuple[str, list[str]]]:
        found = []
        for block in self.state.blocks[0 : self.state.block_count]:
            name = "fixedFrequency" if block.event == lib.USD_CONFIG_FIXED else EVENTS[block.event][0]
            found.append((name, [VARIABLES[place][0] for place in block.variables[0 : block.variable_count]]))
        return found

    @property
    def name(self) -> str:
        return str(ffi.string(self.state.name), "ascii")
