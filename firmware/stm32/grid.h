/// Times that come again and again.
#ifndef SPINDECK_STM32_GRID_H
#define SPINDECK_STM32_GRID_H

#include <stdint.h>

/// The first point after `now_us` of the grid that `next_us`, which has come, is on.
static inline uint64_t next_on_grid(uint64_t next_us, uint64_t period_us, uint64_t now_us) {
    return next_us + ((now_us - next_us) / period_us + 1) * period_us;
}

#endif
