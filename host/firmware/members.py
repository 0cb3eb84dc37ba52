"""Where the members of a variable lie, from the debug information of an image: `uart2.packets_in` of board_app."""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..protocol.errors import LocalError
from .elf import opened

TRANSPARENT = {"DW_TAG_typedef", "DW_TAG_const_type", "DW_TAG_volatile_type"}
NUMBERS = {"DW_TAG_base_type", "DW_TAG_enumeration_type"}
SIGNED = {0x05, 0x06}
"""DW_ATE_signed, DW_ATE_signed_char."""


@dataclass(frozen=True)
class Member:
    """An integer."""

    offset: int
    """From the start of the variable."""
    size: int
    signed: bool

    def of(self, memory: bytes) -> int:
        """Its value; `memory` is the whole variable's."""
        return int.from_bytes(memory[self.offset : self.offset + self.size], "little", signed=self.signed)


@functools.lru_cache(maxsize=16)
def members(path: Path, variable: str) -> dict[str, Member]:
    """By their names, parts of parts joined by dots; arrays, pointers and bit fields are left out. LocalError when the
    image does not say."""
    with opened(path) as elf:
        if elf.has_dwarf_info():
            for unit in elf.get_dwarf_info().iter_CUs():
                for entry in unit.get_top_DIE().iter_children():
                    if entry.tag == "DW_TAG_variable" and name(entry) == variable and "DW_AT_type" in entry.attributes:
                        return dict(inside(entry, "", 0))
    raise LocalError(f"{path} has no debug information on {variable}: build it with -g")


def inside(owner: Any, prefix: str, offset: int) -> Iterator[tuple[str, Member]]:
    """All integers in the type of a variable or of a member."""
    kind = owner.get_DIE_from_attribute("DW_AT_type")
    while kind.tag in TRANSPARENT:
        kind = kind.get_DIE_from_attribute("DW_AT_type")
    if kind.tag in NUMBERS:
        encoding = kind.attributes.get("DW_AT_encoding")
        signed = encoding is not None and encoding.value in SIGNED
        yield prefix, Member(offset, kind.attributes["DW_AT_byte_size"].value, signed)
    elif kind.tag in ("DW_TAG_structure_type", "DW_TAG_union_type"):
        for part in kind.iter_children():
            at = part.attributes.get("DW_AT_data_member_location")
            if part.tag == "DW_TAG_member" and not any("bit_size" in each for each in part.attributes):
                yield from inside(part, ".".join(filter(None, [prefix, name(part)])), offset + (at.value if at else 0))


def name(entry: Any) -> str:
    """Empty for one without."""
    given = entry.attributes.get("DW_AT_name")
    return str(given.value, "ascii", "replace") if given else ""
