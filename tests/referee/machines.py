"""QEMU's machines that replay a recording: one for each MCU, with its instruction set and nothing else of it."""

import functools
import os
import select
import shutil
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from host.firmware.build import FLAGS, SOURCES
from host.firmware.targets import target_of
from host.firmware.toolchains import find
from host.protocol.errors import LocalError

HERE = Path(__file__).resolve().parent
SILENCE_S = 20
"""Nothing for so long: the machine has stopped. It writes some 100 kB a second, even on a busy computer."""


@dataclass(frozen=True)
class Machine:
    mcu: str
    folder: str
    """Below this one: start-up code, UART and linker script."""
    command: tuple[str, ...]
    sources: tuple[str, ...] = ()
    """Of the firmware, beside core and the app: what the compiler's own library lacks."""


MACHINES = {
    machine.mcu: machine
    for machine in (
        Machine("stm32", "mps2", ("qemu-system-arm", "-M", "mps2-an386")),
        Machine("gap8", "virt", ("qemu-system-riscv32", "-M", "virt", "-bios", "none")),
        Machine(
            "esp32",
            "kc705",
            ("qemu-system-xtensa", "-M", "kc705-nommu", "-cpu", "lx106"),
            ("esp32/board/arithmetic.c",),
        ),
    )
}


def missing(mcu: str) -> str | None:
    """Why this MCU's recordings cannot be replayed here, or None."""
    program = MACHINES[mcu].command[0]
    try:
        find(target_of(mcu), "gcc")
    except LocalError as error:
        return str(error)
    return None if shutil.which(program) else f"no {program}: tests/referee/install.sh installs it"


@functools.cache
def objects(mcu: str, folder: Path) -> tuple[Path, ...]:
    """The app and what replays it, compiled as `host firmware build` compiles the app."""
    machine = MACHINES[mcu]
    compiler = find(target_of(mcu), "gcc")
    sources = [
        *sorted(SOURCES.glob("core/*.c")),
        *sorted(SOURCES.glob(f"{mcu}/*.c")),
        SOURCES / "board/memory.c",
        *(SOURCES / name for name in machine.sources),
        HERE / "replay.c",
        *sorted((HERE / machine.folder).glob("*.[cS]")),
    ]
    options = (*compiler.compile, *FLAGS, "-Werror", f"-DAPP_{mcu.upper()}", f"-I{SOURCES / 'board'}")

    def compiled(source: Path) -> Path:
        made = folder / f"{mcu}-{source.parent.name}-{source.stem}.o"
        subprocess.run([*options, "-c", source, "-o", made], check=True)
        return made

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return tuple(threads.map(compiled, sources))


def link(mcu: str, recording: bytes, folder: Path) -> Path:
    """The image that replays this recording."""
    compiler = find(target_of(mcu), "gcc")
    (folder / "recording.bin").write_bytes(recording)
    image = folder / f"{mcu}.elf"
    options = [*compiler.compile, f'-DRECORDING="{folder / "recording.bin"}"', "-nostartfiles", "-Wl,--gc-sections"]
    script = HERE / MACHINES[mcu].folder / "link.ld"
    files = [HERE / "recording.S", *objects(mcu, folder.parent)]
    subprocess.run(
        [*options, "-Wl,--no-warn-rwx-segments", f"-Wl,-T,{script}", *files, "-o", image, *compiler.link], check=True
    )
    return image


def first_difference(got: bytes, expected: bytes) -> tuple[int, str] | None:
    """Its offset, and both values; None when there is none."""
    if got == expected:
        return None
    pairs = enumerate(zip(got, expected, strict=False))
    offset = next((i for i, (a, b) in pairs if a != b), min(len(got), len(expected)))
    here, there = (f"{each[offset]:#04x}" if offset < len(each) else "no more" for each in (got, expected))
    return offset, f"byte {offset} of {len(expected)}: QEMU {here}, simulator {there}"


def run(mcu: str, image: Path, size: int) -> bytes:
    """What it writes: `size` bytes, or what has come when it stops before."""
    options = ("-display", "none", "-monitor", "none", "-serial", "stdio", "-kernel", str(image))
    return first_bytes([*MACHINES[mcu].command, *options], size)


def first_bytes(command: list[str], size: int) -> bytes:
    """Of what it writes: `size`, or what has come when it stops before."""
    with subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as qemu:
        assert qemu.stdout is not None
        try:
            return read(qemu.stdout, size)
        finally:
            qemu.kill()


def read(pipe: IO[bytes], size: int) -> bytes:
    got = bytearray()
    while len(got) < size and select.select([pipe], [], [], SILENCE_S)[0]:
        more = os.read(pipe.fileno(), 1 << 16)
        if not more:
            break
        got += more
    return bytes(got)
