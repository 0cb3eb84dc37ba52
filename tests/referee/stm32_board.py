"""The STM32's image on QEMU's netduinoplus2: its two UARTs, for the bytes that come in on UART2 at given uptimes."""

import functools
import os
import selectors
import socket
import struct
import subprocess
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import machines

from host.firmware.build import FLAGS, SOURCES
from host.firmware.targets import target_of
from host.firmware.toolchains import find
from host.native import ffi

HERE = Path(__file__).resolve().parent
SILENCE_S = 20
REPLACED = "alarm.c"
INPUT_WANTED, NOT_TAKEN, ENDED = b"I", b"N", b"E"


@dataclass(frozen=True)
class Inputs:
    """What comes in on UART2, and when the run ends; all uptimes of the STM32."""

    bytes: tuple[tuple[int, int], ...]
    """(us, byte), ascending."""
    end_us: int


@dataclass(frozen=True)
class Streams:
    uart1: bytes
    uart2: bytes


def board_config(app: Any, stamp_start_us: int = 0, stamp_bits: int = 0, stamp_divider: int = 85) -> bytes:
    """stm32_board_config_t of firmware/stm32/board/config.h."""
    settings = bytes(ffi.buffer(ffi.addressof(app)))
    whole = settings + bytes(-len(settings) % 8)
    return whole + struct.pack("<QBB6x", stamp_start_us, stamp_bits, stamp_divider)


@functools.cache
def objects(folder: Path) -> tuple[Path, ...]:
    compiler = find(target_of("stm32"), "gcc")
    board = [path for path in sorted(SOURCES.glob("stm32/board/*.c")) if path.name != REPLACED]
    sources = [*board, *(path for each in ("core", "stm32", "board") for path in sorted(SOURCES.glob(f"{each}/*.c")))]
    options = (*compiler.compile, *FLAGS, "-Werror", f"-I{SOURCES / 'board'}")

    def compiled(source: Path) -> Path:
        made = folder / f"{source.parent.name}-{source.stem}.o"
        subprocess.run([*options, "-c", source, "-o", made], check=True)
        return made

    with ThreadPoolExecutor(os.cpu_count()) as threads:
        return tuple(threads.map(compiled, [*sources, HERE / "netduinoplus2/alarm.c"]))


def link(config: bytes, inputs: Inputs, folder: Path) -> Path:
    """The image with this configuration, and what asks for these inputs."""
    compiler = find(target_of("stm32"), "gcc")
    instants = [at_us for at_us, _ in inputs.bytes] + [inputs.end_us]
    (folder / "inputs.bin").write_bytes(struct.pack(f"<{len(instants)}I", *instants))
    (folder / "config.bin").write_bytes(config)
    image = folder / "stm32.elf"
    options = [*compiler.compile, "-nostartfiles", "-Wl,--gc-sections", "-Wl,--wrap=usart_init"]
    inputs_bin = f'-DINPUTS="{folder / "inputs.bin"}"'
    files: list[str | Path] = [inputs_bin, HERE / "netduinoplus2/inputs.S", *objects(folder.parent)]
    script = f"-Wl,-T,{SOURCES / 'stm32/board/stm32f405.ld'}"
    subprocess.run([*options, script, *files, "-o", image, *compiler.link], check=True)
    objcopy = compiler.compile[0].removesuffix("gcc") + "objcopy"
    subprocess.run([objcopy, "--update-section", f".board_config={folder / 'config.bin'}", image], check=True)
    return image


QEMU = (
    *("qemu-system-arm", "-M", "netduinoplus2", "-icount", "shift=0,sleep=off"),
    *("-display", "none", "-monitor", "none"),
)


def run(image: Path, inputs: Inputs) -> Streams:
    """What it sends until the end of the run; all that has come when it stops before."""
    command = [*QEMU, "-kernel", str(image)]
    ours, theirs = zip(*(socket.socketpair() for _ in range(3)), strict=True)
    for number, end in enumerate(theirs):
        command += ["-chardev", f"socket,id=u{number},fd={end.fileno()}", "-serial", f"chardev:u{number}"]
    fds = [end.fileno() for end in theirs]
    with subprocess.Popen(command, pass_fds=fds, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as qemu:
        try:
            return converse(ours, bytes(byte for _, byte in inputs.bytes))
        finally:
            qemu.kill()
            for end in (*ours, *theirs):
                end.close()


def converse(uarts: tuple[socket.socket, ...], given: bytes) -> Streams:
    """USART1 asks for the bytes of USART2 (its wire UART2), and says when all is over; USART3 is wire UART1."""
    got = [bytearray(), bytearray(), bytearray()]
    with selectors.DefaultSelector() as selector:
        for number, uart in enumerate(uarts):
            selector.register(uart, selectors.EVENT_READ, number)
        sent, ended = 0, False
        while ready := selector.select(0 if ended else SILENCE_S):
            for key, _ in ready:
                number = key.data
                more = uarts[number].recv(1 << 16)
                got[number] += more
                if not more:
                    selector.unregister(uarts[number])
                elif number == 0 and more.endswith(INPUT_WANTED):
                    uarts[1].sendall(given[sent : sent + 1])
                    sent += 1
                ended = ended or got[0].endswith(ENDED)
    assert NOT_TAKEN not in got[0], "an input came before the board had taken the one before: space them out"
    return Streams(bytes(got[2]), bytes(got[1]))


def run_plain(image: Path, size: int) -> bytes:
    """The first bytes on wire UART1 of an image that asks for nothing."""
    command = [*QEMU, "-kernel", str(image), "-serial", "null", "-serial", "null", "-serial", "stdio"]
    return machines.first_bytes(command, size)
