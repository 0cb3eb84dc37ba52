"""What the images cost, as a table that people can read: tests/emulator/costs.txt.

Sizes are the linker's. What is used of the stack, and how many instructions run, is counted in the emulator. A figure
may differ by SAME from the table's if the compiler is the one that the table names, else by OTHER. When a change is
meant to alter them: python tests/emulator/test_costs.py, and say why in the commit.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from backend import needs

from host.firmware.build import Image, build
from host.firmware.elf import read
from host.native import lib
from sim.world import World

TABLE = Path(__file__).parent / "costs.txt"
BOOT_S = 2
SECONDS = 4
SAME, OTHER = 0.03, 0.25
COLUMNS = [("stm32", "gcc"), ("stm32", "zig"), ("gap8", "gcc"), ("gap8", "zig")]
MCUS = {"stm32": lib.MCU_STM32, "gap8": lib.MCU_GAP8}
CALM: dict[str, Any] = {f"{mcu}_{key}": 0 for mcu in MCUS for key in ("ppm", "walk_ppb", "boot_ms")}
HEAD = f"""\
What the images cost, by MCU and compiler. A time message: to send it (stm32), or to receive it (gap8). A frame: raw,
324 x 244, from its capture to its last byte on SPI. Both are counted over {SECONDS} s, less what runs without them.
Stack: the deepest in that time.

"""


def run(image: Image, **settings: Any) -> tuple[int, int, int]:
    """Instructions and captures in SECONDS, after BOOT_S in which everything boots and connects; stack used."""
    mcu = image.target.name
    with World("hover", images={mcu: image.elf}, **CALM, **settings) as world:
        assert lib.kernel_count_instructions(world.kernel, 0, MCUS[mcu]) == 0
        world.listen(0, "native")
        world.run(BOOT_S)
        before, captured = lib.kernel_instructions(world.kernel, 0, MCUS[mcu]), len(world.truth)
        world.run(SECONDS)
        after = lib.kernel_instructions(world.kernel, 0, MCUS[mcu])
        return after - before, len(world.truth) - captured, world.robots[0].stacks[mcu]


def costs(mcu: str, toolchain: str) -> dict[str, str | int]:
    """A column."""
    image = build(mcu, toolchain)
    contents = read(image.elf)
    silent = {"firmware": "stock"} if mcu == "stm32" else {"uart1_loss": 1.0}
    idle, _, _ = run(image, camera_fps=0, **silent)
    messages, _, _ = run(image, camera_fps=0)
    frames, captured, stack = run(image)
    column: dict[str, str | int] = {
        "compiler": image.toolchain.version.partition(") ")[2] or image.toolchain.version,
        "code and constants, bytes": contents.load_bytes,
        "RAM without the stack, bytes": sum(part.bytes for part in contents.sections if part.name in (".data", ".bss")),
        "stack, bytes": stack,
        "instructions of a time message": round((messages - idle) / (100 * SECONDS)),
    }
    if mcu == "gap8":
        column["instructions of a frame"] = round((frames - messages) / captured)
    return column


def table() -> str:
    columns = {f"{mcu} {toolchain}": costs(mcu, toolchain) for mcu, toolchain in COLUMNS}
    names = list(dict.fromkeys(name for column in columns.values() for name in column))
    lines = [f"{'':32}" + "".join(f"{title:>18}" for title in columns)]
    lines += [f"{name:32}" + "".join(f"{column.get(name, '-'):>18}" for column in columns.values()) for name in names]
    return HEAD + "\n".join(lines) + "\n"


def kept() -> dict[str, dict[str, str]]:
    """The table's columns."""
    lines = TABLE.read_text(encoding="utf-8").removeprefix(HEAD).splitlines()
    cells = {line[:32].strip(): [line[at : at + 18].strip() for at in range(32, 104, 18)] for line in lines}
    titles = cells.pop("")
    return {title: {name: row[at] for name, row in cells.items()} for at, title in enumerate(titles)}


@pytest.mark.parametrize(("mcu", "toolchain"), COLUMNS)
def test_costs(mcu: str, toolchain: str) -> None:
    needs(toolchain)
    was, now = kept()[f"{mcu} {toolchain}"], costs(mcu, toolchain)
    tolerance = SAME if was["compiler"] == now["compiler"] else OTHER
    grown = [
        f"{name}: {was[name]} in the table, now {value}"
        for name, value in now.items()
        if isinstance(value, int) and abs(value - int(was[name])) > tolerance * int(was[name])
    ]
    assert not grown, f"{grown}\nIf that is meant: python tests/emulator/{Path(__file__).name} writes the table anew."


def test_counting_changes_nothing() -> None:
    needs()
    image = build("gap8")
    hashes = []
    for count in (False, True):
        with World("hover", images={"gap8": image.elf}, trace="hash", camera_width=64, camera_height=48) as world:
            if count:
                assert lib.kernel_count_instructions(world.kernel, 0, lib.MCU_GAP8) == 0
            assert lib.kernel_count_instructions(world.kernel, 0, lib.MCU_STM32) == lib.KERNEL_ERR_CONFIG
            world.listen()
            world.run(2)
            hashes.append(world.trace_hash())
            assert (lib.kernel_instructions(world.kernel, 0, lib.MCU_GAP8) > 100_000) is count
    assert hashes[0] == hashes[1]


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
    print(TABLE.read_text(encoding="utf-8"), end="")
