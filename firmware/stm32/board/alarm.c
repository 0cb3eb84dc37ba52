#include "board.h"

enum { PRESCALER_1MHZ = 84 - 1, PIECE_US_MAX = 0xFFFF };

static uint64_t due_us;

/// Lets TIM3 run out when the alarm is due, or after the longest piece that it can count. Writing the counter
/// leaves the prescaler alone: it runs out at a tick of TIM5, which started just before it.
static void arm(void) {
    const uint64_t now_us = clock_up_us();
    uint32_t wait_us = PIECE_US_MAX;
    if (due_us <= now_us) {
        wait_us = 1;
    } else if (due_us - now_us < PIECE_US_MAX) {
        wait_us = (uint32_t)(due_us - now_us);
    }
    TIM3->cnt = PIECE_US_MAX + 1 - wait_us;
}

void alarm_init(void) {
    due_us = NEVER_US;
    TIM3->cr1 = TIM_CR1_URS;
    TIM3->psc = PRESCALER_1MHZ;
    TIM3->arr = PIECE_US_MAX;
    TIM3->egr = TIM_EGR_UG;
    TIM3->sr = ~(uint32_t)TIM_SR_UIF;
    TIM3->dier = TIM_DIER_UIE;
    TIM3->cr1 = TIM_CR1_URS | TIM_CR1_CEN;
    interrupt_enable(IRQ_TIM3);
}

void alarm_set(uint64_t at_us) {
    if (at_us != due_us) {
        due_us = at_us;
        arm();
    }
}

bool alarm_came(uint64_t now_us) {
    TIM3->sr = ~(uint32_t)TIM_SR_UIF;
    if (now_us >= due_us) {
        due_us = NEVER_US;
        return true;
    }
    arm();
    return false;
}
