/// The clock that an MCU time-stamps with: a counter behind its oscillator, which may be coarse, wrap, be
/// reset and count at 84/85 of its nominal rate.
#ifndef SPINDECK_SIM_STAMP_CLOCK_H
#define SPINDECK_SIM_STAMP_CLOCK_H

#include "kernel.h"

typedef struct {
    int64_t reset_local_ns;
    uint64_t start_us;
    uint64_t mask;
    uint8_t quantum;
    uint8_t divider;
} stamp_clock_t;

void stamp_clock_init(stamp_clock_t *self, const clock_config_t *config);

/// From this local time on it counts up from `to_us`.
void stamp_clock_reset(stamp_clock_t *self, int64_t local_ns, uint64_t to_us);

uint64_t stamp_clock_us(const stamp_clock_t *self, int64_t local_ns);

/// In ns and not quantised; wraps like the clock.
int64_t stamp_clock_exact_ns(const stamp_clock_t *self, int64_t local_ns);

#endif
