/// The parts of the clock tracker, private to it: clock.c has the epochs and the gate that messages pass,
/// clock_blocks.c keeps the earliest of them, clock_window.c makes the line of the blocks and says how good
/// it is, clock_frames.c finds out how late a frame's end was read, clock_stamp.c says the time of a frame.
#ifndef SPINDECK_CORE_CLOCK_PARTS_H
#define SPINDECK_CORE_CLOCK_PARTS_H

#include "clock.h"

enum {
    Q8 = 256,
    BLOCK_LAST_US = 250000,
    FINE_NS = 1000,            ///< ticks that are no longer than this hide nothing
    COARSE_NS = 100000,        ///< messages may all come at the same place in such a tick
    SKEW_LIMIT_Q31 = 64424509, ///< 3 %
    EXPIRED_US = 2 * CLOCK_AGE_MAX_US,
    LATE_US = 100000, ///< later is no delay
    DOUBT = 9,        ///< a gap of this mean delays per message has a chance of e^-9
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

static inline int32_t clamp_skew(int64_t skew_q31) {
    const int64_t low = skew_q31 > -SKEW_LIMIT_Q31 ? skew_q31 : -SKEW_LIMIT_Q31;
    return (int32_t)(low < SKEW_LIMIT_Q31 ? low : SKEW_LIMIT_Q31);
}

static inline uint32_t tick_q8(const clock_track_t *self) {
    const uint32_t tick_ns = self->known.tick_ns < FINE_NS ? FINE_NS : self->known.tick_ns;
    return (uint32_t)((uint64_t)tick_ns * Q8 / 1000);
}

/// No message shows the edge of the delays in such ticks, but the mean of many is theirs, if they spread the
/// ticks (clock_coarse.c).
static inline bool is_coarse(const clock_track_t *self) {
    return self->known.tick_ns > COARSE_NS;
}

/// By how much apart the same instant may be read; with coarse ticks a line and a message may each be so
/// wrong. Of ticks of 1 us, half: what two such clocks are apart by chance.
static inline uint32_t hidden_q8(const clock_track_t *self) {
    const uint32_t ticks = is_coarse(self) ? 2 : 1;
    return self->known.tick_ns > FINE_NS ? ticks * tick_q8(self) : Q8 / 2;
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

// clock_coarse.c
/// Points that a line goes among.
typedef struct {
    int64_t weight;
    int64_t x;
    int64_t y;
    int64_t xx;
    int64_t xy;
} clock_moments_t;

/// mean_y + slope_q16 (x - mean_x)
typedef struct {
    int64_t mean_x;
    int64_t mean_y;
    int64_t slope_q16;
} clock_least_squares_t;

/// |x| < 2^16, |y| < 2^26; all weights together less than 2^14.
void clock_moments_add(clock_moments_t *self, int64_t weight, int64_t x, int64_t y);
clock_least_squares_t clock_moments_line(const clock_moments_t *self);
int64_t clock_least_squares_at(const clock_least_squares_t *self, int64_t x);
/// A message, into the open block's sums.
void clock_track_scatter_add(clock_track_t *self, int32_t gap8_us, int32_t ahead_us, int64_t above_q8);
/// The open block is full.
void clock_track_scatter_close(clock_track_t *self);
/// `better` shall have the messages of `other`, too, whose earliest is so much below its own; before the
/// counts are added.
void clock_track_scatter_merge(clock_block_t *better, const clock_block_t *other, int64_t apart_us);
/// The line of the blocks' means, if there is one that can be trusted.
void clock_track_means(clock_track_t *self);
/// That line, as far as the edge allows.
clock_line_t clock_track_line(const clock_track_t *self, int32_t gap8_us);

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
