/// What a wire does to what it carries: one set of fault draws per unit and per byte, the same for every kind
/// of wire.
#ifndef SPINDECK_SIM_WIRE_H
#define SPINDECK_SIM_WIRE_H

#include "kernel.h"
#include "random.h"

typedef struct {
    wire_faults_t faults;
    uint64_t loss, duplicate, reorder, drop, flip; ///< the probabilities, as thresholds
    int64_t burst_mean_ns, stall_mean_ns;          ///< between them; 0: none
    bool faulty;                                   ///< false: a perfect wire, and nothing is ever drawn
    int64_t burst_start_ns, burst_end_ns;          ///< the present or next one
    int64_t stall_next_ns;
    int64_t stall_until_ns;
    random_t random;
    wire_counts_t counts;
} carrier_t;

/// True when every value of `faults` can be simulated.
bool wire_faults_ok(const wire_faults_t *faults);

void carrier_set_faults(carrier_t *self, const wire_faults_t *faults, int64_t now_ns);

/// Draws and counts whether the unit that starts now is lost.
bool carrier_loses(carrier_t *self, int64_t now_ns);
/// Only drawn: whether a unit is really copied or held is counted where that happens.
bool carrier_duplicates(carrier_t *self);
bool carrier_reorders(carrier_t *self);
int64_t carrier_delay_ns(carrier_t *self);

/// Drops and flips bytes where they lie; returns how many are left.
size_t carrier_damage(carrier_t *self, uint8_t *bytes, size_t size);

/// Draws the stalls that have begun by now.
void carrier_draw_stalls(carrier_t *self, int64_t now_ns);

/// When the wire moves again: now_ns, or the end of a stall.
static inline int64_t carrier_free_ns(carrier_t *self, int64_t now_ns) {
    if (self->stall_mean_ns != 0 && now_ns >= self->stall_next_ns) {
        carrier_draw_stalls(self, now_ns);
    }
    return self->stall_until_ns > now_ns ? self->stall_until_ns : now_ns;
}

/// Local or true time, in ns and rounded up, that `bytes` take.
static inline int64_t wire_time_ns(size_t bytes, int64_t byte_ps) {
    return ((int64_t)bytes * byte_ps + 999) / 1000;
}

#endif
