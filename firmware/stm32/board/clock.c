#include "board.h"

enum { PRESCALER_1MHZ = 84 - 1, PRESCALER_SLOW = 85 - 1 };

static struct {
    uint64_t up_us;
    uint64_t stamp_us;
    uint64_t stamp_mask;
    uint32_t up_last;    ///< TIM5->cnt when up_us was updated
    uint32_t stamp_last; ///< TIM2->cnt, stamp_us
} clock;

static void start(timer_t *timer, uint32_t prescaler) {
    timer->cr1 = TIM_CR1_URS;
    timer->psc = prescaler;
    timer->arr = UINT32_MAX;
    timer->egr = TIM_EGR_UG;
    timer->cr1 = TIM_CR1_URS | TIM_CR1_CEN;
}

void clock_init(void) {
    const uint8_t bits = board_config.stamp_bits;
    clock.stamp_mask = bits == 0 || bits >= 64 ? UINT64_MAX : ((uint64_t)1 << bits) - 1;
    clock.stamp_us = board_config.stamp_start_us;
    start(TIM5, PRESCALER_1MHZ);
    start(TIM2, board_config.stamp_divider == 84 ? PRESCALER_SLOW : PRESCALER_1MHZ);
}

// The counters wrap after 71 minutes; the alarm's timer alone brings a reading every 66 ms.
uint64_t clock_up_us(void) {
    const uint32_t up = TIM5->cnt;
    clock.up_us += up - clock.up_last;
    clock.up_last = up;
    return clock.up_us;
}

instant_t clock_now(void) {
    const uint64_t up_us = clock_up_us();
    const uint32_t stamp = TIM2->cnt;
    clock.stamp_us += stamp - clock.stamp_last;
    clock.stamp_last = stamp;
    return (instant_t){up_us, clock.stamp_us & clock.stamp_mask};
}

void clock_set_stamp(uint64_t stamp_us) {
    TIM2->egr = TIM_EGR_UG;
    clock.stamp_us = stamp_us;
    clock.stamp_last = 0;
}
