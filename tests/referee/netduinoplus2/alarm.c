/// Takes the place of board/alarm.c in the image that QEMU runs; everything else in that image is the
/// board's.
///
/// QEMU's STM32 timers (hw/timer/stm32f2xx_timer.c) count right, but interrupt at a wrong time: one that
/// would reach ARR in d ticks does so d ticks and all the time since QEMU's start from now. So the wait is
/// set to the time that QEMU will make of it. A tick is 84 ns of QEMU's time there, and code takes some:
/// whatever must happen in a certain microsecond is done right behind its beginning.
///
/// At each of `inputs`, USART1 asks for the next byte on USART2, and time stands still until it is there. At
/// the last one the run ends.
#include "../../../firmware/stm32/board/board.h"

enum { NS_PER_TICK = 84, PIECE_US_MAX = 0xFFFF, INPUT_WANTED = 'I', NOT_TAKEN = 'N', ENDED = 'E' };

#define TIM4 ((timer_t *)0x40000800U) ///< never set up: QEMU lets it count nanoseconds
#define USART1 ((usart_t *)0x40011000U)

/// Uptimes, ascending, as tests/referee/stm32_board.py writes them.
extern const uint32_t inputs[];
extern const uint32_t inputs_end[];

void __real_usart_init(void);
void __wrap_usart_init(void);

static const uint32_t *input;
static uint64_t due_us;
static uint32_t origin; ///< QEMU's ticks at uptime 0

/// Waits for the beginning of a microsecond.
static uint32_t next_tick(void) {
    const uint32_t now = TIM5->cnt;
    uint32_t next;
    do {
        next = TIM5->cnt;
    } while (next == now);
    return next;
}

/// Lets TIM3 interrupt at an uptime, at the same place in that microsecond as in this one.
static void arm(uint32_t now_us, uint32_t at_us) {
    const uint32_t wait_us = at_us > now_us ? at_us - now_us : 1; // with 0 QEMU would hang
    TIM3->cnt = PIECE_US_MAX + origin + now_us - wait_us;
}

/// When to wake next.
static uint32_t wake_us(void) {
    uint32_t at_us = TIM5->cnt + PIECE_US_MAX / 2;
    if (due_us < at_us) {
        at_us = (uint32_t)due_us;
    }
    if (input != inputs_end && *input - 1 < at_us) {
        at_us = *input - 1; // its byte comes at the beginning of the next one
    }
    return at_us;
}

static void arm_next(void) {
    const uint32_t at_us = wake_us();
    arm(next_tick(), at_us);
}

static void take_input(void) {
    const uint32_t now_us = next_tick();
    if ((USART2->sr & USART_SR_RXNE) != 0) {
        USART1->dr = NOT_TAKEN; // the byte before: inputs are too close for this code in QEMU's time
    }
    USART1->dr = ++input == inputs_end ? ENDED : INPUT_WANTED;
    while ((USART2->sr & USART_SR_RXNE) == 0) {}
    const uint32_t lost_us = next_tick() - now_us;
    TIM5->cnt = now_us;
    TIM2->cnt -= lost_us;
    origin += lost_us;
    arm(now_us, wake_us());
}

void alarm_init(void) {
    due_us = NEVER_US;
    input = inputs;
    USART1->cr1 = USART_CR1_UE | USART_CR1_TE;
    TIM3->psc = NS_PER_TICK - 1;
    TIM3->arr = PIECE_US_MAX;
    TIM3->dier = TIM_DIER_UIE;
    TIM3->cr1 = TIM_CR1_CEN;
    interrupt_enable(IRQ_TIM3);
}

/// The last of the drivers to be set up: now it is 0 us, as when no code takes any time.
void __wrap_usart_init(void) {
    __real_usart_init();
    do {
        next_tick();
    } while (TIM4->cnt % (NS_PER_TICK + 1) > 8); // TIM2 may have a tick of 85 ns: that begins now, too
    TIM5->cnt = 0;
    TIM2->cnt = 0;
    origin = TIM4->cnt / NS_PER_TICK;
}

void alarm_set(uint64_t at_us) {
    due_us = at_us;
    arm_next();
}

bool alarm_came(uint64_t now_us) {
    TIM3->sr = ~(uint32_t)TIM_SR_UIF;
    if (input != inputs_end && now_us + 1 >= *input) {
        take_input();
        return false;
    }
    if (now_us >= due_us) {
        due_us = NEVER_US;
        return true;
    }
    arm_next();
    return false;
}
