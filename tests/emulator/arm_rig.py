"""Tiny STM32 images for the emulator: compiled here, and called as the kernel calls an image, without a kernel."""

from __future__ import annotations

import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("unicorn", reason="Unicorn is not installed: pip install 'spindeck[emulator]'")
pytest.importorskip("elftools", reason="pyelftools is not installed: pip install 'spindeck[emulator]'")

from host.firmware import toolchains
from host.firmware.targets import target_of
from host.native import ffi, lib
from sim import images, unicorn

NEVER_US = 2**64 - 1
UART1, UART2 = 0, 1

HANDLERS = ["svc", "pendsv", "systick", "exti0", "irq1", "irq2", "irq3", "tim2", "tim3", "tim5", "usart2", "usart3"]

LINKER = """
ENTRY(reset)
SECTIONS {
    . = 0x08000000;
    .text : { KEEP(*(.vectors)) *(.text*) *(.rodata*) *(.board_config) }
    .data : { *(.data*) }
    ASSERT(SIZEOF(.data) == 0, "nobody copies initialised data into RAM here")
    .bss 0x20000000 (NOLOAD) : { *(.bss*) *(COMMON) }
    _stack_limit = 0x20010000;
    _stack_top = 0x20018000;
}
""" + "".join(f"PROVIDE({name} = trap);\n" for name in HANDLERS)

HEADER = """
#include <stdint.h>
#define R(address) (*(volatile uint32_t *)(address))
#define B(address) (*(volatile uint8_t *)(address))
#define ICSR R(0xE000ED04)
#define ISER(i) R(0xE000E100 + 4 * (i))
#define ISPR(i) R(0xE000E200 + 4 * (i))
#define IPR(irq) B(0xE000E400 + (irq))
enum { TIM2 = 0x40000000, TIM3 = 0x40000400, TIM5 = 0x40000C00, USART2 = 0x40004400, USART3 = 0x40004800 };
enum { SR = 0, DR = 4, BRR = 8, CR1 = 12, TIM_CR1 = 0, DIER = 12, TIM_SR = 16, EGR = 20, CNT = 36, PSC = 40, ARR = 44 };
extern uint32_t _stack_top[];
const volatile uint32_t board_config __attribute__((section(".board_config"))) = 0;
volatile uint64_t board_stamp_reset;
volatile int board_init_result;
volatile uint32_t board_app[64];
int main(void);
static inline void wfi(void) { __asm volatile("wfi" ::: "memory"); }
static inline void clocks(void) { /* 168 MHz from 8 MHz; every peripheral of APB1 */
    R(0x40023800) |= 1 << 16 | 1 << 24;
    R(0x40023804) = 8 | 336 << 6 | 1 << 22 | 7 << 24;
    R(0x40023808) = 2 | 5 << 10 | 4 << 13;
    R(0x40023840) = ~0u;
}
void trap(void) { __asm volatile("bkpt 0"); }
void reset(void) {
    for (volatile uint32_t *at = (uint32_t *)0x20000000; at < (uint32_t *)0x20002000; at++) {
        *at = 0;
    }
    R(0xE000ED88) |= 0xF << 20;
    __asm volatile("dsb; isb");
    main();
    trap();
}
void svc(void), pendsv(void), systick(void), exti0(void), irq1(void), irq2(void), irq3(void);
void tim2(void), tim3(void), tim5(void), usart2(void), usart3(void);
__attribute__((section(".vectors"), used)) void *const vectors[98] = {
    _stack_top, reset, trap, trap, trap, trap, trap, 0, 0, 0, 0, svc, trap, 0, pendsv, systick,
    [16 + 1] = irq1, [16 + 2] = irq2, [16 + 3] = irq3, [16 + 6] = exti0, [16 + 28] = tim2, [16 + 29] = tim3,
    [16 + 50] = tim5, [16 + 38] = usart2, [16 + 39] = usart3};
#line 1 "image.c"
"""


@cache
def compiler() -> toolchains.Toolchain:
    """GNU's for a Cortex-M4F, in whose assembly the images are written; skips the test when it is not installed."""
    try:
        return toolchains.find(target_of("stm32"), "gcc")
    except toolchains.MissingError as error:
        pytest.skip(str(error))


def build(folder: Path, source: str, header: str = HEADER) -> images.Image:
    (folder / "image.c").write_text(header + source)
    (folder / "image.ld").write_text(LINKER)
    own = compiler()
    subprocess.run(
        [*own.compile, "-std=gnu11", "-O2", "-g", "-ffreestanding", "-ffp-contract=off", "-nostartfiles",
         f"-Wl,-T,{folder / 'image.ld'}", "-o", str(folder / "image.elf"), str(folder / "image.c"),
         *own.link],
        check=True,
    )  # fmt: skip
    return images.load(folder / "image.elf")


class Mcu:
    """An image under the emulator; `ns` is its local time, which the caller moves."""

    def __init__(self, image: images.Image, config: int = 0) -> None:
        self.image = image
        self.ns = 0
        self.report = ffi.new("emulator_report_t *")
        self.pointer = ffi.gc(lib.emulator_new(unicorn.table(), image.pointer, 0, self.report), lib.emulator_free)
        self.result = 0 if self.failed else self.power_up(config)

    def power_up(self, config: int = 0) -> int:
        own = ffi.from_buffer("uint8_t[]", config.to_bytes(4, "little"))
        return int(lib.emulator_power_up(self.pointer, {"data": own, "size": 4}, self.ns))

    @property
    def failed(self) -> str:
        """Why the run is over, with symbols; empty while it is not."""
        text = ffi.string(self.report.text).decode()
        return self.image.explain(text) if self.report.failed else ""

    def receive(self, port: int, data: bytes) -> None:
        own = ffi.from_buffer("uint8_t[]", data)
        lib.emulator_receive(self.pointer, port, {"data": own, "size": len(data)}, self.ns)

    def transmit(self, port: int) -> bytes:
        out = ffi.new("uint8_t[8]")
        count = lib.emulator_transmit(self.pointer, port, {"data": out, "size": 8}, self.ns)
        return bytes(out[0:count])

    def deadline(self) -> int:
        return int(lib.emulator_deadline(self.pointer, self.ns))

    def byte_ps(self, port: int) -> int:
        return int(lib.emulator_byte_ps(self.pointer, port))

    def set_wire(self, port: int, byte_ps: int) -> None:
        lib.emulator_set_wire(self.pointer, port, byte_ps)

    def reset_stamp(self, to_us: int) -> None:
        lib.emulator_reset_stamp(self.pointer, to_us, self.ns)

    def words(self, name: str, count: int = 1) -> list[int]:
        """Of the image's memory, from a symbol on."""
        data = lib.emulator_memory(self.pointer, self.image.symbols[name][0], 4 * count)
        return list(memoryview(ffi.buffer(data, 4 * count)).cast("I"))

    def word(self, name: str) -> int:
        return self.words(name)[0]


def step(mcu: Mcu, until_ns: int) -> None:
    """Lets the alarms go off until then, each at the first nanosecond of its microsecond."""
    while (due_us := mcu.deadline()) * 1000 <= until_ns and not mcu.failed:
        mcu.ns = max(mcu.ns, due_us * 1000)
    mcu.ns = until_ns


__all__: list[Any] = ["NEVER_US", "UART1", "UART2", "Mcu", "build", "step"]
