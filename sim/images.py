"""Firmware images: an ELF file as the simulator loads it, and what its addresses are called."""

from __future__ import annotations

import bisect
import functools
import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from host.firmware import build, members
from host.firmware.elf import loads, opened, source_names
from host.native import ffi, lib
from host.protocol.errors import LocalError

SYMBOLS = {
    "board_config": "board_config",
    "board_stamp_reset": "board_stamp_reset",
    "board_init_result": "board_init_result",
    "board_app": "board_app",
    "stack_top": "_stack_top",
    "stack_limit": "_stack_limit",
}
"""Fields of image_t, and the symbols in the ELF."""
SIZED = {"board_config", "board_app"}
MACHINES = {"EM_ARM": "stm32", "EM_RISCV": "gap8"}
MCUS = {"stm32": lib.MCU_STM32, "gap8": lib.MCU_GAP8}


@dataclass(frozen=True)
class Image:
    """Loaded; `pointer` is an image_t *, which lives as long as this object."""

    path: Path
    mcu: str
    """stm32 or gap8."""
    pointer: Any
    symbols: dict[str, tuple[int, int]]
    """Address (without the Thumb bit) and size by name; a name that several have is none."""
    places: list[tuple[int, int, str]]
    """Address, size and name of all, by address."""
    keep: tuple[Any, ...]
    """What `pointer` points to."""

    def place(self, address: int) -> str:
        """The function or variable that an address is in, `name+0x12`, or nothing."""
        at = bisect.bisect_right(self.places, (address, 1 << 32, "")) - 1
        if at < 0 or not address < self.places[at][0] + max(self.places[at][1], 1):
            return ""
        start, _, name = self.places[at]
        return name if start == address else f"{name}+0x{address - start:x}"

    def members(self, variable: str) -> dict[str, members.Member]:
        """Where the integers in a variable are, by name: LocalError without debug information."""
        return members.members(self.path, variable)

    def explain(self, report: str) -> str:
        """The kernel's report of a failure with the names of the functions that it points into."""
        return re.sub(
            r"\b(pc|lr|ra|thread)=(0x[0-9a-f]{8})",
            lambda found: " ".join(filter(None, [found[0], _bracketed(self.place(int(found[2], 16) & ~1))])),
            report,
        )


def _bracketed(name: str) -> str:
    return f"({name})" if name else ""


@functools.lru_cache(maxsize=16)
def _loaded(path: Path) -> Image:
    return load(path)


def built(mcu: str, toolchain: str | None = None) -> Image:
    """That of this package's sources, built when it is first asked for. LocalError without compiler or pyelftools."""
    return _loaded(build.build(mcu, toolchain).elf)


def load(path: str | Path) -> Image:
    """An ELF file of `host firmware build`, or any that has the symbols of SYMBOLS. LocalError if it is none."""
    path = Path(path)
    with opened(path) as elf:
        return _image(path, elf)


def _image(path: Path, elf: Any) -> Image:
    machine = elf["e_machine"]
    if machine not in MACHINES or elf.elfclass != 32:
        named = "the esp32" if machine == "EM_XTENSA" else machine
        raise LocalError(f"{path} is for {named}: images that can be run are those of {', '.join(MCUS)}")
    table = next(elf.iter_sections("SHT_SYMTAB"), None)
    if table is None:
        raise LocalError(f"{path} has no symbols: build it without -s, and do not strip it")
    thumb = machine == "EM_ARM"
    named = [
        symbol
        for symbol in table.iter_symbols()
        if symbol["st_info"]["type"] in {"STT_FUNC", "STT_OBJECT", "STT_NOTYPE"}
        and symbol.name
        and not symbol.name.startswith(("$", "."))
    ]
    code_mask = ~1 if thumb else ~0
    places = [
        (symbol["st_value"] & (code_mask if symbol["st_info"]["type"] == "STT_FUNC" else ~0), symbol["st_size"], name)
        for symbol, name in zip(named, source_names(symbol.name for symbol in named), strict=True)
    ]
    count = Counter(name for _, _, name in places)
    symbols = {name: (address, size) for address, size, name in places if count[name] == 1}
    for name in SYMBOLS.values():
        if name not in symbols:
            many = count[name] or "no"
            raise LocalError(f"{path} has {many} symbols called {name} instead of one: it was not built for this board")
    segments = [(segment["p_paddr"], bool(segment["p_flags"] & 1), segment.data()) for segment in loads(elf)]
    buffers = [ffi.from_buffer("uint8_t[]", data) for _, _, data in segments]
    array = ffi.new(
        "image_segment_t[]",
        [
            {"address": address, "executable": executable, "bytes": {"data": buffer, "size": len(buffer)}}
            for (address, executable, _), buffer in zip(segments, buffers, strict=True)
        ],
    )
    mcu = MACHINES[machine]
    pointer = ffi.new("image_t *")
    pointer.mcu = MCUS[mcu]
    pointer.segments = array
    pointer.segment_count = len(segments)
    pointer.entry = elf["e_entry"] & ~1 if thumb else elf["e_entry"]
    for field, name in SYMBOLS.items():
        address, size = symbols[name]
        setattr(pointer, field, address)
        if field in SIZED:
            setattr(pointer, f"{field}_bytes", size)
    return Image(path, mcu, pointer, symbols, sorted(places), (array, *buffers))
