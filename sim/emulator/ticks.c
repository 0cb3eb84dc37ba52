#include "ticks.h"

static const uint64_t NS_KHZ = 1000000; ///< ns times kHz in one cycle

void ticks_start(ticks_t *self, int64_t now_ns) {
    *self = (ticks_t){.since_ns = now_ns};
}

uint64_t ticks_take(ticks_t *self, int64_t now_ns, uint32_t clock_khz, uint32_t divider) {
    uint64_t ns = (uint64_t)(now_ns - self->since_ns);
    uint64_t whole_cycles = ns / NS_KHZ * clock_khz;
    uint64_t rest = ns % NS_KHZ * clock_khz + self->phase + whole_cycles % divider * NS_KHZ;
    uint64_t tick = NS_KHZ * divider;
    self->since_ns = now_ns;
    self->phase = rest % tick;
    return whole_cycles / divider + rest / tick;
}

int64_t ticks_when_ns(const ticks_t *self, uint64_t count, uint32_t clock_khz, uint32_t divider) {
    uint64_t cycles = count * divider;
    // In ms first, so that nothing overflows: cycles / clock_khz ms, and the rest in ns.
    uint64_t ms = cycles / clock_khz;
    uint64_t rest = cycles % clock_khz * NS_KHZ;
    if (ms > INT64_MAX / NS_KHZ / 2) {
        return INT64_MAX - 1;
    }
    int64_t ns = (int64_t)(ms * NS_KHZ);
    if (rest >= self->phase) {
        return self->since_ns + ns + (int64_t)((rest - self->phase + clock_khz - 1) / clock_khz);
    }
    return self->since_ns + ns - (int64_t)((self->phase - rest) / clock_khz);
}
