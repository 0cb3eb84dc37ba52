/// A prescaler: counts the ticks of a clock that is divided, exactly, from local nanoseconds.
#ifndef SPINDECK_SIM_TICKS_H
#define SPINDECK_SIM_TICKS_H

#include <stdint.h>

typedef struct {
    int64_t since_ns; ///< local; ticks before have been taken
    uint64_t phase;   ///< of the tick under way, in ns * kHz: a tick takes 1000000 * divider of these
} ticks_t;

/// A tick begins now.
void ticks_start(ticks_t *self, int64_t now_ns);

/// Whole ticks since the last call.
uint64_t ticks_take(ticks_t *self, int64_t now_ns, uint32_t clock_khz, uint32_t divider);

/// The first nanosecond at which ticks_take would return at least `count`; at most INT64_MAX - 1.
int64_t ticks_when_ns(const ticks_t *self, uint64_t count, uint32_t clock_khz, uint32_t divider);

#endif
