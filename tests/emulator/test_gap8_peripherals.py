"""The GAP8's peripherals in the emulator: counters, to the nanosecond, UART, SPI and its handshake, the camera."""

import re
from pathlib import Path

import pytest
from gap8_image_rig import CAMERA, NEVER_US, SPI, UART1, Gap8, build

from host.native import lib

LOW_1MHZ = "R(TIMER + CFG) = 1 | 4 | 64 | 49 << 8;"


def test_counters_count_from_the_exact_local_time(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, """
        HANDLER void line27(void) {
            seen[0] = R(TIMER + VALUE); seen[1] = R(TIMER + VALUE + 4);
            (void)R(GPIO + 0x18); (void)R(POP); R(CLEAR) = 1u << 27;
        }
        HANDLER void line0(void) { R(TIMER + RESET + 4) = 1; R(CLEAR) = 1; }
        int main(void) {
            R(GPIO + 0x14) = 1 << 4; R(GPIO + 0x0C) = 1 << 18;
            R(SOC_MASK_HIGH) &= ~(1u << 10);
            R(IRQ_MASK_OR) = 1u << 27 | 1;
            R(TIMER + CFG) = 1 | 64 | 49 << 8; /* 1 MHz */
            R(TIMER + CFG + 4) = 1 | 128;      /* 32768 Hz */
            for (;;) wfi();
        }
    """))  # fmt: skip

    def at(ns: int) -> list[int]:
        mcu.ns = ns
        mcu.transmit(SPI)
        return mcu.words("seen", 2)

    edge = -(-(10**9) // 32768)
    assert at(999) == [0, 0]
    assert at(1000) == [1, 0]
    assert [at(edge - 1), at(edge)] == [[30, 0], [30, 1]]
    assert at(10**9 - 1) == [999_999, 32767]
    assert at(10**9) == [1_000_000, 32768]
    assert at(4_294_967_296_000) == [0, 4_294_967_296_000 * 32768 // 10**9 % 2**32]
    # Restarted, a counter counts from there; the other goes on.
    mcu.ns = 5_000_000_000_123
    lib.emulator_reset_stamp(mcu.pointer, 77, mcu.ns)
    assert mcu.words("board_stamp_reset", 2) == [77, 0]
    assert at(5_000_000_000_123 + edge - 1)[1] == 0
    assert at(5_000_000_000_123 + edge) == [(5_000_000_000_123 + edge) // 1000 % 2**32, 1]


def test_a_comparison_comes_at_the_first_nanosecond_and_once_in_a_round(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, """
        HANDLER void line10(void) { R(CLEAR) = 1u << 10; seen[0]++; seen[1] = R(TIMER + VALUE); }
        int main(void) { R(IRQ_MASK_OR) = 1u << 10; R(TIMER + COMPARE) = 5; """ + LOW_1MHZ + """ for (;;) wfi(); }
    """))  # fmt: skip
    assert mcu.deadline() == 5
    mcu.ns = 4999
    assert (mcu.deadline(), mcu.word("seen")) == (5, 0)
    mcu.ns = 5000
    mcu.transmit(CAMERA)
    assert mcu.words("seen", 2) == [1, 5]
    assert mcu.deadline() == 2**32 + 5
    mcu.ns = (2**32 + 5) * 1000
    mcu.deadline()
    assert mcu.words("seen", 2) == [2, 5]


@pytest.mark.parametrize(
    ("prescaler", "compare", "due_us"),
    [("0", 100, 2), ("64 | 255 << 8", 1, 6), ("128", 1, 31), ("128 | 64 | 3 << 8", 2, 245)],
)
def test_prescalers_and_clocks(prescaler: str, compare: int, due_us: int, tmp_path: Path) -> None:
    """50 MHz, and 32768 Hz; a deadline is in whole microseconds, the first that is not too early."""
    mcu = Gap8(build(tmp_path, f"""
        int main(void) {{ R(TIMER + COMPARE) = {compare}; R(TIMER + CFG) = 1 | 4 | {prescaler}; for (;;) wfi(); }}
    """))  # fmt: skip
    assert mcu.deadline() == due_us


def test_a_counter_that_stands_still_or_gives_no_event_is_no_alarm(tmp_path: Path) -> None:
    for number, cfg in enumerate(("4 | 64 | 49 << 8", "1 | 64 | 49 << 8")):
        folder = tmp_path / str(number)
        folder.mkdir()
        mcu = Gap8(
            build(folder, "int main(void) { R(TIMER + COMPARE) = 5; R(TIMER + CFG) = " + cfg + "; for (;;) wfi(); }")
        )
        assert mcu.deadline() == NEVER_US


UART = """
static uint32_t count;
HANDLER void line27(void) {
    seen[count++] = (R(POP) & 255) << 16 | in[0] << 8 | R(UART_RX + 4) << 4 | R(UART_RX + 8);
    R(CLEAR) = 1u << 27;
    AGAIN
}
int main(void) {
    R(UART_SETUP) = SETUP; R(SOC_MASK_LOW) &= ~(1u << 8); R(IRQ_MASK_OR) = 1u << 27;
    AGAIN
    for (;;) wfi();
}
"""


def uart(folder: Path, setup: str = "1 << 9 | 3 << 1 | 433 << 16", again: str = "dma(UART_RX, in, 1);") -> Gap8:
    return Gap8(build(folder, UART.replace("SETUP;", setup + ";").replace("AGAIN", again)))


def test_each_byte_on_uart1_is_a_transfer_and_an_event(tmp_path: Path) -> None:
    mcu = uart(tmp_path)
    mcu.receive(UART1, b"\x41")
    mcu.receive(UART1, b"\x42\x43")
    assert mcu.words("seen", 4) == [8 << 16 | 0x4100, 8 << 16 | 0x4200, 8 << 16 | 0x4300, 0]


def test_a_continuous_transfer_of_a_byte_begins_anew_by_itself(tmp_path: Path) -> None:
    begin = "R(UART_RX) = (uint32_t)(uintptr_t)in; R(UART_RX + 4) = SIZE; R(UART_RX + 8) = 1 << 4 | 1;"
    for size in (1, 2):
        (tmp_path / str(size)).mkdir()
    mcu = uart(tmp_path / "1", again="if (!seen[60]++) { " + begin.replace("SIZE", "1") + " }")
    mcu.receive(UART1, b"\x41\x42")
    mcu.receive(UART1, b"\x43")
    assert mcu.words("seen", 4) == [8 << 16 | 0x4111, 8 << 16 | 0x4211, 8 << 16 | 0x4311, 0]
    mcu = uart(tmp_path / "2", again=begin.replace("SIZE", "2"))
    assert "its code starts a DMA of 2 bytes with 0x11, which is not modelled" in mcu.failed


def test_what_uart1_cannot_receive_is_said(tmp_path: Path) -> None:
    for name in ("deaf", "once", "slow"):
        (tmp_path / name).mkdir()
    deaf = uart(tmp_path / "deaf", setup="3 << 1")
    deaf.receive(UART1, b"x")
    assert (deaf.failed, deaf.word("seen")) == ("", 0)
    once = uart(tmp_path / "once", again="if (!seen[60]++) dma(UART_RX, in, 1);")
    once.receive(UART1, b"x")
    assert once.word("seen") != 0
    once.receive(UART1, b"y")
    assert "no DMA is set up for what comes on UART1" in once.failed
    slow = uart(tmp_path / "slow", setup="1 << 9 | 3 << 1 | 5207 << 16")
    lib.emulator_set_wire(slow.pointer, UART1, 86_805_556)
    slow.receive(UART1, b"x")
    assert "UART1 is set up for bytes of 1041600 ns, and they take 86805" in slow.failed


SPI_IMAGE = """
/* Sends what main finds in board_app[0] bytes when it is asked; tells what has come. */
static volatile uint32_t ready;
HANDLER void line27(void) {
    uint32_t event = R(POP) & 255;
    R(CLEAR) = 1u << 27;
    seen[event]++;
    if (event == 4) { seen[0] = 4092 - R(SPI_RX + 4); dma(SPI_RX, in, 4092); }
    if (event == 42) { seen[1] = R(GPIO + 0x18); seen[2] = R(GPIO + 0x18); ready = 1; }
    if (event == 23) ready = 1;
}
int main(void) {
    R(GPIO + 0x14) = 1 << 4; R(GPIO + 0x0C) = 1 << 18;
    R(SOC_MASK_LOW) &= ~(1u << 4 | 1u << 23); R(SOC_MASK_HIGH) &= ~(1u << 10);
    R(IRQ_MASK_OR) = 1u << 27;
    dma(SPI_RX, in, 4092);
    for (uint32_t i = 0; i < sizeof out; i++) out[i] = (uint8_t)i;
    for (uint32_t size = 3;; ) {
        wfi();
        if (ready) { ready = 0; if (size) dma(SPI_TX, out + size, size); seen[3] = size; size = size == 3 ? 4092 : 0; }
    }
}
"""
RX, EOT, READY, SIZE = 4, 23, 42, 0


def test_a_window_begins_with_the_esp32_s_line_and_ends_when_the_kernel_asks_again(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, SPI_IMAGE))
    assert mcu.transmit(SPI) == bytes([3, 4, 5])
    assert mcu.words("seen", 3)[1:] == [1 << 18, 0], "reading the status clears it"
    events = [mcu.words("seen", 64)[event] for event in (RX, EOT, READY)]
    assert events == [0, 0, 1]
    # Under way: other ports and deadlines do not end it, and what is received does not either.
    mcu.transmit(CAMERA)
    mcu.deadline()
    mcu.receive(SPI, b"inject")
    mcu.transmit(CAMERA)
    assert [mcu.words("seen", 64)[event] for event in (RX, EOT, READY)] == [1, 0, 1]
    assert (mcu.bytes_of("in", 6), mcu.words("seen", 64)[SIZE]) == (b"inject", 6)
    mcu.receive(SPI, b"")
    assert mcu.words("seen", 64)[SIZE] == 0
    assert mcu.transmit(SPI) == bytes(i % 256 for i in range(4092, 2 * 4092))
    assert [mcu.words("seen", 64)[event] for event in (RX, EOT, READY)] == [2, 1, 1]
    mcu.receive(SPI, bytes(4092))
    assert mcu.words("seen", 64)[SIZE] == 4092
    assert mcu.transmit(SPI) == b"", "the end of the second, and nothing more to say"
    assert mcu.transmit(SPI) == b""
    assert [mcu.words("seen", 64)[event] for event in (RX, EOT, READY)] == [3, 2, 2]
    assert not mcu.failed


def test_in_a_window_that_the_slave_begins_alone_the_line_stays_up(tmp_path: Path) -> None:
    image = """
        static volatile uint32_t edges;
        HANDLER void line27(void) {
            uint32_t event = R(POP) & 255;
            R(CLEAR) = 1u << 27;
            if (event == 42) { seen[0]++; (void)R(GPIO + 0x18); edges++; }
            if (event == 23) seen[2]++;
        }
        int main(void) {
            R(GPIO + 0x14) = 1 << 4; R(GPIO + 0x0C) = 1 << 18;
            R(SOC_MASK_LOW) &= ~(1u << 23); R(SOC_MASK_HIGH) &= ~(1u << 10);
            R(IRQ_MASK_OR) = 1u << 27;
            out[0] = SAID;
            for (;;) {
                wfi();
                if (edges) { edges = 0; seen[1] = R(GPIO + 4); if (seen[1]) dma(SPI_TX, out, 4); }
            }
        }
    """
    mcu = Gap8(build(tmp_path, image.replace("SAID", "0")))
    assert (mcu.transmit(SPI), mcu.words("seen", 3)) == (b"", [1, 0, 0])
    lib.emulator_window(mcu.pointer, mcu.ns)
    assert mcu.words("seen", 3) == [2, 1 << 18, 0]
    mcu.transmit(CAMERA)
    assert mcu.words("seen", 3) == [2, 1 << 18, 0]
    assert (mcu.transmit(SPI), mcu.words("seen", 3)) == (b"", [2, 1 << 18, 1]), "the window's end"
    assert (mcu.transmit(SPI), mcu.words("seen", 3)) == (b"", [3, 0, 1])
    (tmp_path / "b").mkdir()
    mcu = Gap8(build(tmp_path / "b", image.replace("SAID", "1")))
    mcu.transmit(SPI)
    lib.emulator_window(mcu.pointer, mcu.ns)
    assert "it has something to say on SPI, a moment after it had nothing" in mcu.failed


def test_the_line_is_not_needed_where_something_has_come_already(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, SPI_IMAGE.replace("if (event == 23)", "if (event == 23 || event == 4)")))
    mcu.receive(SPI, b"x")
    assert mcu.transmit(SPI) == bytes([3, 4, 5])
    assert mcu.words("seen", 64)[READY] == 0


def test_masked_events_are_lost(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, SPI_IMAGE.replace("R(SOC_MASK_HIGH) &= ~(1u << 10);", "")))
    assert (mcu.transmit(SPI), mcu.words("seen", 64)[READY]) == (b"", 0)
    (tmp_path / "b").mkdir()
    mcu = Gap8(build(tmp_path / "b", SPI_IMAGE.replace("R(GPIO + 0x0C) = 1 << 18;", "")))
    assert (mcu.transmit(SPI), mcu.words("seen", 64)[READY]) == (b"", 0)


SEND = "dma(SPI_TX, out + size, size);"


@pytest.mark.parametrize(
    ("line", "instead", "said"),
    [
        (SEND, "dma(SPI_TX, (void *)0x1B000000, size);", "a DMA of 3 bytes at 0x1b000000 is not within L2"),
        (SEND, "dma(SPI_TX, (void *)0x1C07FFFE, size);", "a DMA of 3 bytes at 0x1c07fffe is not within L2"),
        (SEND, SEND + SEND, "its code sets up a DMA while the one before is under way"),
        ("uint32_t size = 3", "uint32_t size = 4093", "it sends 4093 bytes on SPI, where 4092 fit a window"),
    ],
    ids=["tcdm", "end", "twice", "long"],
)
def test_transfers_that_cannot_be_end_the_run(line: str, instead: str, said: str, tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, SPI_IMAGE.replace(line, instead)))
    assert (mcu.transmit(SPI), said in mcu.failed) == (b"", True), mcu.failed


def test_a_window_longer_than_its_buffer_ends_the_run(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, SPI_IMAGE))
    mcu.receive(SPI, bytes(4093))
    assert "4093 bytes come on SPI, and the DMA has room for 4092" in mcu.failed


CAMERA_IMAGE = """
HANDLER void line20(void) { seen[0]++; seen[1] = R(CAMERA + 20); R(CAMERA + 24) = 1; R(CLEAR) = 1u << 20; }
int main(void) {
    R(IRQ_MASK_OR) = 1u << 20;
    R(CAMERA) = 0x03020100; R(CAMERA + 4) = 0x07060504;
    R(CAMERA + 8) = (uint32_t)in; R(CAMERA + 12) = 5000; R(CAMERA + 16) = 1;
    for (;;) wfi();
}
"""


def test_the_camera_takes_a_command_and_brings_a_body(tmp_path: Path) -> None:
    mcu = Gap8(build(tmp_path, CAMERA_IMAGE))
    assert mcu.transmit(SPI) == b""
    assert mcu.transmit(CAMERA) == bytes(range(8))
    assert mcu.transmit(CAMERA) == b"", "once"
    body = bytes(i * 7 % 256 for i in range(5000))
    mcu.receive(CAMERA, body)
    assert (mcu.words("seen", 2), mcu.bytes_of("in", 5001)) == ([1, 5000], body + b"\0")
    mcu.receive(CAMERA, b"")
    assert mcu.words("seen", 2) == [2, 0]
    assert mcu.bytes_of("in", 5000) == body
    mcu.receive(CAMERA, bytes(5001))
    assert re.search("the camera's picture has 5001 bytes, and the image keeps at most 5000", mcu.failed)
