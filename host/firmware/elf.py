"""What is in a linked image: its sections, functions and memories. The only reader of ELF files here."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..protocol.errors import LocalError
from .targets import TARGETS, Target

MARK = "board_config"
"""A symbol of every image of ours."""

SHF_ALLOC = 2


@dataclass(frozen=True)
class Section:
    """What is loaded or reserved, by address."""

    name: str
    address: int
    bytes: int


@dataclass(frozen=True)
class Function:
    """Code, by size."""

    name: str
    address: int
    bytes: int


@dataclass(frozen=True)
class Use:
    """How full a memory is."""

    memory: str
    bytes: int
    of_bytes: int


@dataclass(frozen=True)
class Contents:
    """An image, read back."""

    target: Target
    compiler: str
    """What the compiler has written into the file about itself."""
    entry: int
    load_bytes: int
    """What has to get into the chip: code, constants, first values of variables."""
    stack_bytes: int
    sections: list[Section]
    functions: list[Function]
    symbols: dict[str, int]
    """Addresses of those that a debugger or an emulator needs: the board's and the linker's."""

    @property
    def uses(self) -> list[Use]:
        return [
            Use(memory.name, sum(part.bytes for part in self.sections if memory.holds(part.address)), memory.bytes)
            for memory in self.target.memories
        ]


def read(path: Path) -> Contents:
    """LocalError for a file that is no image of this project."""
    with opened(path) as elf:
        target = next((each for each in TARGETS.values() if each.machine == elf["e_machine"]), None)
        symbols = [symbol for table in elf.iter_sections("SHT_SYMTAB") for symbol in table.iter_symbols()]
        addresses = {symbol.name: symbol["st_value"] for symbol in symbols}
        if target is None or MARK not in addresses:
            raise LocalError(f"{path}: not an image of this project: build one with 'host firmware build'")
        return Contents(
            target=target,
            compiler=compiler(elf),
            entry=elf["e_entry"],
            load_bytes=sum(part["p_filesz"] for part in loads(elf)),
            stack_bytes=addresses.get("_stack_top", 0) - addresses.get("_stack_limit", 0),
            sections=[
                Section(part.name, part["sh_addr"], part["sh_size"])
                for part in elf.iter_sections()
                if part["sh_flags"] & SHF_ALLOC and part["sh_size"]
            ],
            functions=functions(symbols),
            symbols={
                name: address
                for name, address in sorted(addresses.items())
                if name.startswith(("board_", "_stack_", "_bss_", "_data_"))
            },
        )


def source_names(symbols: Iterable[str]) -> list[str]:
    """What each is called in the source: gcc puts more behind the name of what it has made another one of,
    f.constprop.0. Where that would give two the name f, all keep theirs: f, f.cold."""
    kept = list(symbols)
    names = [symbol.partition(".")[0] or symbol for symbol in kept]
    claims = Counter(names)
    return [name if claims[name] == 1 else symbol for name, symbol in zip(names, kept, strict=True)]


def functions(symbols: list[Any]) -> list[Function]:
    """One name for each address, the shortest, and the largest function first."""
    found: dict[int, Function] = {}
    code = [symbol for symbol in symbols if symbol["st_info"]["type"] == "STT_FUNC" and symbol["st_size"]]
    for symbol, name in zip(code, source_names(symbol.name for symbol in code), strict=True):
        this = Function(name, symbol["st_value"], symbol["st_size"])
        other = found.get(this.address, this)
        found[this.address] = min(this, other, key=lambda each: (len(each.name), each.name))
    return sorted(found.values(), key=lambda each: (-each.bytes, each.name))


def compiler(elf: Any) -> str:
    """From .comment: one line for each program that has had a hand in it."""
    comment = elf.get_section_by_name(".comment")
    texts = comment.data().split(b"\0") if comment else []
    return ", ".join(dict.fromkeys(text.decode("utf-8", "replace") for text in texts if text)) or "unknown"


def loads(elf: Any) -> list[Any]:
    return [part for part in elf.iter_segments() if part["p_type"] == "PT_LOAD" and part["p_filesz"]]


def write_binary(path: Path) -> None:
    """The bytes from the lowest load address to the highest, beside the ELF file. What lies between is 0xFF, as in
    erased flash."""
    with opened(path) as elf:
        parts = {part["p_paddr"]: part.data() for part in loads(elf)}
    start = min(parts)
    out = bytearray()
    for address, data in sorted(parts.items()):
        out += b"\xff" * (address - start - len(out)) + data
    path.with_suffix(".bin").write_bytes(out)


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """pyelftools' view of a file. LocalError if it is none, or broken."""
    try:
        from elftools.common.exceptions import ELFError, ELFParseError
        from elftools.construct.core import ConstructError
        from elftools.elf.elffile import ELFFile
    except ModuleNotFoundError as error:
        raise LocalError("images are read with pyelftools, which is not installed: pip install pyelftools") from error
    try:
        with path.open("rb") as file:
            yield ELFFile(file)
    except OSError as error:
        raise LocalError(f"{path}: {error.strerror}") from error
    except (ELFError, ELFParseError, ConstructError) as error:
        raise LocalError(f"{path}: not an ELF file, or a damaged one") from error
