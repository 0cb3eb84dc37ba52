#include "stamp_clock.h"

static const int64_t SECOND_NS = 1000000000;

void stamp_clock_init(stamp_clock_t *self, const clock_config_t *config) {
    bool whole = config->stamp_bits == 0 || config->stamp_bits == 64;
    *self = (stamp_clock_t){
        .start_us = config->stamp_start_us,
        .mask = whole ? UINT64_MAX : ((uint64_t)1 << config->stamp_bits) - 1,
        .quantum = config->quantum,
        .divider = config->divider,
    };
}

void stamp_clock_reset(stamp_clock_t *self, int64_t local_ns, uint64_t to_us) {
    self->reset_local_ns = local_ns;
    self->start_us = to_us;
}

static int64_t counted_ns(const stamp_clock_t *self, int64_t local_ns) {
    int64_t since_ns = local_ns - self->reset_local_ns;
    return self->divider == 84 ? since_ns / 85 * 84 + since_ns % 85 * 84 / 85 : since_ns;
}

uint64_t stamp_clock_us(const stamp_clock_t *self, int64_t local_ns) {
    uint64_t since_ns = (uint64_t)counted_ns(self, local_ns);
    uint64_t since_us = since_ns / 1000;
    if (self->quantum == QUANTUM_1MS) {
        since_us -= since_us % 1000;
    } else if (self->quantum == QUANTUM_RTC) {
        uint64_t second = (uint64_t)SECOND_NS;
        uint64_t ticks = since_ns / second * 32768 + since_ns % second * 32768 / second;
        since_us = ticks / 512 * 15625 + ticks % 512 * 15625 / 512;
    }
    return (self->start_us + since_us) & self->mask;
}

int64_t stamp_clock_exact_ns(const stamp_clock_t *self, int64_t local_ns) {
    uint64_t since_ns = (uint64_t)counted_ns(self, local_ns);
    uint64_t us = (self->start_us + since_ns / 1000) & self->mask;
    return (int64_t)(us * 1000 + since_ns % 1000);
}
