#include "clock_run.h"

size_t clock_run(clock_track_t *track, const clock_event_t *events, size_t count, clock_time_t *times) {
    size_t frames = 0;
    for (size_t i = 0; i < count; i++) {
        if (events[i].frame != 0) {
            clock_track_stamp(track, events[i].gap8_us, events[i].frame == 1, &times[frames++]);
        } else {
            clock_track_take(track, events[i].stm32_us, events[i].gap8_us, events[i].epoch);
        }
    }
    return frames;
}
