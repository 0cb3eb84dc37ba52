"""The RV32 CPU of the GAP8's model: sleep, vectored interrupts, and what ends a run."""

import re
from pathlib import Path

import pytest
from gap8_image_rig import SPI, UART1, Gap8, build

LISTEN = """
static void listen(void) {
    R(UART_SETUP) = 1 << 9;
    R(SOC_MASK_LOW) &= ~(1u << 8);
    dma(UART_RX, in, 1);
    R(IRQ_MASK_OR) = 1u << 27;
}
static uint32_t taken(void) {
    uint32_t event = R(POP);
    R(CLEAR) = 1u << 27;
    dma(UART_RX, in, 1);
    return event;
}
"""


def test_boots_from_its_entry_with_ram_that_is_not_zero(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, """
        volatile uint32_t kept __attribute__((section(".data"))) = 7;
        int main(void) {
            seen[0] = R(0x1C070000); seen[1] = kept++; board_init_result = -3;
            for (;;) wfi();
        }
    """))  # fmt: skip
    assert not mcu.failed
    assert (mcu.result, mcu.words("seen", 2)) == (-3, [0xA5A5A5A5, 7])
    mcu.power_up()
    assert mcu.words("seen", 2) == [0xA5A5A5A5, 7]


def test_an_interrupt_enters_at_its_vector_and_returns_to_where_the_code_slept(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, LISTEN + """
        HANDLER void line27(void) { seen[0] = mcause(); seen[1] = mstatus() & 8; seen[2] = taken(); seen[3]++; }
        int main(void) {
            register uint32_t kept __asm("s3") = 0x1234, spoilt __asm("a3") = 0x5678;
            listen();
            on();
            for (;;) {
                __asm volatile("wfi" : "+r"(kept), "+r"(spoilt));
                seen[4]++; seen[5] = kept; seen[6] = spoilt; seen[7] = mstatus() & 8;
            }
        }
    """))  # fmt: skip
    mcu.receive(UART1, b"x")
    # The handler at once, the main program when it is asked.
    assert mcu.words("seen", 8) == [0x8000001B, 0, 0x80000008, 1, 0, 0, 0, 0]
    mcu.transmit(UART1)
    assert mcu.words("seen", 8) == [0x8000001B, 0, 0x80000008, 1, 1, 0x1234, 0x5678, 8]
    mcu.receive(UART1, b"yz")
    mcu.deadline()
    assert mcu.words("seen", 5)[3:] == [3, 2]
    assert mcu.transmit(UART1) == b""
    assert mcu.words("seen", 5)[4] == 2, "woken by nothing"


def test_a_masked_interrupt_ends_wfi_and_the_mask_stays(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, LISTEN + """
        HANDLER void line27(void) { taken(); seen[0]++; seen[1] = mstatus() & 8; }
        int main(void) {
            listen();
            for (;;) { off(); wfi(); seen[2] = mstatus() & 8; on(); seen[3] = mstatus() & 8; seen[4] = seen[0]; }
        }
    """))  # fmt: skip
    for count in (1, 2, 3):
        mcu.receive(UART1, b"x")
        mcu.deadline()
        assert mcu.words("seen", 5) == [count, 0, 0, 8, count]
    assert not mcu.failed


def test_lines_that_are_up_are_taken_one_after_the_other(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, """
        static uint32_t count;
        HANDLER void line10(void) { R(CLEAR) = 1u << 10; seen[count++] = 10; }
        HANDLER void line11(void) { R(CLEAR) = 1u << 11; seen[count++] = 11; }
        int main(void) {
            R(IRQ_MASK_OR) = 3u << 10;
            R(TIMER + COMPARE) = 100; R(TIMER + COMPARE + 4) = 100;
            R(TIMER + CFG) = 1 | 4 | 64 | 49 << 8; R(TIMER + CFG + 4) = 1 | 4 | 64 | 49 << 8;
            for (;;) wfi();
        }
    """))  # fmt: skip
    assert mcu.deadline() == 100
    mcu.ns = 100_000
    mcu.deadline()
    assert mcu.words("seen", 3) == [10, 11, 0]


@pytest.mark.parametrize(
    ("code", "said"),
    [
        ("trap();", "breakpoint; pc=0x[0-9a-f]{8} \\(trap\\)"),
        ('__asm volatile(".word 0");', "illegal instruction; pc=0x[0-9a-f]{8} \\(bad"),
        ('__asm volatile("fadd.s f0, f1, f2");', "illegal instruction; pc=0x[0-9a-f]{8} \\(bad"),
        ('__asm volatile("ecall");', "environment call; pc=0x[0-9a-f]{8} \\(bad"),
        ("seen[0] = R(0x30000000);", "read where nothing is: 4 bytes at 0x30000000; pc=0x[0-9a-f]{8} \\(bad"),
        ("*(volatile uint8_t *)0x40000001 = 1;", "write where nothing is: 1 bytes at 0x40000001; pc="),
        ("R(0x1A000000) = 1;", "write to ROM: 4 bytes at 0x1a000000; pc="),
        ("((void (*)(void))0x50000000)();", "jump to 0x50000000, where no code is"),
        ("((void (*)(void))in)();", "pc=0x1c[0-9a-f]{6} \\(in\\)"),
        ('for (;;) { __asm volatile(""); }', "the code has run 20000000 blocks without going to sleep"),
        ("R(0x1A105000) = 1;", "writes 4 bytes at 0x1a105000, where this model has no register"),
        ("seen[0] = R(0x1A101030);", "reads 4 bytes at 0x1a101030, where this model has no register"),
        ("*(volatile uint8_t *)0x1A101000 = 1;", "writes 1 bytes at 0x1a101000, where this model has no register"),
    ],
    ids=lambda value: value.split(";")[0][:30],
)
@pytest.mark.parametrize("where", ["main", "handler"])
def test_what_a_real_one_would_not_survive_ends_the_run(code: str, said: str, where: str, tmp_path: Path) -> None:
    if where == "handler" and "for" in code:
        pytest.skip("as long as in main")
    source = LISTEN + "__attribute__((noinline)) void bad(void) { " + code + " }\n"
    if where == "main":
        source += "HANDLER void line27(void) { taken(); }\n"
        source += "int main(void) { listen(); wfi(); for (;;) bad(); }"
    else:
        source += "HANDLER void line27(void) { bad(); }\nint main(void) { listen(); for (;;) wfi(); }"
    mcu = Gap8(build(tmp_path, source.replace("fadd.s", ".option arch, +f\\nfadd.s")))
    assert not mcu.failed
    mcu.ns = 1_234_567_000
    mcu.receive(UART1, b"x")
    assert bool(mcu.failed) == (where == "handler")
    mcu.transmit(SPI)
    assert mcu.failed.startswith("robot 0, gap8, 1.234567 s after its start: ")
    assert re.search(said, mcu.failed), mcu.failed
    assert ("interrupt=27" in mcu.failed) == (where == "handler")
    before = mcu.failed
    assert (mcu.transmit(SPI), mcu.failed) == (b"", before), "it is over"


def test_wfi_in_a_handler_ends_the_run(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, LISTEN + """
        HANDLER void line27(void) { taken(); wfi(); }
        int main(void) { listen(); for (;;) wfi(); }
    """))  # fmt: skip
    mcu.receive(UART1, b"x")
    assert "wfi in an interrupt handler" in mcu.failed


def test_a_handler_that_clears_nothing_ends_the_run(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, LISTEN + """
        HANDLER void line27(void) { seen[0]++; }
        int main(void) { listen(); for (;;) wfi(); }
    """))  # fmt: skip
    mcu.receive(UART1, b"x")
    assert "interrupt 27 comes again and again: its handler does not clear it" in mcu.failed
    assert mcu.word("seen") == 1000
