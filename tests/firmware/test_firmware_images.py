"""Images of all targets from all compilers: they link, are reproducible, and hold what they have to."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest
from cross_compilers import PAIRS, needs

from host.firmware import build as building
from host.firmware.build import build, key, sources_of, store
from host.firmware.elf import read, source_names
from host.firmware.targets import TARGETS
from host.firmware.toolchains import find

STAY = {
    "stm32": ("service", "stm32_init", "stm32_receive", "stm32_transmit", "stm32_deadline"),
    "gap8": ("service",),
}
"""Functions that are not inlined, so that sizes and faults are told by their names."""
pairs = pytest.mark.parametrize(("target", "toolchain"), PAIRS)


@pairs
def test_links_without_a_warning_and_fits(target: str, toolchain: str) -> None:
    needs(target, toolchain)
    image = build(target, toolchain)
    contents = read(image.elf)
    assert image.warnings == ""
    assert contents.target.name == target
    assert contents.compiler.startswith({"gcc": "GCC: ", "zig": "clang"}[toolchain])
    assert contents.stack_bytes == (16384 if target == "gap8" else 8192)
    assert all(0 < use.bytes <= use.of_bytes for use in contents.uses)
    assert {"board_config", "board_init_result", "board_app", "_stack_top", "_stack_limit"} <= set(contents.symbols)
    names = {function.name for function in contents.functions}
    assert {"main", *STAY.get(target, ())} <= names
    placed = [memory for part in contents.sections for memory in TARGETS[target].memories if memory.holds(part.address)]
    assert len(placed) == len(contents.sections), "a section lies in no memory of the chip"


def test_a_name_of_the_source_is_that_of_one_symbol() -> None:
    symbols = [
        "f",
        "f.part.0",
        "g.constprop.0.isra.0",
        "h.cold",
        "h",
        "out.lto_priv.0",
        "out.lto_priv.1",
        "in",
        "in",
        ".L1",
    ]
    assert source_names(symbols) == ["f", "f.part.0", "g", "h.cold", "h", *symbols[5:]]


@pytest.mark.parametrize(("target", "toolchain"), [("stm32", "gcc"), ("gap8", "gcc"), ("gap8", "zig")])
def test_equal_bytes_whatever_the_folders_are_called(
    target: str, toolchain: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    needs(target, toolchain)
    first = build(target, toolchain)
    elsewhere = tmp_path / "with spaces and ünicode" / "firmware"
    shutil.copytree(building.SOURCES, elsewhere)
    monkeypatch.setattr(building, "SOURCES", elsewhere)
    compiler = find(TARGETS[target], toolchain)
    sources = sources_of(TARGETS[target])
    folder = elsewhere.parent / "second"
    store(TARGETS[target], compiler, (), sources, folder)
    assert key(TARGETS[target], compiler, (), sources) in first.folder.name
    for path in first.files:
        assert ((folder / path.name).read_bytes() == path.read_bytes()) is True, path.name
    assert str(tmp_path).encode() not in first.elf.read_bytes() + (folder / first.elf.name).read_bytes()
    if toolchain == "gcc":  # zig's own library says where zig lies
        assert bytes(Path.home()) + b"/" not in first.elf.read_bytes()


@pytest.mark.parametrize("target", ["stm32", "gap8"])
def test_binary_and_sizes_are_what_other_tools_say(target: str, tmp_path: Path) -> None:
    needs(target, "gcc")
    image = build(target, "gcc")
    tools = TARGETS[target].gcc
    other = tmp_path / "other.bin"
    subprocess.run([f"{tools}-objcopy", "-O", "binary", image.elf, other], check=True)
    assert image.binary is not None
    assert (image.binary.read_bytes() == other.read_bytes()) is True

    contents = read(image.elf)
    listed = subprocess.run([f"{tools}-size", "-A", image.elf], capture_output=True, text=True, check=True).stdout
    sizes = {
        words[0]: int(words[1]) for words in map(str.split, listed.splitlines()) if words[-1:] and words[-1].isdecimal()
    }
    assert {part.name: part.bytes for part in contents.sections} == {
        part.name: sizes[part.name] for part in contents.sections
    }
    listed = subprocess.run([f"{tools}-nm", "-S", image.elf], capture_output=True, text=True, check=True).stdout
    words = [line.split() for line in listed.splitlines()]
    code = {each[0]: int(each[1], 16) for each in words if len(each) == 4 and each[2] in "tTwW"}
    assert {f"{each.address & ~1:08x}": each.bytes for each in contents.functions} == code


def test_the_stm32_starts_where_its_vector_table_says() -> None:
    needs("stm32", "gcc")
    image = build("stm32", "gcc")
    symbols = read(image.elf).symbols
    assert image.binary is not None
    words = memoryview(image.binary.read_bytes()[: 4 * (16 + 82)]).cast("I")
    assert words[:2].tolist() == [symbols["_stack_top"], symbols["board_reset"]]
    assert words[1] & 1, "Thumb"
    handled = {16 + 6, 16 + 29, 16 + 38, 16 + 39, 16 + 49}
    traps = {number for number, word in enumerate(words) if word == symbols["board_trap"]}
    assert traps == set(range(2, len(words))) - handled
    assert len({words[number] for number in handled}) == 5


def test_a_gcc_without_lto_builds_each_file_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs("gap8", "gcc")
    name = f"{TARGETS['gap8'].gcc}-gcc"
    gcc = tmp_path / name
    gcc.write_text(
        f'#!/bin/sh\ncase " $* " in *" -flto "*) echo "LTO support has not been enabled" >&2; exit 1;; esac\n'
        f'exec {shutil.which(name)} "$@"\n'
    )
    gcc.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    image = build("gap8", "gcc")
    assert "built without LTO" in image.toolchain.version
    assert {"service", "gap8_receive", "gap8_transmit"} <= {each.name for each in read(image.elf).functions}


def test_the_stamp_divider_is_a_build_option() -> None:
    needs("stm32", "gcc")
    config = {}
    for divider, defines in (("84", {"STM32_STAMP_DIVIDER": "84"}), ("85", {})):
        image = build("stm32", "gcc", defines)
        assert image.binary is not None
        at = read(image.elf).symbols["board_config"] - TARGETS["stm32"].memories[0].address
        config[divider] = image.binary.read_bytes()[at : at + 176]
    assert (config["84"][169], config["85"][169]) == (84, 85)
    assert config["84"][:153] == config["85"][:153]


def test_a_change_of_a_source_is_another_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    needs("stm32", "gcc")
    target = TARGETS["stm32"]
    compiler = find(target, "gcc")
    before = key(target, compiler, (), sources_of(target))
    changed = tmp_path / "firmware"
    shutil.copytree(building.SOURCES, changed)
    monkeypatch.setattr(building, "SOURCES", changed)
    assert key(target, compiler, (), sources_of(target)) == before
    header = changed / "core" / "stamp.h"
    header.write_bytes(header.read_bytes() + b"\n")
    assert key(target, compiler, (), sources_of(target)) != before


@pytest.mark.parametrize("target", TARGETS)
def test_the_readme_says_how_large_they_are(target: str) -> None:
    """In KiB, to within a twentieth: a compiler of another version makes them a little different."""
    needs(target, "gcc")
    readme = (Path(building.__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
    row = re.search(rf"^\| {target} \| (\d+) KiB \| (\d+) KiB", readme, re.MULTILINE)
    assert row, f"no row of the {target} in the README's table"
    contents = read(build(target, "gcc").elf)
    ram = sum(part.bytes for part in contents.sections if part.name in (".stack", ".bss"))
    for said, measured in zip(row.groups(), (contents.load_bytes, ram), strict=True):
        assert abs(int(said) - measured / 1024) < max(0.6, measured / 1024 / 20), f"{said} KiB, measured {measured}"
