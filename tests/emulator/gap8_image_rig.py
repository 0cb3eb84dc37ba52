"""Tiny GAP8 images for the emulator: compiled here, and called as the kernel calls an image, without a kernel."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from arm_rig import NEVER_US, Mcu

from host.native import ffi, lib
from sim import images

UART1, SPI, CAMERA = 0, 1, 2

LINKER = """
ENTRY(start)
SECTIONS {
    . = 0x1C000000;
    .vectors : { KEEP(*(.vectors)) }
    .text : { *(.text*) *(.rodata* .srodata*) *(.board_config) }
    .data : ALIGN(4096) { *(.data* .sdata*) }
    .bss (NOLOAD) : { __bss_start = .; *(.bss* .sbss*) *(COMMON) . = ALIGN(4); _end = .; }
    _stack_limit = 0x1B000000;
    _stack_top = 0x1B002000;
}
"""

HEADER = """
#include <stdint.h>
#define R(address) (*(volatile uint32_t *)(address))
#define HANDLER __attribute__((interrupt("machine"), used))
enum { TIMER = 0x00200400, CFG = 0, VALUE = 8, COMPARE = 16, RESET = 32 }; /* + 4: the high one */
enum { IRQ_MASK = 0x0020400C, IRQ_MASK_OR = 0x00204014, CLEAR = 0x00204028, POP = 0x00200F00 };
enum { SOC_MASK_HIGH = 0x1A106004, SOC_MASK_LOW = 0x1A106008 };
enum { UART_RX = 0x1A102200, UART_SETUP = 0x1A102224, SPI_RX = 0x1A102100, SPI_TX = 0x1A102110 };
enum { GPIO = 0x1A101000, CAMERA = 0x1A170000 };
const volatile uint32_t board_config __attribute__((section(".board_config"))) = 0;
volatile uint64_t board_stamp_reset;
volatile int board_init_result;
volatile uint32_t board_app[64], seen[64];
volatile uint8_t in[8192], out[8192];
int main(void);
static inline void wfi(void) { __asm volatile("wfi" ::: "memory"); }
static inline void on(void) { __asm volatile("csrsi mstatus, 8" ::: "memory"); }
static inline void off(void) { __asm volatile("csrci mstatus, 8" ::: "memory"); }
static inline uint32_t mstatus(void) { uint32_t v; __asm volatile("csrr %0, mstatus" : "=r"(v)); return v; }
static inline uint32_t mcause(void) { uint32_t v; __asm volatile("csrr %0, mcause" : "=r"(v)); return v; }
static inline void dma(uint32_t channel, volatile void *at, uint32_t size) {
    R(channel) = (uint32_t)at; R(channel + 4) = size; R(channel + 8) = 1 << 4;
}
__asm(".section .vectors, \\"ax\\"\\n.option norvc\\nvectors:\\n"
      "j line0\\n.rept 9\\nj trap\\n.endr\\nj line10\\nj line11\\n.rept 8\\nj trap\\n.endr\\nj line20\\n"
      ".rept 6\\nj trap\\n.endr\\nj line27\\n.rept 4\\nj trap\\n.endr\\n"
      ".globl start\\nstart: la sp, _stack_top\\nla t0, vectors\\ncsrw mtvec, t0\\n"
      "la t0, __bss_start\\nla t1, _end\\n1: sw zero, 0(t0)\\naddi t0, t0, 4\\nbltu t0, t1, 1b\\ncall main\\n"
      ".globl trap\\ntrap: ebreak\\n.previous\\n");
void trap(void);
#line 1 "image.c"
"""


@cache
def compiler() -> list[str]:
    """The command that compiles for an RV32IMC; skips the test when there is none."""
    if shutil.which("riscv64-unknown-elf-gcc"):
        return ["riscv64-unknown-elf-gcc", "-march=rv32imc", "-mabi=ilp32", "-misa-spec=2.2", "-nostdlib",
                "-nostartfiles", "-mno-relax", "-Wl,--no-warn-rwx-segments"]  # fmt: skip
    try:
        import ziglang  # noqa: F401  only to know whether it is there

        return [sys.executable, "-m", "ziglang", "cc", "-target", "riscv32-freestanding-none",
                "-mcpu=generic_rv32+m+c+zicsr", "-mno-relax"]  # fmt: skip
    except ImportError:
        pytest.skip("no compiler for RV32IMC: apt-get install gcc-riscv64-unknown-elf, or pip install ziglang")


def build(folder: Path, source: str) -> images.Image:
    """`source` has main, and handlers called line0, line10, line11, line20 and line27; those it lacks are traps."""
    missing = "".join(
        f'void line{n}(void);\n__asm(".globl line{n}\\nline{n}: j trap");\n'
        for n in (0, 10, 11, 20, 27)
        if f"line{n}(" not in source
    )
    (folder / "image.c").write_text(HEADER.replace("int main(void);", missing + "int main(void);") + source)
    (folder / "image.ld").write_text(LINKER)
    subprocess.run(
        [*compiler(), "-std=gnu11", "-O2", "-g", "-ffreestanding", f"-Wl,-T,{folder / 'image.ld'}",
         "-Wl,--build-id=none", "-o", str(folder / "image.elf"), str(folder / "image.c")],
        check=True,
    )  # fmt: skip
    return images.load(folder / "image.elf")


class Gap8(Mcu):
    """As Mcu, with SPI's windows."""

    def transmit(self, port: int) -> bytes:
        out = ffi.new("uint8_t[4092]")
        count = lib.emulator_transmit(self.pointer, port, {"data": out, "size": len(out)}, self.ns)
        return bytes(ffi.buffer(out, count))

    def bytes_of(self, name: str, size: int) -> bytes:
        return bytes(ffi.buffer(lib.emulator_memory(self.pointer, self.image.symbols[name][0], size), size))


__all__ = ["CAMERA", "NEVER_US", "SPI", "UART1", "Gap8", "build"]
