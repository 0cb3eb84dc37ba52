/// Random draws in integers alone, so that a seed gives the same bytes on every machine and compiler.
#ifndef SPINDECK_SIM_RANDOM_H
#define SPINDECK_SIM_RANDOM_H

#include <stdbool.h>
#include <stdint.h>

/// splitmix64. Streams are places on one cycle of 2^64, far apart by the hash in random_init.
typedef struct {
    uint64_t state;
} random_t;

/// The stream of one component of one robot.
void random_init(random_t *self, uint64_t seed, uint32_t robot, uint32_t component);

uint64_t random_next(random_t *self);

/// A probability as a threshold for random_chance: exact in steps of 2^-53. 0 never happens, 2^53 always.
static inline uint64_t random_threshold(double probability) {
    return (uint64_t)(probability * 9007199254740992.0);
}

/// Draws only if `threshold` is not 0.
bool random_chance(random_t *self, uint64_t threshold);

/// Exponential with this mean (0 to 2^56); at most 45 times the mean. Draws only if the mean is not 0.
int64_t random_exponential(random_t *self, int64_t mean);

/// Normal with mean 0 and this standard deviation (up to 2^40), as a sum of twelve uniform draws: within 6 of
/// them.
int64_t random_normal(random_t *self, int64_t deviation);

#endif
