/// An MCU's oscillator: true time to local time and back, in integers.
///
/// local = anchor + elapsed + elapsed * rate, the rate in 1e-12 and constant over one segment of at most 100
/// ms. At each change of the rate the anchor moves there and the fraction of a nanosecond is carried on, so
/// the integral is exact. Segments lie on a fixed grid from the first power-up, and the random walk draws
/// once for each, so that the rate at any true time does not depend on who reads the clock when.
#ifndef SPINDECK_SIM_OSCILLATOR_H
#define SPINDECK_SIM_OSCILLATOR_H

#include "kernel.h"
#include "random.h"

enum {
    OSCILLATOR_SEGMENT_MS = 100,
    OSCILLATOR_SEGMENT_NS = 100000000,
    OSCILLATOR_AHEAD_SEGMENTS = 64, ///< how far oscillator_when_ns looks
    OSCILLATOR_PPB_MAX = 20000000,  ///< of the configured rate, of the ramp and of the step
};

typedef struct {
    int64_t anchor_ns;
    int64_t anchor_local_ns;
    int64_t fraction;   ///< of a local nanosecond at the anchor, in 1e-12
    int64_t rate_ppt;   ///< in this segment, 1e-12
    int64_t segment_ns; ///< true time at which the next segment starts
    int64_t segments;   ///< since power-up
    int64_t base_ppt;
    int64_t ramp_ppt;
    int64_t ramp_ms;
    int64_t step_ppt;
    int64_t step_ns;
    int64_t walk_ppt;
    int64_t walk_step_ppt; ///< standard deviation per segment
    random_t random;
} oscillator_t;

/// Powered up at `origin_ns`, when the local time is 0.
void oscillator_init(oscillator_t *self, const clock_config_t *config, int64_t origin_ns, random_t random);

/// Local time is 0 again; ramp and walk go on: the crystal stays as warm as it is.
void oscillator_restart(oscillator_t *self, int64_t true_ns);
void oscillator_set_rate(oscillator_t *self, int64_t true_ns, int64_t rate_ppb);

/// True times passed to these three may not decrease.
int64_t oscillator_local_ns(oscillator_t *self, int64_t true_ns);

/// The same for any time from the last one on; leaves the oscillator as it is.
int64_t oscillator_peek_ns(const oscillator_t *self, int64_t true_ns);

/// The first true nanosecond at which the local time is at least `local_ns`; but at most as far ahead as
/// OSCILLATOR_AHEAD_SEGMENTS: then ask again at that time.
int64_t oscillator_when_ns(const oscillator_t *self, int64_t local_ns);

#endif
