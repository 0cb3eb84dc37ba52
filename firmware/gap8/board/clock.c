#include "board.h"

enum { HZ_PER_MHZ = 1000000, MS_US = 1000 };

_Static_assert(GAP8_FC_HZ % HZ_PER_MHZ == 0 && GAP8_FC_HZ / HZ_PER_MHZ <= 256, "see board.h");

enum {
    TIMER_1MHZ = TIMER_ENABLE | TIMER_PRESCALER | (int)(GAP8_FC_HZ / HZ_PER_MHZ - 1) << TIMER_PRESCALER_BIT,
};

static struct {
    uint64_t up_us;
    uint64_t ticks; ///< of the stamp clock since it was set
    uint64_t stamp_start_us;
    uint64_t stamp_mask;
    uint32_t up_last; ///< the counters when they were read
    uint32_t ticks_last;
} clock;

void clock_init(void) {
    const uint8_t bits = board_config.stamp_bits;
    clock.stamp_mask = bits == 0 || bits >= 64 ? UINT64_MAX : ((uint64_t)1 << bits) - 1;
    clock.stamp_start_us = board_config.stamp_start_us;
    FC_TIMER->reset_low = 1;
    FC_TIMER->reset_high = 1;
    FC_TIMER->cfg_low = TIMER_1MHZ | TIMER_EVENT;
    FC_TIMER->cfg_high =
        board_config.stamp_quantum == GAP8_STAMP_RTC ? TIMER_ENABLE | TIMER_REF_CLOCK : TIMER_1MHZ;
}

// The counters wrap after 71 minutes or later; the alarm brings a reading every 36.
uint64_t clock_up_us(void) {
    const uint32_t up = FC_TIMER->value_low;
    clock.up_us += up - clock.up_last;
    clock.up_last = up;
    return clock.up_us;
}

static uint64_t since_us(uint64_t ticks) {
    switch (board_config.stamp_quantum) {
    case GAP8_STAMP_RTC:
        return ticks / 512 * 15625 + ticks % 512 * 15625 / 512; // 1e6/32768 us each
    case GAP8_STAMP_1MS:
        return ticks - ticks % MS_US;
    default:
        return ticks;
    }
}

instant_t clock_now(void) {
    const uint64_t up_us = clock_up_us();
    const uint32_t ticks = FC_TIMER->value_high;
    clock.ticks += ticks - clock.ticks_last;
    clock.ticks_last = ticks;
    return (instant_t){up_us, (clock.stamp_start_us + since_us(clock.ticks)) & clock.stamp_mask};
}

void clock_set_stamp(uint64_t stamp_us) {
    FC_TIMER->reset_high = 1;
    clock.stamp_start_us = stamp_us;
    clock.ticks = 0;
    clock.ticks_last = 0;
}
