#include "random.h"

static uint64_t mixed(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9u;
    x = (x ^ (x >> 27)) * 0x94D049BB133111EBu;
    return x ^ (x >> 31);
}

void random_init(random_t *self, uint64_t seed, uint32_t robot, uint32_t component) {
    self->state = mixed(mixed(seed) + (((uint64_t)robot << 32) | component));
}

uint64_t random_next(random_t *self) {
    self->state += 0x9E3779B97F4A7C15u;
    return mixed(self->state);
}

bool random_chance(random_t *self, uint64_t threshold) {
    return threshold != 0 && (random_next(self) >> 11) < threshold;
}

int64_t random_exponential(random_t *self, int64_t mean) {
    if (mean == 0) {
        return 0;
    }
    // -ln(u) = ln 2 * -log2(u), log2 bit by bit: squaring a number in [1, 2) doubles its logarithm.
    uint64_t u = random_next(self) | 1;
    uint64_t zeros = 0;
    for (; (u >> 63) == 0; u <<= 1) {
        zeros++;
    }
    uint64_t x = u >> 32;
    uint64_t log2_q24 = 0;
    for (int bit = 0; bit < 24; bit++) {
        x = (x * x) >> 31;
        log2_q24 <<= 1;
        if ((x >> 32) != 0) {
            log2_q24 |= 1;
            x >>= 1;
        }
    }
    const uint64_t ln2_q24 = 11629080;
    uint64_t draw_q24 = ((((zeros + 1) << 24) - log2_q24) * ln2_q24) >> 24;
    uint64_t high = (uint64_t)mean >> 32;
    uint64_t low = (uint64_t)mean & UINT32_MAX;
    return (int64_t)(((high * draw_q24) << 8) + ((low * draw_q24) >> 24));
}

int64_t random_normal(random_t *self, int64_t deviation) {
    int64_t sum_q16 = -6 * 65536 + 6; // twelve uniform draws of 0..65535 have the mean 12 * 32767.5
    for (int draw = 0; draw < 3; draw++) {
        uint64_t bits = random_next(self);
        for (int part = 0; part < 4; part++, bits >>= 16) {
            sum_q16 += (int64_t)(bits & 0xFFFF);
        }
    }
    return deviation * sum_q16 / 65536;
}
