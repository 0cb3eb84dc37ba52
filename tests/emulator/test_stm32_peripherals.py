"""STM32F405 peripherals of the emulator: timers against exact local time, USARTs and their errors, EXTI, the clocks."""

import random
from pathlib import Path

import pytest
from arm_rig import NEVER_US, UART1, UART2, Mcu, build, step

CLOCKS = """
volatile uint32_t at[3];
void usart2(void) {
    at[0] = R(TIM2 + CNT); at[1] = R(TIM5 + CNT); at[2] = R(0xE000E018);
    (void)R(USART2 + SR); (void)R(USART2 + DR);
}
static void start(uint32_t timer, uint32_t prescaler) {
    R(timer + PSC) = prescaler; R(timer + EGR) = 1; R(timer + TIM_CR1) = 1;
}
int main(void) {
    clocks();
    start(TIM2, 84); start(TIM5, 83);
    R(0xE000E014) = 168000 - 1; R(0xE000E018) = 0; R(0xE000E010) = 5;
    R(USART2 + BRR) = 73; R(USART2 + CR1) = 1 << 13 | 1 << 2 | 1 << 5; ISER(1) = 1 << 6;
    for (;;) wfi();
}
"""


def test_counters_show_the_exact_local_nanosecond(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, CLOCKS))
    seed = 20
    rng = random.Random(seed)
    for _ in range(2000):
        mcu.ns += rng.choice([0, 1, 11, 12, 999, 1000, 86_904, rng.randrange(10**9), rng.randrange(10**13)])
        mcu.receive(UART2, b"x")
        assert mcu.failed == ""
        slow, right, systick = mcu.words("at", 3)
        assert slow == mcu.ns * 84 // 85_000 % 2**32, f"at {mcu.ns} ns, seed {seed}"
        assert right == mcu.ns // 1000 % 2**32, f"at {mcu.ns} ns, seed {seed}"
        assert systick == -(mcu.ns * 168 // 1000) % 168_000, f"at {mcu.ns} ns, seed {seed}"


ALARM = """
volatile uint32_t wait, came, early;
static uint32_t due;
static void arm(void) { due = R(TIM5 + CNT) + wait; R(TIM3 + CNT) = 0x10000 - wait; }
void tim3(void) {
    R(TIM3 + TIM_SR) = ~1u;
    came++; early += R(TIM5 + CNT) != due;
    arm();
}
void usart2(void) { wait = R(USART2 + DR) * 257 + 1; arm(); }
int main(void) {
    clocks();
    wait = 1;
    for (int i = 0; i < 2; i++) {
        uint32_t timer = i ? TIM3 : TIM5;
        R(timer + TIM_CR1) = 4; R(timer + PSC) = 83; R(timer + EGR) = 1; R(timer + DIER) = i; R(timer + TIM_CR1) = 5;
    }
    ISER(0) = 1 << 29;
    R(USART2 + BRR) = 73; R(USART2 + CR1) = 1 << 13 | 1 << 2 | 1 << 5; ISER(1) = 1 << 6;
    arm();
    for (;;) wfi();
}
"""


@pytest.mark.parametrize("value", [0, 1, 7, 254])
def test_an_alarm_by_the_counter_comes_at_its_microsecond(tmp_path: Path, value: int) -> None:
    """However often it is set anew in between: writing CNT leaves the prescaler alone."""
    mcu = Mcu(build(tmp_path, ALARM))
    wait_us = value * 257 + 1
    mcu.ns = 123_456_789
    mcu.receive(UART2, bytes([value]))
    before, early = mcu.word("came"), mcu.word("early")
    for number in range(1, 20):
        assert mcu.deadline() == 123_456 + number * wait_us
        mcu.ns = mcu.deadline() * 1000 - 1
        assert mcu.deadline() == 123_456 + number * wait_us
        mcu.ns += 1
        mcu.deadline()
        assert mcu.word("came") == before + number
    assert mcu.word("early") == early
    assert mcu.failed == ""


def test_a_prescaler_written_later_counts_from_the_next_update(tmp_path: Path) -> None:
    source = """
    volatile uint32_t n;
    void tim3(void) { R(TIM3 + TIM_SR) = 0; if (++n == 2) R(TIM3 + PSC) = 839; if (n == 5) R(TIM3 + TIM_CR1) = 9; }
    int main(void) {
        clocks(); R(TIM3 + ARR) = 99; R(TIM3 + PSC) = 83; R(TIM3 + EGR) = 1; R(TIM3 + TIM_SR) = 0;
        R(TIM3 + DIER) = 1; R(TIM3 + TIM_CR1) = 1; ISER(0) = 1 << 29;
        for (;;) wfi();
    }
    """
    mcu = Mcu(build(tmp_path, source))
    times = []
    while (due_us := mcu.deadline()) != NEVER_US:
        times.append(due_us)
        mcu.ns = due_us * 1000
    assert times == [100, 200, 300, 1300, 2300, 3300], "at the end one pulse, and it stops"


ECHO = """
volatile uint32_t status[64], data[64], n, sent;
void usart2(void) {
    uint32_t now = R(USART2 + SR);
    if (now & 0x40 && R(USART2 + CR1) & 0x40) { R(USART2 + CR1) &= ~0x40u; sent++; }
    if (now & 0x2A) { status[n] = now; data[n++] = R(USART2 + DR); }
}
int main(void) {
    clocks();
    R(USART2 + BRR) = 73; R(USART2 + CR1) = 1 << 13 | 1 << 3 | 1 << 2 | 1 << 5; ISER(1) = 1 << 6;
    for (uint32_t last = 0;;) {
        if (n != last && R(USART2 + SR) & 0x80) {
            R(USART2 + SR) = ~0x40u; R(USART2 + DR) = data[last++] + 1; R(USART2 + CR1) |= 0x40;
        }
        if (n == last) wfi();
    }
}
"""


def test_a_usart_hands_out_a_byte_when_asked_and_ends_it_when_asked_again(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, ECHO))
    assert mcu.transmit(UART2) == b""
    mcu.receive(UART2, b"A")
    assert mcu.transmit(UART1) == b""
    assert mcu.transmit(UART2) == b"B"
    assert mcu.word("sent") == 0
    mcu.receive(UART2, b"X")
    assert mcu.deadline() == NEVER_US, "the main loop has written the next byte behind the one on the line"
    assert mcu.transmit(UART2) == b"Y"
    assert mcu.word("sent") == 0, "TC comes when nothing waits behind the byte that has left"
    assert mcu.transmit(UART2) == b""
    assert mcu.word("sent") == 1
    assert [each & 0x2A for each in mcu.words("status", 2)] == [0x20, 0x20]
    assert mcu.failed == ""


@pytest.mark.parametrize(("divisor", "byte_ps"), [(365, 86_904_762), (73, 17_380_952), (16, 3_809_524)])
def test_a_byte_takes_what_the_baud_register_says(tmp_path: Path, divisor: int, byte_ps: int) -> None:
    mcu = Mcu(build(tmp_path, ECHO.replace("BRR) = 73", f"BRR) = {divisor}")))
    assert mcu.byte_ps(UART2) == byte_ps


def test_clocks_come_from_the_rcc(tmp_path: Path) -> None:
    """Without the PLL the core runs at 16 MHz: all times are longer, as they would be on the part."""
    slow = ECHO.replace("clocks();", "R(0x40023840) = ~0u;")
    mcu = Mcu(build(tmp_path, slow))
    assert mcu.byte_ps(UART2) == 73 * 10 * 10**12 // 16_000_000


def test_overrun_is_seen(tmp_path: Path) -> None:
    """The handler is masked while two bytes come: the first stays, the second is lost, ORE says so."""
    masked = ECHO.replace("ISER(1) = 1 << 6;", "").replace("if (n == last) wfi();", "wfi(); ISER(1) = 1 << 6;")
    source = masked + "void systick(void) { R(0xE000E010) = 0; }"
    source = source.replace("clocks();", "clocks(); R(0xE000E014) = 16799999; R(0xE000E018) = 0; R(0xE000E010) = 7;")
    mcu = Mcu(build(tmp_path, source))
    mcu.receive(UART2, b"ab")
    assert mcu.word("n") == 0
    step(mcu, 200_000_000)
    assert mcu.failed == ""
    assert (mcu.word("n"), mcu.words("data", 1), mcu.words("status", 1)[0] & 0x2A) == (1, [ord("a")], 0x28)


@pytest.mark.parametrize(("percent", "framing"), [(0, 0), (3, 0), (-3, 0), (5, 2), (-5, 2), (100, 2)])
def test_a_wrong_baud_rate_is_a_framing_error(tmp_path: Path, percent: int, framing: int) -> None:
    mcu = Mcu(build(tmp_path, ECHO))
    mcu.set_wire(UART2, 17_380_952 * (100 + percent) // 100)
    mcu.receive(UART2, b"a")
    assert mcu.words("status", 1)[0] & 2 == framing


def test_the_stamp_clock_is_set_by_an_interrupt_with_the_value_in_a_mailbox(tmp_path: Path) -> None:
    source = """
    volatile uint64_t seen; volatile uint32_t counter, n;
    void exti0(void) { R(0x40013C14) = 1; R(TIM2 + EGR) = 1; seen = board_stamp_reset; counter = R(TIM2 + CNT); n++; }
    int main(void) {
        clocks(); R(TIM2 + PSC) = 83; R(TIM2 + EGR) = 1; R(TIM2 + TIM_CR1) = 1; counter = 1;
        R(0x40013C00) = 1; ISER(0) = 1 << 6;
        for (;;) wfi();
    }
    """
    mcu = Mcu(build(tmp_path, source))
    mcu.ns = 5_000_000
    mcu.reset_stamp(0x1234567890AB)
    assert mcu.failed == ""
    assert (mcu.words("seen", 2), mcu.word("counter"), mcu.word("n")) == ([0x567890AB, 0x1234], 0, 1)


def test_switched_on_again_nothing_is_left(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, ECHO))
    mcu.receive(UART2, b"A")
    assert mcu.transmit(UART2) == b"B"
    mcu.ns = 0
    mcu.power_up()
    assert mcu.failed == ""
    assert (mcu.word("n"), mcu.transmit(UART2), mcu.deadline()) == (0, b"", NEVER_US)
