#include "board.h"

/// The counter comes round to the same value after 2^32 us: a longer wait goes in pieces.
static const uint64_t PIECE_US_MAX = 0x80000000;

static uint64_t due_us;

static void arm(uint64_t now_us) {
    const uint64_t piece_us = now_us + PIECE_US_MAX;
    FC_TIMER->compare_low = (uint32_t)(due_us < piece_us ? due_us : piece_us);
}

void alarm_init(void) {
    due_us = NEVER_US;
    arm(clock_up_us());
    interrupt_enable(IRQ_TIMER_LOW);
}

bool alarm_set(uint64_t at_us) {
    if (at_us == due_us) {
        return true;
    }
    due_us = at_us;
    arm(clock_up_us());
    return due_us > clock_up_us(); // the counter may have gone past while it was being compared with
}

bool alarm_came(uint64_t now_us) {
    interrupt_clear(IRQ_TIMER_LOW);
    const bool came = now_us >= due_us;
    if (came) {
        due_us = NEVER_US;
    }
    arm(now_us);
    return came;
}
