/// The parts of the clock tracker, private to it: clock.c has the epochs and the gate that messages pass,
/// clock_blocks.c keeps the earliest of them, clock_window.c makes the line of the blocks and says how good
/// it is, clock_frames.c finds out how late a frame's end was read, clock_stamp.c says the time of a frame.
#ifndef SPINDECK_CORE_CLOCK_PARTS_H
#define SPINDECK_CORE_CLOCK_PARTS_H

#include "clock.h"

enum {
    Q8 = 256,
    BLOCK_LAST_US = 250000,
    FINE_NS = 1000,     ///< ticks that are no longer than this hide nothing
    COARSE_NS = 100000, ///< messages may all come at the same place in such a tick
    LATE_US = 100000,   ///< later is no delay
    DOUBT = 9,          ///< a gap of this mean delays per message has a chance of e^-9
};

static inline int32_t passed(uint64_t from, uint64_t to) {
    return (int32_t)(uint32_t)(to - from);
}

static inline int64_t line_at(const clock_line_t *line, int32_t gap8_us) {
    return line->ahead_q8 + (int64_t)line->skew_q31 * gap8_us / (1 << 23);
}

static inline uint32_t at_most(uint64_t value, uint32_t limit) {
    return value < limit ? (uint32_t)value : limit;
}

static inline uint32_t tick_q8(const clock_track_t *self) {
    const uint32_t tick_ns = self->known.tick_ns < FINE_NS ? FINE_NS : self->known.tick_ns;
    return (uint32_t)((uint64_t)tick_ns * Q8 / 1000);
}

/// By how much apart the same instant may be read; with coarse ticks a line and a message may each be so
/// wrong.
static inline uint32_t hidden_q8(const clock_track_t *self) {
    const uint32_t ticks = self->known.tick_ns > COARSE_NS ? 2 : 1;
    return self->known.tick_ns > FINE_NS ? ticks * tick_q8(self) : 0;
}

// clock.c
uint32_t clock_root(uint64_t square);
/// By how much `sum_q8` of so many delays is above its mean, if that has a chance of less than e^-doubt; else
/// 0. Delays are exponential: a sum that is r of its mean above it has exp(-count (r - ln(1 + r))), and that
/// is less than exp(-count r^2 / (2 + 4/3 r)).
uint64_t clock_late_by_no_chance(const clock_track_t *self, uint64_t sum_q8, uint32_t count, uint32_t doubt);

// clock_blocks.c. Times are after the anchor.
/// None, and an open one from the anchor on.
void clock_track_blocks_begin(clock_track_t *self);
/// A message, into the open block.
void clock_track_blocks_add(clock_track_t *self, int32_t gap8_us, int32_t ahead_us, int64_t above_q8);
/// Keeps the open block, which has a message, moves the anchor to it and opens the next at `gap8_us`.
void clock_track_blocks_close(clock_track_t *self, int32_t gap8_us);
/// The oldest.
void clock_track_blocks_drop(clock_track_t *self, uint8_t count);

// clock_window.c
/// The line of the blocks as they are now. Blocks that the newest contradict for long enough are given up.
void clock_track_window_renew(clock_track_t *self);

// clock_frames.c
typedef struct {
    int32_t shift_q8;   ///< from the reading to the end of the frame
    uint32_t spread_q8; ///< by how much that may be wrong, but for the tick
} clock_reading_t;

/// The end of a frame was read at `gap8_us`.
clock_reading_t clock_track_frame(clock_track_t *self, uint64_t gap8_us, bool regular);

#endif
