#include "clock_parts.h"

enum {
    FRAMES_MIN = 8,   ///< for a line
    STEPS_MAX = 1000, ///< frames that may be missing in a row
    OFF_MAX = 3,
    SLACK_US = 4,          ///< of rates that change
    SPAN_US = 1000000000,  ///< of a line: differences keep to 32 bits
    MEAN_Q8_MAX = 1 << 27, ///< of which 14 keep to 32 bits
    Q16 = 65536,
    // Of coarse ticks few frames are kept, so that they span more of what the clocks drift by: every fifth or
    // sixth in turn, for all of one pace might be at the same place in the tick.
    COARSE_STEPS = 5,
    COARSE_APART_US = 160000,
    ABOVE_Q8_MAX = 1 << 25,
    LATEST_MEANS_10THS = 46, ///< 99 % of exponential latencies are less
};

/// r + p k, where the frame that came last is at k = 0, r in us * 256 after its reading.
typedef struct {
    int64_t last_q8;
    int64_t period_q16;
    uint32_t mean_q8; ///< how late readings are after it
} frames_line_t;

static uint8_t ring_place(const clock_track_t *self, uint8_t back) {
    return (uint8_t)((self->frames_head + CLOCK_FRAMES - back) % CLOCK_FRAMES);
}

static int32_t reading(const clock_track_t *self, uint8_t back) {
    return (int32_t)(self->frames_gap8_us[ring_place(self, back)] - self->frames_gap8_us[self->frames_head]);
}

static int32_t number(const clock_track_t *self, uint8_t back) {
    return (int32_t)(self->frames_number[ring_place(self, back)] - self->frames_number[self->frames_head]);
}

/// b, between them, is not below the line from a back to c.
static bool above(const clock_track_t *self, uint8_t a, uint8_t b, uint8_t c) {
    const int64_t at = reading(self, a);
    const int64_t from = number(self, a);
    return (reading(self, b) - at) * (number(self, c) - from) <=
           (reading(self, c) - at) * (number(self, b) - from);
}

/// How far a reading is above the line.
static int64_t above_q8(const clock_track_t *self, const frames_line_t *line, uint8_t back) {
    return (int64_t)reading(self, back) * Q8 - line->last_q8 - line->period_q16 * number(self, back) / Q8;
}

/// Of two frames or more. A reading can only be late: the edge of the lower hull over the mean of the frames'
/// numbers.
static frames_line_t lower_line(const clock_track_t *self) {
    uint8_t hull[CLOCK_FRAMES] = {0, 1}; // newest first
    uint8_t fill = 2;
    int64_t sum = number(self, 1);
    for (uint8_t i = 2; i < self->frames_fill; i++) {
        while (fill > 1 && above(self, hull[fill - 2], hull[fill - 1], i)) {
            fill--;
        }
        hull[fill++] = i;
        sum += number(self, i);
    }
    uint8_t edge = 1;
    while (edge + 1 < fill && (int64_t)number(self, hull[edge]) * self->frames_fill > sum) {
        edge++;
    }
    const uint8_t newer = hull[edge - 1];
    const uint8_t older = hull[edge];
    frames_line_t line = {.period_q16 = ((int64_t)reading(self, newer) - reading(self, older)) * Q16 /
                                        (number(self, newer) - number(self, older))};
    line.last_q8 = (int64_t)reading(self, newer) * Q8 - line.period_q16 * number(self, newer) / Q8;
    int64_t late_q8 = 0;
    for (uint8_t i = 0; i < self->frames_fill; i++) {
        late_q8 += above_q8(self, &line, i);
    }
    line.mean_q8 = late_q8 < 0 ? 0 : at_most((uint64_t)late_q8 / self->frames_fill, MEAN_Q8_MAX);
    return line;
}

/// How many periods after the last frame this one is; 0: it is not of their rate.
static uint32_t steps(const clock_track_t *self, uint32_t gap8_us) {
    const int64_t after_q8 = (int64_t)(int32_t)(gap8_us - self->frames_gap8_us[self->frames_head]) * Q8;
    if (self->frames_fill == 1) {
        return after_q8 > 0;
    }
    const frames_line_t line = lower_line(self);
    const int64_t period_q8 = line.period_q16 / Q8;
    if (after_q8 <= 0 || period_q8 <= 0) {
        return 0;
    }
    const int64_t count = (after_q8 - line.last_q8 + period_q8 / 2) / period_q8;
    const int64_t off_q8 = after_q8 - line.last_q8 - line.period_q16 * count / Q8;
    const int64_t most_q8 = 2 * ((int64_t)self->known.latency_us * Q8 + tick_q8(self)) + SLACK_US * Q8;
    const int64_t lines = self->frames_fill < FRAMES_MIN ? count + 1 : 1; // few say little about the period
    const bool fits =
        count > 0 && count <= STEPS_MAX && off_q8 <= most_q8 * lines && -off_q8 <= most_q8 * lines;
    return fits ? (uint32_t)count : 0;
}

/// False: it is off the line, of which one may be; some in a row begin another one. `after`: how many periods
/// the frame is after the newest that is kept.
static bool keep(clock_track_t *self, uint32_t gap8_us, uint32_t *after) {
    const uint32_t count = self->frames_fill == 0 ? 0 : steps(self, gap8_us);
    *after = 0;
    const int32_t since_us = (int32_t)(gap8_us - self->frames_gap8_us[self->frames_head]);
    const bool is_close = count < COARSE_STEPS || since_us < COARSE_APART_US;
    if (is_coarse(self) && count > 0 && is_close && self->frames_fill > 1) {
        self->frames_off = 0;
        *after = count;
        return self->frames_fill >= FRAMES_MIN;
    }
    if (count == 0 && self->frames_fill >= FRAMES_MIN && self->frames_off + 1 < OFF_MAX) {
        self->frames_off++;
        return false;
    }
    self->frames_off = 0;
    const uint32_t last = self->frames_number[self->frames_head];
    self->frames_fill = count == 0 ? 0 : self->frames_fill;
    self->frames_head = (uint8_t)((self->frames_head + 1) % CLOCK_FRAMES);
    self->frames_gap8_us[self->frames_head] = gap8_us;
    self->frames_number[self->frames_head] = last + count;
    self->frames_fill = (uint8_t)(self->frames_fill < CLOCK_FRAMES ? self->frames_fill + 1 : CLOCK_FRAMES);
    while (reading(self, (uint8_t)(self->frames_fill - 1)) < -SPAN_US) {
        self->frames_fill--;
    }
    return self->frames_fill >= FRAMES_MIN;
}

static clock_least_squares_t among(const clock_track_t *self, const frames_line_t *line) {
    clock_moments_t moments = {0};
    for (uint8_t i = 0; i < self->frames_fill; i++) {
        const int64_t each_q8 = above_q8(self, line, i);
        clock_moments_add(&moments, 1, number(self, i), each_q8 < ABOVE_Q8_MAX ? each_q8 : ABOVE_Q8_MAX);
    }
    return clock_moments_line(&moments);
}

/// Readings of an even pace are apart by no more than a tick and their latency: of a pace that has changed
/// the older half is left out.
static frames_line_t straight_line(clock_track_t *self) {
    const int64_t most_q8 = (int64_t)tick_q8(self) * 3 / 2 + 2 * (int64_t)self->known.latency_us * Q8;
    while (true) {
        const frames_line_t line = lower_line(self);
        const clock_least_squares_t middle = among(self, &line);
        int64_t low_q8 = INT64_MAX;
        int64_t high_q8 = INT64_MIN;
        for (uint8_t i = 0; i < self->frames_fill; i++) {
            const int64_t off_q8 =
                above_q8(self, &line, i) - clock_least_squares_at(&middle, number(self, i));
            low_q8 = off_q8 < low_q8 ? off_q8 : low_q8;
            high_q8 = off_q8 > high_q8 ? off_q8 : high_q8;
        }
        if (high_q8 - low_q8 <= most_q8 || self->frames_fill < 2 * FRAMES_MIN) {
            return line;
        }
        self->frames_fill /= 2;
    }
}

/// Of coarse ticks: from the reading to the line among the readings instead of below them, for lateness is
/// small against a tick. `after`: periods since the newest frame that is kept.
static int32_t coarse_shift(const clock_track_t *self, const frames_line_t *line, uint32_t gap8_us,
                            uint32_t after) {
    const clock_least_squares_t middle = among(self, line);
    const int64_t end_q8 =
        line->last_q8 + line->period_q16 * after / Q8 + clock_least_squares_at(&middle, after);
    const int64_t read_q8 = (int64_t)(int32_t)(gap8_us - self->frames_gap8_us[self->frames_head]) * Q8;
    const int64_t latency_q8 = (int64_t)self->known.latency_us * Q8;
    const int64_t tick = tick_q8(self);
    const int64_t shift_q8 = end_q8 - read_q8 + tick / 2 - latency_q8 * 10 / LATEST_MEANS_10THS;
    return (int32_t)(shift_q8 > tick ? tick : shift_q8 < -latency_q8 ? -latency_q8 : shift_q8);
}

clock_reading_t clock_track_frame(clock_track_t *self, uint64_t gap8_us, bool regular) {
    const uint32_t tick = tick_q8(self);
    const clock_reading_t alone = {(int32_t)(tick / 2), self->known.latency_us * Q8};
    if (!regular) {
        self->frames_fill = 0;
        return alone;
    }
    uint32_t after = 0;
    if (!keep(self, (uint32_t)gap8_us, &after)) {
        return alone;
    }
    const frames_line_t line = is_coarse(self) ? straight_line(self) : lower_line(self);
    if (is_coarse(self)) {
        return (clock_reading_t){coarse_shift(self, &line, (uint32_t)gap8_us, after), alone.spread_q8 / 2};
    }
    const uint32_t count = self->frames_fill;
    const uint32_t half = tick / 2;
    // Where phases sweep over the tick, readings are half of it apart on average, and a whole one early at
    // the edge. Where they do not, nobody knows, and half of it is the middle.
    const uint32_t swept_q8 = line.mean_q8 * 5 / 4 < half ? line.mean_q8 * 5 / 4 : half;
    const uint32_t late_q8 = line.mean_q8 * 4 / 5 > half ? line.mean_q8 - half : 0;
    const uint32_t blurred_q8 = clock_root((uint64_t)tick * late_q8 / count) * 5 / 4;
    const uint32_t sharp_q8 = swept_q8 / count;
    const uint32_t edge_q8 = 2 * late_q8 / count + (blurred_q8 > sharp_q8 ? blurred_q8 : sharp_q8);
    const int64_t shift_q8 = line.last_q8 + half + swept_q8 - edge_q8;
    const uint32_t spread_q8 = late_q8 * 14 / count + 2 * blurred_q8;
    return (clock_reading_t){(int32_t)(shift_q8 < tick ? shift_q8 : tick),
                             spread_q8 < alone.spread_q8 ? spread_q8 : alone.spread_q8};
}
