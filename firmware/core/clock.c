#include "clock_parts.h"

#include <string.h>

enum {
    DELAY_FIRST_US = 500,
    EARLY_US = 2000,      ///< earlier than the bound and this is no drift
    AGREE_US = 10000,     ///< messages of a leap among each other
    HELD_SPAN_US = 30000, ///< and not all at once, as a backlog comes
    RECENT = 11,          ///< as DOUBT, of messages' sum
    RECENT_MOST = 4,      ///< mean delays that one of them counts for
    QUEUED_US = 3000,     ///< a message this close behind another waited for it
};

/// Without branches, as most are of a few digits, and there are many.
static uint32_t root_32(uint32_t square) {
    uint32_t result = 0;
    for (uint32_t bit = (uint32_t)1 << 30; bit != 0; bit >>= 2) {
        const uint32_t least = result + bit;
        const uint32_t is_in = 0U - (square >= least);
        square -= least & is_in;
        result = (result >> 1) + (bit & is_in);
    }
    return result;
}

uint32_t clock_root(uint64_t square) {
    if (square <= UINT32_MAX) {
        return root_32((uint32_t)square);
    }
    uint64_t result = 0;
    for (uint64_t bit = (uint64_t)1 << 62; bit != 0; bit >>= 2) {
        if (square >= result + bit) {
            square -= result + bit;
            result = (result >> 1) + bit;
        } else {
            result >>= 1;
        }
    }
    return (uint32_t)result;
}

uint64_t clock_late_by_no_chance(const clock_track_t *self, uint64_t sum_q8, uint32_t count, uint32_t doubt) {
    const uint64_t expected_q8 = (uint64_t)self->mean_q8 * count;
    if (sum_q8 <= expected_q8) {
        return 0;
    }
    uint64_t mean = self->mean_q8;
    uint64_t over = sum_q8 - expected_q8;
    while (over >= (uint64_t)1 << 29) { // so that its square keeps to 64 bits
        over >>= 4;
        mean >>= 4;
    }
    return 3 * over * over > doubt * mean * (6 * mean * count + 4 * over) ? sum_q8 - expected_q8 : 0;
}

void clock_track_init(clock_track_t *self, const clock_known_t *known) {
    memset(self, 0, sizeof *self);
    self->known = *known;
    self->first = true;
    self->mean_q8 = DELAY_FIRST_US * Q8;
}

/// What this message says is all that is known, but for the skew.
static void begin_epoch(clock_track_t *self, uint64_t stm32_us, uint64_t gap8_us, uint8_t epoch) {
    self->first = self->first && !self->anchored;
    self->anchored = true;
    self->young = true;
    self->expired = false;
    self->fitted = false;
    self->epoch = epoch;
    self->anchor_stm32_us = stm32_us;
    self->anchor_gap8_us = gap8_us;
    self->begin_gap8_us = gap8_us;
    self->used_stm32_us = stm32_us;
    self->used_gap8_us = gap8_us;
    self->line = (clock_line_t){0, self->skewed ? self->skew_q31 : 0};
    self->window_us = 0;
    self->window_count = 0;
    self->recent_fill = 0;
    self->doubt_recent_us = 0;
    self->doubt_blocks_us = 0;
    self->doubt_windows_us = 0;
    self->doubt_sag_us = 0;
    self->doubt_stray_us = 0;
    self->doubt_early_us = 0;
    memset(self->apart, 0, sizeof self->apart);
    self->held_fill = 0;
    clock_track_blocks_begin(self);
}

static void close_block(clock_track_t *self, int32_t gap8_us) {
    clock_track_blocks_close(self, gap8_us);
    clock_track_window_renew(self);
    self->doubt_early_blocks = (uint8_t)(self->doubt_early_blocks < 2 ? self->doubt_early_blocks + 1 : 2);
    self->doubt_early_us = self->doubt_early_blocks < 2 ? self->doubt_early_us : 0;
    self->young = self->young && passed(self->begin_gap8_us, self->last_gap8_us) < CLOCK_YOUNG_US;
}

/// a - b, or 0; without a branch, for each message has 32 of them.
static uint32_t over(uint32_t a, uint32_t b) {
    return (a - b) & (0U - (a > b));
}

static uint32_t recent_late_q8(const clock_track_t *self, uint32_t back, uint32_t ticks_q8) {
    return over(self->recent_q8[(self->recent_head + CLOCK_RECENT - back) % CLOCK_RECENT], ticks_q8);
}

/// By how much so many of the newest messages in a row are late that it is no chance. The least of more is no
/// later: when it is too little for all of them, it stays so.
static uint32_t recent_least_q8(const clock_track_t *self, uint32_t ticks_q8) {
    const uint64_t doubt_q8 = (uint64_t)self->mean_q8 * DOUBT;
    uint32_t least_q8 = UINT32_MAX;
    for (uint32_t i = 0; i < self->recent_fill && (uint64_t)least_q8 * self->recent_fill > doubt_q8; i++) {
        const uint32_t late_q8 = recent_late_q8(self, i, ticks_q8);
        least_q8 = late_q8 < least_q8 ? late_q8 : least_q8;
        if (i > 0 && (uint64_t)least_q8 * (i + 1) > doubt_q8) {
            return least_q8;
        }
    }
    return 0;
}

/// By how much the sum of so many is, of which one alone may be far too late.
static uint64_t recent_sum_q8(const clock_track_t *self, uint32_t ticks_q8) {
    const uint32_t most_q8 = self->mean_q8 * RECENT_MOST;
    uint64_t far_q8 = 0;
    uint64_t sum_q8 = 0;
    uint32_t i = 0;
    for (uint32_t bits = 2; (uint32_t)1 << bits <= self->recent_fill; bits++) {
        const uint32_t count = (uint32_t)1 << bits;
        for (; i < count; i++) {
            const uint32_t late_q8 = recent_late_q8(self, i, ticks_q8);
            sum_q8 += late_q8 - over(late_q8, most_q8);
        }
        const uint64_t each_q8 = 2 * clock_late_by_no_chance(self, sum_q8, count, RECENT) >> bits;
        far_q8 = each_q8 > far_q8 ? each_q8 : far_q8;
    }
    return far_q8;
}

/// The newest messages, but none that was queued behind another.
static void remember(clock_track_t *self, int64_t above_q8) {
    self->recent_head = (uint8_t)((self->recent_head + 1) % CLOCK_RECENT);
    self->recent_q8[self->recent_head] = above_q8 < 0 ? at_most((uint64_t)-above_q8, LATE_US * Q8) : 0;
    self->recent_fill = (uint8_t)(self->recent_fill < CLOCK_RECENT ? self->recent_fill + 1 : CLOCK_RECENT);
    const uint32_t ticks_q8 = hidden_q8(self);
    const uint64_t least_q8 = recent_least_q8(self, ticks_q8);
    const uint64_t sum_q8 = recent_sum_q8(self, ticks_q8);
    self->doubt_recent_us = at_most((least_q8 > sum_q8 ? least_q8 : sum_q8) / Q8, LATE_US);
}

/// A message, from the anchor, and by how much it is above the line.
typedef struct {
    int32_t gap8_us;
    int64_t ahead_us;
    int64_t above_q8;
} reading_t;

static reading_t read_at(const clock_track_t *self, uint64_t stm32_us, uint64_t gap8_us) {
    const int32_t after_us = passed(self->anchor_gap8_us, gap8_us);
    const int64_t ahead_us = (int64_t)passed(self->anchor_stm32_us, stm32_us) - after_us;
    return (reading_t){after_us, ahead_us, ahead_us * Q8 - line_at(&self->line, after_us)};
}

/// A difference in 32 bits does not see the high ones. They are right, or a clock of 32 or 48 has wrapped.
static bool follows(uint64_t used_us, uint64_t stm32_us) {
    const uint64_t due_us = used_us + (uint64_t)(int64_t)passed(used_us, stm32_us);
    const uint64_t over_us = due_us - stm32_us;
    const bool wraps = over_us == (uint64_t)1 << 32 || over_us == (uint64_t)1 << 48;
    return over_us == 0 || (wraps && used_us < over_us && stm32_us < (uint64_t)1 << 31);
}

/// A message of another epoch, or damaged.
static void hold(clock_track_t *self, uint64_t stm32_us, uint64_t gap8_us) {
    self->dropped++;
    const int32_t since_us = passed(self->held_gap8_us, gap8_us);
    const int64_t drift_us = (int64_t)passed(self->held_stm32_us, stm32_us) - since_us;
    if (self->held_fill == 0 || drift_us > AGREE_US || drift_us < -AGREE_US || since_us < 0) {
        self->held_stm32_us = stm32_us;
        self->held_gap8_us = gap8_us;
        self->held_fill = 1;
        return;
    }
    self->held_fill = (uint8_t)(self->held_fill < UINT8_MAX ? self->held_fill + 1 : UINT8_MAX);
    if (self->held_fill >= CLOCK_HELD && since_us >= HELD_SPAN_US) {
        self->leaps++;
        begin_epoch(self, stm32_us, gap8_us, self->epoch);
    }
}

static void use(clock_track_t *self, const reading_t *reading, bool queued) {
    const int64_t above_q8 = reading->above_q8;
    clock_track_blocks_add(self, reading->gap8_us, (int32_t)reading->ahead_us, above_q8);
    if (!self->fitted) {
        return;
    }
    const uint64_t late_q8 = above_q8 < 0 ? (uint64_t)-above_q8 : 0;
    const uint32_t capped_q8 = at_most(late_q8, self->mean_q8 * 8 + 64 * Q8);
    self->mean_q8 = self->mean_q8 - self->mean_q8 / 128 + capped_q8 / 128;
    if (above_q8 > 0) {
        if (above_q8 > (int64_t)self->noise_q8 + self->wander_q8 + tick_q8(self)) {
            self->doubt_early_us = at_most((uint64_t)above_q8 / Q8 + 1, LATE_US);
            self->doubt_early_blocks = 0;
        }
        self->line.ahead_q8 += above_q8;
        self->open_best_q8 -= above_q8;
    }
    if (!queued) {
        remember(self, above_q8 > 0 ? 0 : above_q8);
    }
}

void clock_track_take(clock_track_t *self, uint64_t stm32_us, uint64_t gap8_us, uint8_t epoch) {
    const int32_t step_us = passed(self->last_gap8_us, gap8_us);
    const bool same = self->anchored && stm32_us == self->last_stm32_us;
    self->last_stm32_us = stm32_us;
    self->last_gap8_us = gap8_us;
    if (!self->anchored || self->expired || step_us < 0 || epoch != self->epoch) {
        if (step_us < 0) {
            self->skewed = false;
        }
        begin_epoch(self, stm32_us, gap8_us, epoch);
    } else if (same) {
        self->stuck = (uint8_t)(self->stuck < UINT8_MAX ? self->stuck + 1 : UINT8_MAX);
        self->dropped++;
        return;
    }
    self->stuck = 0;
    if (passed(self->anchor_gap8_us, gap8_us) < 0 || passed(self->anchor_gap8_us, gap8_us) > EXPIRED_US) {
        begin_epoch(self, stm32_us, gap8_us, epoch);
    }
    reading_t reading = read_at(self, stm32_us, gap8_us);
    const int64_t early_us =
        self->fitted ? 2 * (int64_t)((self->noise_q8 + self->wander_q8) / Q8) + EARLY_US : LATE_US;
    if (reading.above_q8 > early_us * Q8 || reading.above_q8 < -(int64_t)LATE_US * Q8 ||
        !follows(self->used_stm32_us, stm32_us)) {
        hold(self, stm32_us, gap8_us);
        return;
    }
    self->held_fill = 0;
    self->used_stm32_us = stm32_us;
    self->used_gap8_us = gap8_us;
    if (self->open.count > 0 && reading.gap8_us - self->open_begin_us >= (int32_t)self->block_us) {
        close_block(self, reading.gap8_us);
        reading = read_at(self, stm32_us, gap8_us);
    }
    use(self, &reading, step_us < QUEUED_US);
}
