"""Exceptions of the Cortex-M4F: frames, nesting, priorities, masks, tail-chaining, tasks with FPU state."""

from pathlib import Path

import numpy as np
import pytest
from arm_rig import NEVER_US, Mcu, build, step

TASKS = """
/* Two tasks on their own stacks, switched by PendSV out of SysTick as an RTOS does it, with live FPU registers. */
static uint32_t stacks[2][256], *stopped[2];
static int current;
volatile uint32_t runs[2], ticks;
volatile float sums[2], spoilt;
__attribute__((used)) uint32_t *choose(uint32_t *stack) {
    stopped[current] = stack;
    current ^= 1;
    return stopped[current];
}
__attribute__((naked)) void pendsv(void) {
    __asm volatile("mrs r0, psp; tst lr, #0x10; it eq; vstmdbeq r0!, {s16-s31}; stmdb r0!, {r4-r11, lr};"
                   "bl choose; ldmia r0!, {r4-r11, lr}; tst lr, #0x10; it eq; vldmiaeq r0!, {s16-s31};"
                   "msr psp, r0; isb; bx lr");
}
__attribute__((naked)) void svc(void) {
    __asm volatile("ldr r0, =stopped; ldr r0, [r0]; ldmia r0!, {r4-r11, lr}; msr psp, r0; isb; bx lr");
}
void systick(void) {
    ticks++;
    spoilt = spoilt * 3.0f + (float)ticks; /* uses the FPU: registers of the task must come back */
    ICSR = 1u << 28;
}
static void task(int own) {
    float sum = own + 1.0f, step = 0.25f + own;
    for (;;) {
        for (int i = 0; i < 100; i++) {
            sum = sum * 1.0000001f + step;
            __asm volatile("" : "+t"(sum), "+t"(step)); /* in registers across the switch */
        }
        sums[own] = sum;
        runs[own]++;
        uint32_t before;
        __asm volatile("mov %0, sp" : "=r"(before));
        if (before < (uint32_t)stacks[own] || before > (uint32_t)stacks[own + 1]) trap();
        wfi();
    }
}
static void task0(void) { task(0); }
static void task1(void) { task(1); }
int main(void) {
    clocks();
    R(0xE000ED20) = 0xF0F00000u;
    for (int i = 0; i < 2; i++) {
        uint32_t *at = stacks[i + 1];
        *--at = 1 << 24; *--at = (uint32_t)(i ? task1 : task0) & ~1u;
        at -= 6; *--at = 0xFFFFFFFD; at -= 8;
        stopped[i] = at;
    }
    R(0xE000E014) = 168000 - 1; R(0xE000E018) = 0; R(0xE000E010) = 7;
    __asm volatile("svc 0");
    trap();
}
"""


def test_tasks_on_their_own_stacks_keep_their_fpu_registers(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, TASKS))
    step(mcu, 200_000_000)
    assert mcu.failed == ""
    assert mcu.word("ticks") == 200
    mcu.deadline()
    runs = mcu.words("runs", 2)
    assert runs == [101, 100]
    for own, count in enumerate(runs):
        total, each = np.float32(own + 1), np.float32(0.25 + own)
        for _ in range(100 * count):
            total = np.float32(total * np.float32(1.0000001)) + each
        assert np.array([total]).view(np.uint32)[0] == mcu.words("sums", 2)[own]


FRAME = """
volatile uint32_t frame[26], lr_in, control_in, ipsr_in, registers[8], after[4];
volatile float fpu_after;
__attribute__((naked)) void irq1(void) {
    __asm volatile("ldr r0, =lr_in; str lr, [r0]; mrs r1, control; ldr r0, =control_in; str r1, [r0];"
                   "mrs r1, ipsr; ldr r0, =ipsr_in; str r1, [r0];"
                   "ldr r0, =frame; mov r1, sp; movs r2, #26;"
                   "1: ldr r3, [r1], #4; str r3, [r0], #4; subs r2, #1; bne 1b;"
                   "mov r12, #99; movs r1, #98; %s cmp r1, r1; bx lr");
}
int main(void) {
    clocks();
    ISER(0) = 1 << 1;
    __asm volatile("%s"
                   "sub sp, #%d;" /* the frame must be aligned all the same */
                   "movs r0, #10; movs r1, #11; movs r2, #12; movs r3, #13; mov r12, #14; mov lr, #15;"
                   "ldr r4, =0xE000E200; movs r5, #2; movs r6, #5; cmp r6, #7;" /* sets N alone */
                   "str r5, [r4]; isb;"
                   "2: mrs r7, apsr; add sp, #%d;"
                   "ldr r5, =registers; stmia r5!, {r0, r1, r2, r3, r12, lr}; str r7, [r5];"
                   "ldr r5, =after; mrs r0, control; str r0, [r5];"
                   "%s"
                   ::: "memory");
    for (;;) wfi();
}
"""


@pytest.mark.parametrize("pad", [0, 4])
@pytest.mark.parametrize("fpu", [False, True])
def test_the_frame_is_the_architecture_s_and_everything_comes_back(tmp_path: Path, pad: int, fpu: bool) -> None:
    spoil = "vmov.f32 s3, #1.0; vmov.f32 s15, #2.0; " if fpu else ""
    fill = "".join(f"vmov.f32 s{i}, #{i + 1}.0; " for i in range(16)) if fpu else ""
    check = "ldr r5, =fpu_after; vadd.f32 s0, s3, s15; vstr s0, [r5];" if fpu else ""
    mcu = Mcu(build(tmp_path, FRAME % (spoil, fill, pad, pad, check)))
    assert mcu.failed == ""
    frame = mcu.words("frame", 26)
    assert frame[:6] == [10, 11, 12, 13, 14, 15]
    pc, xpsr = frame[6], frame[7]
    assert mcu.image.place(pc).startswith("main+")
    assert xpsr & 0xF10001FF == 0x81000000, "N, Thumb, no exception"
    assert mcu.word("lr_in") == (0xFFFFFFE9 if fpu else 0xFFFFFFF9)
    assert mcu.word("ipsr_in") == 17
    assert mcu.word("control_in") == 0
    assert mcu.words("registers", 7) == [10, 11, 12, 13, 14, 15, 0x80000000]
    assert mcu.word("after") == (4 if fpu else 0), "FPCA is what it was"
    if fpu:
        assert frame[8:24] == [int(np.float32(i + 1).view(np.uint32)) for i in range(16)]
        assert np.array(mcu.words("fpu_after"), np.uint32).view(np.float32)[0] == 20


ORDER = """
volatile uint32_t order[16], n, active_lr;
static void note(uint32_t what) { order[n++ & 15] = what; }
void irq1(void) { note(1); ISPR(0) = 1 << 2; __asm volatile("isb"); note(11); }
void irq2(void) { note(2); ISPR(0) = 1 << 3; __asm volatile("isb"); note(12); }
__attribute__((noinline)) static void from3(uint32_t lr) { active_lr = lr; note(3); }
void irq3(void) { from3((uint32_t)__builtin_return_address(0)); }
int main(void) {
    clocks();
    R(0xE000ED0C) = 0x05FA0000 | %d << 8;
    IPR(1) = %d; IPR(2) = %d; IPR(3) = %d;
    ISER(0) = 1 << 1 | 1 << 2 | 1 << 3;
    ISPR(0) = 1 << 1;
    __asm volatile("isb");
    note(99);
    for (;;) wfi();
}
"""


@pytest.mark.parametrize(
    ("grouping", "priorities", "order"),
    [
        (3, (0x20, 0x10, 0x00), [1, 2, 3, 12, 11, 99]),  # each interrupts the one before
        (3, (0x20, 0x20, 0x20), [1, 11, 2, 12, 3, 99]),  # none does: the next follows without return
        (3, (0x00, 0x10, 0x20), [1, 11, 2, 12, 3, 99]),
        (3, (0x20, 0x30, 0x10), [1, 11, 2, 3, 12, 99]),
        (6, (0x70, 0x60, 0x00), [1, 11, 2, 12, 3, 99]),  # 0x70 and 0x00 differ in the sub-priority alone
        (6, (0xF0, 0x60, 0x00), [1, 2, 12, 3, 11, 99]),
        (7, (0xF0, 0x60, 0x00), [1, 11, 2, 12, 3, 99]),  # all are one group
    ],
)
def test_priorities(tmp_path: Path, grouping: int, priorities: tuple[int, int, int], order: list[int]) -> None:
    mcu = Mcu(build(tmp_path, ORDER % (grouping, *priorities)))
    assert mcu.failed == ""
    assert mcu.words("order", mcu.word("n")) == order


MASKS = """
volatile uint32_t taken, seen[6], n;
void irq1(void) { taken++; }
void irq2(void) { taken += 100; }
int main(void) {
    clocks();
    IPR(1) = 0x80; IPR(2) = 0x40;
    ISER(0) = 1 << 1 | 1 << 2;
    __asm volatile("cpsid i; isb"); ISPR(0) = 1 << 1; __asm volatile("isb"); seen[n++] = taken;
    __asm volatile("cpsie i; isb"); seen[n++] = taken;
    __asm volatile("msr basepri, %0; isb" :: "r"(0x80)); ISPR(0) = 1 << 1; __asm volatile("isb"); seen[n++] = taken;
    ISPR(0) = 1 << 2; __asm volatile("isb"); seen[n++] = taken;
    __asm volatile("msr basepri, %0; isb" :: "r"(0)); seen[n++] = taken;
    __asm volatile("cpsid f; isb"); ISPR(0) = 1 << 2; __asm volatile("isb"); seen[n++] = taken;
    __asm volatile("cpsie f; isb");
    /* Disabled while it waits, and cleared: it never comes. */
    R(0xE000E180) = 1 << 1; ISPR(0) = 1 << 1; __asm volatile("isb"); R(0xE000E280) = 1 << 1; ISER(0) = 1 << 1;
    for (;;) wfi();
}
"""


def test_masks_hold_an_interrupt_back(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, MASKS))
    assert mcu.failed == ""
    assert mcu.words("seen", 6) == [0, 1, 1, 101, 102, 102]
    assert mcu.word("taken") == 202


SLEEP = """
volatile uint32_t handled, woken, order;
void systick(void) { handled++; order = order * 10 + 1; R(0xE000E010) = 0; }
int main(void) {
    clocks();
    R(0xE000E014) = 168 * 500 - 1; R(0xE000E018) = 0; R(0xE000E010) = 7;
    for (;;) {
        __asm volatile("cpsid i");
        if (!handled) wfi();
        woken++; order = order * 10 + 2;
        __asm volatile("cpsie i; isb");
        if (handled) for (;;) wfi();
    }
}
"""


def test_an_interrupt_that_is_masked_ends_wfi_and_is_handled_when_it_is_let_in(tmp_path: Path) -> None:
    mcu = Mcu(build(tmp_path, SLEEP))
    assert mcu.deadline() == 500
    mcu.ns = 499_999
    assert mcu.deadline() == 500
    assert mcu.word("woken") == 0
    mcu.ns = 500_000
    assert mcu.deadline() == NEVER_US
    assert (mcu.word("handled"), mcu.word("woken"), mcu.word("order")) == (1, 1, 21)


SLEEP_ON_EXIT = """
/* Handlers that leave SLEEPONEXIT set end in sleep; the fourth clears it, or masks what would wake the core. */
#define SCR R(0xE000ED10)
volatile uint32_t handled, went_on, woken_at, depth, sp[4], seen[7], masks;
volatile float spoilt;
void systick(void) {
    sp[handled % 4] = (uint32_t)__builtin_frame_address(0);
    spoilt = spoilt * 3.0f + 1.0f; /* the frame's FPU registers must come back */
    __asm volatile("mov r1, #99; mov r2, r1; mov r3, r1; mov r12, r1; cmp r1, r1" ::: "r1", "r2", "r3", "r12", "cc");
    if (++handled == 4) {
        if (masks) __asm volatile("cpsid i"); else SCR = 0;
    }
}
int main(void) {
    clocks();
    masks = board_config;
    R(0xE000E014) = 168 * 500 - 1; R(0xE000E018) = 0; R(0xE000E010) = 7;
    SCR = 2;
    uint32_t scr = SCR;
    __asm volatile("vmov.f32 s3, #2.0; mov r1, #11; mov r2, #12; mov r3, #13; mov r12, #15; cmp r1, #12;"
                   "wfi; isb;"
                   "ite cc; movcc r0, #1; movcs r0, #0; ldr r4, =seen; stmia r4!, {r0, r1, r2, r3, r12};"
                   "vstmia r4!, {s3}"
                   ::: "r0", "r1", "r2", "r3", "r4", "r12", "s3", "cc", "memory");
    seen[6] = scr;
    woken_at = handled;
    went_on = 1;
    if (masks) { SCR = 0; __asm volatile("cpsie i; isb"); }
    R(0xE000E010) = 0;
    for (;;) wfi();
}
"""


@pytest.mark.parametrize("masks", [0, 1])
def test_sleeponexit_leaves_what_was_interrupted_asleep_until_a_handler_clears_it(tmp_path: Path, masks: int) -> None:
    mcu = Mcu(build(tmp_path, SLEEP_ON_EXIT), config=masks)
    for handled in range(1, 4):
        assert mcu.deadline() == 500 * handled
        mcu.ns = 500_000 * handled
        assert mcu.deadline() == 500 * (handled + 1)
        assert (mcu.word("handled"), mcu.word("went_on")) == (handled, 0)
    mcu.ns = 2_000_000
    mcu.deadline()
    if masks:  # its pending interrupt wakes the core, and is handled when it is let in
        assert (mcu.word("handled"), mcu.word("went_on")) == (4, 0)
        mcu.ns = 2_500_000
    assert mcu.deadline() == NEVER_US
    assert mcu.failed == ""
    assert (mcu.word("handled"), mcu.word("woken_at"), mcu.word("went_on")) == (4 + masks, 4, 1)
    two = int(np.array([2.0], dtype=np.float32).view(np.uint32)[0])
    assert mcu.words("seen", 7) == [1, 11, 12, 13, 15, two, 2]
    assert len(set(mcu.words("sp", 4))) == 1


CONDITIONS = """
/* Loads and stores in IT blocks, to pages that are looked up for the first time there, and again. */
volatile uint32_t results[64];
__attribute__((noinline)) static uint32_t one(uint32_t a, volatile uint32_t *from, volatile uint32_t *to) {
    uint32_t sum = 0, got = 0;
    __asm volatile("cmp %2, #1; itett eq; ldreq %1, [%3]; movne %0, #50; streq %2, [%4]; addeq %0, #1;"
                   "b 1f; .balign 4; 1: add %0, #2; cmp %2, #2; itt ne; ldrne %1, [%3]; addne %0, #4;"
                   "b 2f; 2: add %0, #8; b 3f; 3: add %0, #16"
                   : "+r"(sum), "+r"(got) : "r"(a), "r"(from), "r"(to) : "cc", "memory");
    return sum;
}
int main(void) {
    clocks();
    uint32_t n = 0;
    for (int round = 0; round < 3; round++) {
        for (uint32_t page = 0; page < 5; page++) {
            volatile uint32_t *ram = (uint32_t *)(0x20004000 + page * 0x4000);
            results[n++] = one(1, ram, ram + 1024);
            results[n++] = one(2, ram, ram + 2048);
            results[n++] = one(1, &R(page & 1 ? TIM2 + CNT : 0x40023810), page & 1 ? &R(TIM5 + CNT) : &R(0x40020014));
            results[n++] = one(3, &R(0xE000E014), &R(USART3 + BRR));
        }
    }
    for (;;) wfi();
}
"""


def test_conditional_loads_and_stores_leave_nothing_behind(tmp_path: Path) -> None:
    """Unicorn 2.1 leaves the state of an IT block when it looks up a page inside it."""
    mcu = Mcu(build(tmp_path, CONDITIONS))
    assert mcu.failed == ""
    assert mcu.words("results", 60) == [1 + 2 + 4 + 8 + 16, 50 + 2 + 8 + 16, 31, 50 + 2 + 4 + 8 + 16] * 15


def test_a_line_that_stays_up_calls_its_handler_again(tmp_path: Path) -> None:
    mcu = Mcu(
        build(
            tmp_path,
            """
            volatile uint32_t calls;
            void usart3(void) { if (++calls == 5) R(USART3 + CR1) = 0; }
            int main(void) {
                clocks(); R(USART3 + BRR) = 365; ISER(1) = 1 << 7; R(USART3 + CR1) = 1 << 13 | 1 << 7;
                for (;;) wfi();
            }
            """,
        )
    )
    assert mcu.failed == ""
    assert mcu.word("calls") == 5
