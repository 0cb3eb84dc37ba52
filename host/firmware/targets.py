"""The three MCUs: what their code is compiled with, and where it lies."""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.errors import LocalError

KIB = 1024
# More functions stay functions with the last: sizes and faults are told by their names.
WHOLE = ("-flto", "-flto-partition=one", "-fno-inline-functions-called-once")


@dataclass(frozen=True)
class Memory:
    """A range of addresses that an image fills."""

    name: str
    address: int
    bytes: int

    def holds(self, address: int) -> bool:
        return self.address <= address < self.address + self.bytes


@dataclass(frozen=True)
class Target:
    """One MCU."""

    name: str
    part: str
    machine: str
    """e_machine of its ELF files, as pyelftools names it."""
    gcc: str
    """What its GNU tools' names begin with."""
    package: str
    """Debian's, of that compiler."""
    gcc_flags: tuple[str, ...]
    gcc_whole: tuple[str, ...]
    """Makes one program of all files before it makes machine code of it: most calls go."""
    zig_flags: tuple[str, ...]
    """Empty: zig has no code generator for it."""
    memories: tuple[Memory, ...]
    limits: tuple[str, ...]
    """What a user must not believe of the image."""


TARGETS = {
    target.name: target
    for target in (
        Target(
            name="stm32",
            part="STM32F405 (Cortex-M4F) of the Crazyflie 2.1",
            machine="EM_ARM",
            gcc="arm-none-eabi",
            package="gcc-arm-none-eabi",
            gcc_flags=("-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"),
            gcc_whole=WHOLE,
            zig_flags=("-target", "thumb-freestanding-eabihf", "-mcpu=cortex_m4"),
            memories=(Memory("flash", 0x08000000, 1024 * KIB), Memory("RAM", 0x20000000, 128 * KIB)),
            limits=(
                "Time messages, CPX and log alone: no radio, no sensors, no motors. A Crazyflie with it does not fly.",
                "The µSD card is a mailbox of the emulator: on a Crazyflie nothing would be logged.",
                "Run in emulators only, never on a Crazyflie.",
            ),
        ),
        Target(
            name="gap8",
            part="GAP8 (RV32IMC) of the AI-deck 1.1",
            machine="EM_RISCV",
            gcc="riscv64-unknown-elf",
            package="gcc-riscv64-unknown-elf",
            # rv32imc_zicsr would name no multilib of libgcc's.
            gcc_flags=("-march=rv32imc", "-mabi=ilp32", "-misa-spec=2.2"),
            gcc_whole=WHOLE,
            zig_flags=("-target", "riscv32-freestanding-none", "-mcpu=generic_rv32+m+c+zicsr"),
            memories=(Memory("L2", 0x1C000000, 512 * KIB), Memory("FC TCDM", 0x1B000000, 16 * KIB)),
            limits=(
                "Plain RV32IMC on the fabric controller: no PULP extensions, no cluster.",
                "The camera is a mailbox of the emulator, and an SPI window is one transfer instead of the real two: "
                "on an AI-deck it would neither see nor send.",
                "gap8.bin is what belongs into L2. GreenWaves' tools make of it what belongs into the deck's flash.",
                "Run in emulators only, never on an AI-deck.",
            ),
        ),
        Target(
            name="esp32",
            part="ESP32 (Xtensa LX6) of the AI-deck 1.1",
            machine="EM_XTENSA",
            gcc="xtensa-lx106-elf",
            package="gcc-xtensa-lx106",
            gcc_flags=("-mlongcalls",),
            gcc_whole=(),
            zig_flags=(),
            memories=(Memory("IRAM", 0x40080000, 128 * KIB), Memory("DRAM", 0x3FFB0000, 192 * KIB)),
            limits=(
                "Integer code for the call0 ABI, from the ESP8266's compiler: its instructions are in the LX6 by the "
                "manuals, but no ESP32 and no model of one has run them.",
                "Only UART2 has a driver: no Wi-Fi, no TCP, no SPI. In simulations the ESP32's app is native.",
                "Never run, on anything.",
            ),
        ),
    )
}


def target_of(name: str) -> Target:
    """By name. LocalError if there is none."""
    if name not in TARGETS:
        raise LocalError(f"no target {name!r}: one of {', '.join(TARGETS)}")
    return TARGETS[name]
