/// The GAP8's clock tracker over arrays: what it says of each frame, in one call.
#ifndef SPINDECK_HOST_CLOCK_RUN_H
#define SPINDECK_HOST_CLOCK_RUN_H

#include <stddef.h>

#include "../../firmware/core/clock.h"

typedef struct {
    uint64_t stm32_us; ///< not used for a frame
    uint64_t gap8_us;
    uint8_t epoch;
    uint8_t frame; ///< 0: a message; 1: a frame; 2: one that is not regular
} clock_event_t;

/// Goes on with `track`; `times` takes one of each frame. Returns the number of frames.
size_t clock_run(clock_track_t *track, const clock_event_t *events, size_t count, clock_time_t *times);

#endif
