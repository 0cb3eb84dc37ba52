#include "clock.h"

#include "image.h"

#include <string.h>

enum {
    Q8 = 256,
    BLOCK_FIRST_US = 31250,
    BLOCK_LAST_US = 250000,
    HISTORY_MAX_US = 20000000,
    DELAY_FIRST_US = 500,
    FINE_NS = 1000,
    COARSE_NS = 100000, ///< messages may all come at the same place in such a tick
    APART_COUNT = 32,   ///< blocks that the means of the shortest window are over
    VOTES_MIN_Q16 = 20000,
    SKEW_LIMIT_Q31 = 64424509, ///< 3 %
    SKEW_KNOWN_US = 4000000,   ///< window that makes a skew worth keeping
    SKEW_SPAN_US = 2000000,    ///< shorter ones are of less worth than a skew that was kept
    LATE_US = 100000,          ///< later is no delay
    EARLY_US = 2000,           ///< earlier than the bound and this is no drift
    AGREE_US = 10000,          ///< messages of a leap among each other
    HELD_SPAN_US = 30000,      ///< and not all at once, as a backlog comes
    QUEUED_US = 3000,          ///< a message this close behind another waited for it
    HOLDOVER_US = 250000,
    LEAP_US = 1000,   ///< starved by more: a leap, not drift
    MESSAGES_MIN = 8, ///< for a first line
    STUCK_MIN = 3,
    DOUBT = 14, ///< a gap of this mean delays per message has a chance of e^-14
    STARVED = 24,
    STARVED_BLOCKS_US = 1000000, ///< for so long
};

static int32_t passed(uint64_t from, uint64_t to) {
    return (int32_t)(uint32_t)(to - from);
}

static int64_t line_at(const clock_line_t *line, int32_t gap8_us) {
    return line->ahead_q8 + (int64_t)line->skew_q31 * gap8_us / (1 << 23);
}

static uint32_t root(uint64_t square) {
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

static uint32_t at_most(uint64_t value, uint32_t limit) {
    return value < limit ? (uint32_t)value : limit;
}

void clock_track_init(clock_track_t *self, const clock_known_t *known) {
    memset(self, 0, sizeof *self);
    self->known = *known;
    self->first = true;
    self->mean_q8 = DELAY_FIRST_US * Q8;
}

/// Longer windows' lines change less often.
static void set_memories(clock_track_t *self) {
    for (uint8_t i = 0; i < CLOCK_WINDOWS - 1; i++) {
        self->apart[i].count_max = (uint8_t)(APART_COUNT << i);
    }
}

static void open_block(clock_track_t *self, int32_t gap8_us) {
    self->open = (clock_block_t){0};
    self->open_begin_us = gap8_us;
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
    self->line = (clock_line_t){0, self->skewed ? self->skew_q31 : 0};
    self->window_us = 0;
    self->window_count = 0;
    self->recent_fill = 0;
    self->doubt_recent_us = 0;
    self->doubt_blocks_us = 0;
    self->doubt_windows_us = 0;
    self->doubt_early_us = 0;
    self->blocks_fill = 0;
    self->block_us = BLOCK_FIRST_US;
    memset(self->apart, 0, sizeof self->apart);
    set_memories(self);
    self->held_fill = 0;
    open_block(self, 0);
}

/// To the newest block, so that numbers stay small.
static void rebase(clock_track_t *self) {
    const clock_block_t to = self->blocks[self->blocks_fill - 1];
    self->line.ahead_q8 = line_at(&self->line, to.gap8_us) - (int64_t)to.ahead_us * Q8;
    self->anchor_gap8_us += (uint64_t)(int64_t)to.gap8_us;
    self->anchor_stm32_us += (uint64_t)((int64_t)to.gap8_us + to.ahead_us);
    for (uint8_t i = 0; i < self->blocks_fill; i++) {
        self->blocks[i].gap8_us -= to.gap8_us;
        self->blocks[i].ahead_us -= to.ahead_us;
    }
}

/// The better of two neighbours under the line's skew.
static clock_block_t merged(const clock_line_t *line, clock_block_t a, clock_block_t b) {
    const int64_t a_q8 = (int64_t)a.ahead_us * Q8 - line_at(line, a.gap8_us);
    const int64_t b_q8 = (int64_t)b.ahead_us * Q8 - line_at(line, b.gap8_us);
    const clock_block_t *better = a_q8 > b_q8 ? &a : &b;
    const uint32_t count = (uint32_t)a.count + b.count;
    return (clock_block_t){better->gap8_us, better->ahead_us, (uint16_t)at_most(count, UINT16_MAX / 2)};
}

static void drop_oldest(clock_track_t *self, uint8_t count) {
    self->blocks_fill = (uint8_t)(self->blocks_fill - count);
    memmove(self->blocks, self->blocks + count, self->blocks_fill * sizeof self->blocks[0]);
}

static void push_block(clock_track_t *self) {
    if (self->blocks_fill == CLOCK_BLOCKS && self->block_us < BLOCK_LAST_US) {
        for (uint8_t i = 0; i < CLOCK_BLOCKS / 2; i++) {
            self->blocks[i] = merged(&self->line, self->blocks[2 * i], self->blocks[2 * i + 1]);
        }
        self->blocks_fill = CLOCK_BLOCKS / 2;
        self->block_us *= 2;
        self->apart[0] = self->apart[1];
        self->apart[1] = self->apart[2];
        set_memories(self);
    } else if (self->blocks_fill == CLOCK_BLOCKS) {
        drop_oldest(self, 1);
    }
    self->blocks[self->blocks_fill++] = self->open;
    rebase(self);
    uint8_t old = 0;
    while (self->blocks[old].gap8_us < -HISTORY_MAX_US) {
        old++;
    }
    drop_oldest(self, old);
}

typedef struct {
    clock_line_t line;
    uint32_t count;
    uint32_t span_us;
} fit_t;

/// b is not above the line from a to c.
static bool below(const clock_block_t *a, const clock_block_t *b, const clock_block_t *c) {
    return ((int64_t)b->ahead_us - a->ahead_us) * ((int64_t)c->gap8_us - a->gap8_us) <=
           ((int64_t)c->ahead_us - a->ahead_us) * ((int64_t)b->gap8_us - a->gap8_us);
}

static uint32_t tick_q8(const clock_track_t *self) {
    const uint32_t tick_ns = self->known.tick_ns < FINE_NS ? FINE_NS : self->known.tick_ns;
    return (uint32_t)((uint64_t)tick_ns * Q8 / 1000);
}

/// What ticks add: readings spread evenly over one, and few of many are near its end.
static uint32_t tick_error(const clock_track_t *self, uint32_t count) {
    if (self->known.tick_ns <= FINE_NS) {
        return 0;
    }
    return root((uint64_t)tick_q8(self) * self->mean_q8 / count);
}

static uint32_t per_message(const clock_track_t *self, uint32_t count, uint32_t times) {
    const uint64_t delays = (uint64_t)self->mean_q8 * times / count;
    return at_most(delays + (uint64_t)tick_error(self, count) * times / 4, (uint32_t)1 << 30);
}

/// By how much a line over the points is too low.
static uint32_t low_by(const clock_track_t *self, uint32_t count, uint32_t points) {
    return at_most((uint64_t)self->mean_q8 * points / count, (uint32_t)1 << 30) +
           tick_error(self, count) * 5 / 4;
}

/// The edge of the upper hull of the newest blocks, two or more, that spans their mean time: of all lines
/// above all points it is the one with the least sum of distances. It is too low by 2 mean delays per
/// message.
static fit_t fit(const clock_track_t *self, uint8_t blocks) {
    const clock_block_t *from = self->blocks + self->blocks_fill - blocks;
    uint8_t hull[CLOCK_BLOCKS];
    uint8_t fill = 0;
    int64_t moment = 0;
    fit_t result = {.span_us = (uint32_t)-from[0].gap8_us};
    for (uint8_t i = 0; i < blocks; i++) {
        while (fill > 1 && below(&from[hull[fill - 2]], &from[hull[fill - 1]], &from[i])) {
            fill--;
        }
        hull[fill++] = i;
        moment += (int64_t)from[i].gap8_us * from[i].count;
        result.count += from[i].count;
    }
    if (self->skewed && self->blocks[0].gap8_us > -SKEW_SPAN_US) {
        result.line.skew_q31 = self->skew_q31;
        int64_t best_q8 = INT64_MIN;
        for (uint8_t i = 0; i < fill; i++) {
            const clock_block_t *point = &from[hull[i]];
            const int64_t above_q8 = (int64_t)point->ahead_us * Q8 - line_at(&result.line, point->gap8_us);
            best_q8 = above_q8 > best_q8 ? above_q8 : best_q8;
        }
        result.line.ahead_q8 = best_q8 + low_by(self, result.count, 1);
        return result;
    }
    const int64_t middle_us = moment / (int64_t)result.count;
    uint8_t edge = 1;
    while (edge + 1 < fill && from[hull[edge]].gap8_us < middle_us) {
        edge++;
    }
    const clock_block_t *left = &from[hull[edge - 1]];
    const clock_block_t *right = &from[hull[edge]];
    int64_t skew = ((int64_t)right->ahead_us - left->ahead_us) * ((int64_t)1 << 31) /
                   ((int64_t)right->gap8_us - left->gap8_us);
    skew = skew > SKEW_LIMIT_Q31 ? SKEW_LIMIT_Q31 : skew < -SKEW_LIMIT_Q31 ? -SKEW_LIMIT_Q31 : skew;
    result.line.skew_q31 = (int32_t)skew;
    result.line.ahead_q8 =
        (int64_t)right->ahead_us * Q8 - line_at(&result.line, right->gap8_us) + low_by(self, result.count, 2);
    return result;
}

static uint64_t squared(uint64_t value) {
    return value * value;
}

/// How far the line of window i is from that of half its length, at the end of the time that it will serve.
static void compare(clock_track_t *self, const fit_t *half, const fit_t *whole, clock_apart_t *apart) {
    const int32_t horizon_us = 2 * (int32_t)self->block_us;
    const int64_t signed_q8 = line_at(&whole->line, horizon_us) - line_at(&half->line, horizon_us);
    const uint64_t apart_q8 = at_most((uint64_t)(signed_q8 < 0 ? -signed_q8 : signed_q8), (uint32_t)1 << 28);
    const int32_t vote_q16 = apart_q8 > per_message(self, half->count, 8) ? 65536 : 0;
    apart->count = (uint8_t)(apart->count < apart->count_max ? apart->count + 1 : apart->count);
    apart->newest_q8 = (uint32_t)apart_q8;
    const int64_t square = (int64_t)squared(apart_q8);
    apart->square_q16 =
        (uint64_t)((int64_t)apart->square_q16 + (square - (int64_t)apart->square_q16) / apart->count);
    apart->mean_q16 += ((signed_q8 < 0 ? -1 : 1) * (int64_t)apart_q8 * Q8 - apart->mean_q16) / apart->count;
    apart->votes_q16 += (vote_q16 - apart->votes_q16) / apart->count;
}

/// Of that, what delays do not explain.
static uint64_t unexplained(const clock_track_t *self, const clock_apart_t *apart, uint32_t count) {
    const uint64_t chance = squared(per_message(self, count, 4));
    const uint64_t mean = squared((uint64_t)(apart->mean_q16 < 0 ? -apart->mean_q16 : apart->mean_q16) / Q8);
    const uint64_t steady = mean > chance / 3 ? mean - chance / 3 : 0;
    const uint64_t loose =
        apart->votes_q16 > VOTES_MIN_Q16 && apart->square_q16 > chance ? apart->square_q16 - chance : 0;
    return 4 * (steady > loose ? steady : loose);
}

/// The window whose line has the least error to be expected: of delays, which it averages, and of the
/// oscillators, which by the lines of windows of twice the length are as far apart as they have wandered.
/// What drifts in a short window drifts twice as far in one of twice the length, or it was chance.
static void choose(clock_track_t *self) {
    fit_t fits[CLOCK_WINDOWS];
    uint64_t excess[CLOCK_WINDOWS] = {0};
    uint8_t count = 1;
    fits[0] = fit(self, self->blocks_fill < 8 ? self->blocks_fill : 8);
    while (count < CLOCK_WINDOWS && self->blocks_fill >= 8U << count) {
        fits[count] = fit(self, (uint8_t)(8U << count));
        compare(self, &fits[count - 1], &fits[count], &self->apart[count - 1]);
        excess[count] = unexplained(self, &self->apart[count - 1], fits[count - 1].count);
        count++;
    }
    for (uint8_t i = (uint8_t)(count - 1); i > 1; i--) {
        excess[i - 1] = excess[i - 1] > excess[i] / 2 ? excess[i] / 2 : excess[i - 1];
    }
    uint8_t best = 0;
    uint64_t best_cost = squared(per_message(self, fits[0].count, 7)) / 4;
    uint64_t wander = self->apart[0].square_q16 / 4;
    for (uint8_t i = 1; i < count; i++) {
        if (self->apart[i - 1].newest_q8 > per_message(self, fits[i - 1].count, 40)) {
            break;
        }
        excess[i] = excess[i] > excess[i - 1] ? excess[i] : excess[i - 1];
        const uint64_t cost = squared(per_message(self, fits[i].count, 7)) / 4 + excess[i];
        if (cost < best_cost) {
            best_cost = cost;
            best = i;
            wander = self->apart[i - 1].square_q16 > excess[i] ? self->apart[i - 1].square_q16 : excess[i];
        }
    }
    self->line = fits[best].line;
    self->window_us = fits[best].span_us;
    self->window_count = fits[best].count;
    self->noise_q8 = per_message(self, fits[best].count, 10);
    self->wander_q8 = root(wander) * 5 / 4;
    self->doubt_windows_us = 0;
    for (uint8_t i = 0; i < best; i++) {
        const int64_t apart_q8 = fits[i].line.ahead_q8 - fits[best].line.ahead_q8;
        const uint64_t far_q8 = (uint64_t)(apart_q8 < 0 ? -apart_q8 : apart_q8);
        const uint32_t chance_q8 = per_message(self, fits[i].count, 24);
        if (far_q8 > chance_q8) {
            const uint32_t far_us = at_most(far_q8 / Q8, LATE_US);
            self->doubt_windows_us = far_us > self->doubt_windows_us ? far_us : self->doubt_windows_us;
        }
    }
}

/// By how much the newest blocks lie below the line when that is no chance; history that they contradict for
/// long enough is given up.
static void starve(clock_track_t *self) {
    self->doubt_blocks_us = 0;
    uint32_t count = 0;
    int64_t gap_q8 = INT64_MAX;
    for (uint8_t i = 0; i < 8 && i < self->blocks_fill; i++) {
        const uint8_t at = (uint8_t)(self->blocks_fill - 1 - i);
        const clock_block_t *block = &self->blocks[at];
        const int64_t each_q8 = line_at(&self->line, block->gap8_us) - (int64_t)block->ahead_us * Q8;
        gap_q8 = each_q8 < gap_q8 ? each_q8 : gap_q8;
        count += block->count;
        if (gap_q8 <= 0) {
            return;
        }
        const uint64_t weight = (uint64_t)gap_q8 * count;
        if (count >= 2 && weight > (uint64_t)DOUBT * self->mean_q8) {
            const uint32_t gap_us = at_most((uint64_t)gap_q8 / Q8, LATE_US);
            self->doubt_blocks_us = gap_us > self->doubt_blocks_us ? gap_us : self->doubt_blocks_us;
        }
        if (weight > (uint64_t)STARVED * self->mean_q8 && at > 0 && count >= 2 * MESSAGES_MIN &&
            block->gap8_us < -STARVED_BLOCKS_US + BLOCK_LAST_US) {
            if (gap_q8 > (int64_t)LEAP_US * Q8) {
                self->leaps++;
                self->first = false;
            }
            self->young = true;
            self->begin_gap8_us = self->anchor_gap8_us;
            self->skewed = false;
            drop_oldest(self, at);
            choose(self);
            return;
        }
    }
}

static void close_block(clock_track_t *self, int32_t gap8_us) {
    const int32_t after_us = gap8_us - self->open.gap8_us;
    push_block(self);
    open_block(self, after_us);
    uint32_t count = 0;
    for (uint8_t i = 0; i < self->blocks_fill && count < MESSAGES_MIN; i++) {
        count += self->blocks[i].count;
    }
    if (count >= MESSAGES_MIN && self->blocks_fill >= 2) {
        choose(self);
        self->fitted = true;
        starve(self);
    }
    self->doubt_early_blocks = (uint8_t)(self->doubt_early_blocks < 2 ? self->doubt_early_blocks + 1 : 2);
    self->doubt_early_us = self->doubt_early_blocks < 2 ? self->doubt_early_us : 0;
    if (self->window_us >= SKEW_KNOWN_US) {
        self->skewed = true;
        self->skew_q31 = self->line.skew_q31;
    }
    self->young = self->young && passed(self->begin_gap8_us, self->last_gap8_us) < CLOCK_YOUNG_US;
}

/// The newest messages, none of them queued behind another: so many in a row so late are no chance.
static void remember(clock_track_t *self, int64_t above_q8) {
    self->recent_head = (uint8_t)((self->recent_head + 1) % CLOCK_RECENT);
    self->recent_q8[self->recent_head] = above_q8;
    self->recent_fill = (uint8_t)(self->recent_fill < CLOCK_RECENT ? self->recent_fill + 1 : CLOCK_RECENT);
    self->doubt_recent_us = 0;
    int64_t gap_q8 = INT64_MAX;
    for (uint8_t i = 0; i < self->recent_fill; i++) {
        const int64_t each = -self->recent_q8[(self->recent_head + CLOCK_RECENT - i) % CLOCK_RECENT];
        gap_q8 = each < gap_q8 ? each : gap_q8;
        if (i > 0 && gap_q8 * (i + 1) > (int64_t)self->mean_q8 * DOUBT) {
            const uint32_t gap_us = (uint32_t)(gap_q8 / Q8);
            self->doubt_recent_us = gap_us > self->doubt_recent_us ? gap_us : self->doubt_recent_us;
        }
    }
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
    if (self->open.count == 0 || above_q8 > self->open_best_q8) {
        self->open_best_q8 = above_q8;
        self->open.gap8_us = reading->gap8_us;
        self->open.ahead_us = (int32_t)reading->ahead_us;
    }
    self->open.count = (uint16_t)(self->open.count < UINT16_MAX / 4 ? self->open.count + 1 : UINT16_MAX / 4);
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
    if (passed(self->anchor_gap8_us, gap8_us) < 0 ||
        passed(self->anchor_gap8_us, gap8_us) > 2 * CLOCK_AGE_MAX_US) {
        begin_epoch(self, stm32_us, gap8_us, epoch);
    }
    reading_t reading = read_at(self, stm32_us, gap8_us);
    const int64_t early_us =
        self->fitted ? 2 * (int64_t)((self->noise_q8 + self->wander_q8) / Q8) + EARLY_US : LATE_US;
    if (reading.above_q8 > early_us * Q8 || reading.above_q8 < -(int64_t)LATE_US * Q8) {
        hold(self, stm32_us, gap8_us);
        return;
    }
    self->held_fill = 0;
    self->used_gap8_us = gap8_us;
    if (self->open.count > 0 && reading.gap8_us - self->open_begin_us >= (int32_t)self->block_us) {
        close_block(self, reading.gap8_us);
        reading = read_at(self, stm32_us, gap8_us);
    }
    use(self, &reading, step_us < QUEUED_US);
}

/// Between the ticks: frames come at one rate, and the least squares line through their readings is finer
/// than a tick. In us * 256 after gap8_us.
static uint32_t between_ticks(clock_track_t *self, uint64_t gap8_us) {
    const uint32_t whole_q8 = tick_q8(self);
    const uint32_t now_us = (uint32_t)gap8_us;
    const int64_t tick_us = whole_q8 / Q8 + 1;
    if (self->frames_fill > 1) {
        const uint32_t last_us = self->frames_gap8_us[self->frames_head];
        const uint32_t before_us =
            self->frames_gap8_us[(self->frames_head + CLOCK_FRAMES - 1) % CLOCK_FRAMES];
        const int64_t change_us = (int64_t)(int32_t)(now_us - last_us) - (int32_t)(last_us - before_us);
        if (change_us > 2 * tick_us || change_us < -2 * tick_us) {
            self->frames_fill = 0;
        }
    }
    self->frames_head = (uint8_t)((self->frames_head + 1) % CLOCK_FRAMES);
    self->frames_gap8_us[self->frames_head] = now_us;
    self->frames_fill = (uint8_t)(self->frames_fill < CLOCK_FRAMES ? self->frames_fill + 1 : CLOCK_FRAMES);
    const int64_t count = self->frames_fill;
    int64_t sum = 0;
    int64_t moment = 0;
    for (uint8_t i = 0; i < self->frames_fill; i++) {
        const int64_t each =
            (int32_t)(self->frames_gap8_us[(self->frames_head + CLOCK_FRAMES - i) % CLOCK_FRAMES] - now_us);
        sum += each;
        moment += each * i;
    }
    if (count < 3) {
        return whole_q8 / 2;
    }
    // At i = 0 of y = a + b i over i = 0..count-1: a = 2 ((2 n - 1) sum - 3 moment) / (n (n + 1)).
    const int64_t end_q8 = 2 * ((2 * count - 1) * sum - 3 * moment) * Q8 / (count * (count + 1));
    const int64_t here_q8 = end_q8 + whole_q8 / 2;
    return here_q8 < 0 ? 0 : at_most((uint64_t)here_q8, whole_q8);
}

/// By how much the line may be wrong, by what does not agree with it.
static uint32_t doubt_us(const clock_track_t *self) {
    const uint32_t each[] = {self->doubt_recent_us, self->doubt_blocks_us, self->doubt_windows_us,
                             self->doubt_early_us};
    uint32_t most = 0;
    for (uint8_t i = 0; i < sizeof each / sizeof each[0]; i++) {
        most = each[i] > most ? each[i] : most;
    }
    return most;
}

/// For how long the line has been used beyond the blocks that it goes through, more than blocks take anyway.
static uint32_t reach_us(const clock_track_t *self, uint64_t gap8_us) {
    const int64_t beyond_us = (int64_t)passed(self->anchor_gap8_us, gap8_us) - 2 * (int64_t)self->block_us;
    return beyond_us > 0 ? (uint32_t)beyond_us : 0;
}

static uint16_t state_flags(const clock_track_t *self, uint64_t gap8_us, uint32_t age_us) {
    const bool held = self->held_fill > 0 || doubt_us(self) > 0;
    const bool beyond = age_us > HOLDOVER_US || (self->fitted && reach_us(self, gap8_us) > HOLDOVER_US);
    uint32_t flags = 0;
    flags |= self->young && (!self->skewed || !self->fitted) ? FRAME_COLD : 0U;
    flags |= self->young && !self->first ? FRAME_EPOCH_NEW : 0U;
    flags |= self->young && passed(self->begin_gap8_us, gap8_us) < 0 ? FRAME_BEFORE_EPOCH : 0U;
    flags |= beyond ? FRAME_HOLDOVER : 0U;
    flags |= held ? FRAME_QUARANTINE : 0U;
    flags |= self->stuck >= STUCK_MIN ? FRAME_STUCK : 0U;
    flags |= self->known.tick_ns > FINE_NS ? FRAME_QUANTISED : 0U;
    return (uint16_t)flags;
}

/// Of the estimate, either side. A line beyond its end is less sure of its offset in proportion, a clock that
/// wanders by the square.
static uint64_t bound_us(const clock_track_t *self, uint64_t gap8_us) {
    const uint64_t reach_q8 = Q8 + (uint64_t)reach_us(self, gap8_us) * 2 * Q8 / (self->window_us + 1);
    const uint64_t wander_q8 = self->wander_q8 * reach_q8 / Q8 * reach_q8 / Q8;
    const uint32_t ticks = self->known.tick_ns > COARSE_NS ? 2 : 1;
    const uint32_t ticks_q8 = ticks * tick_q8(self);
    return (self->noise_q8 * reach_q8 / Q8 + wander_q8 + ticks_q8) / Q8 + 1 + doubt_us(self);
}

void clock_track_stamp(clock_track_t *self, uint64_t gap8_us, clock_time_t *time) {
    memset(time, 0, sizeof *time);
    const bool coarse = self->known.tick_ns > FINE_NS;
    const int64_t shift_q8 = coarse ? (int64_t)between_ticks(self, gap8_us) : Q8 / 2;
    time->flags = FRAME_REFUSED | FRAME_COLD;
    time->age_us = UINT32_MAX;
    time->bound_us = UINT32_MAX;
    if (!self->anchored) {
        return;
    }
    const int32_t since_us = passed(self->used_gap8_us, gap8_us);
    self->expired = self->expired || since_us > CLOCK_AGE_MAX_US || since_us < -(int32_t)LATE_US;
    time->epoch = self->epoch;
    time->age_us = self->expired ? UINT32_MAX - 1 : since_us > 0 ? (uint32_t)since_us : 0;
    time->flags = state_flags(self, gap8_us, time->age_us);
    if (self->expired || !self->fitted || self->held_fill > 1 || (time->flags & FRAME_BEFORE_EPOCH) != 0) {
        time->flags |= FRAME_REFUSED;
        return;
    }
    const uint64_t bound = bound_us(self, gap8_us);
    if (bound > CLOCK_BOUND_MAX_US) {
        time->flags |= FRAME_REFUSED;
        return;
    }
    time->bound_us = (uint32_t)bound;
    const int32_t after_us = passed(self->anchor_gap8_us, gap8_us);
    const int64_t delay_q8 = (int64_t)((uint64_t)self->known.delay_ns * Q8 / 1000);
    const int32_t line_us = after_us + (int32_t)(self->known.delay_ns / 1000);
    // Both readings of a message are rounded down, and the earliest of many shows it.
    const int64_t rounded_q8 = coarse ? (int64_t)tick_q8(self) - Q8 / 2 : Q8 / 4;
    const int64_t ahead_q8 = line_at(&self->line, line_us) + delay_q8 + shift_q8 - rounded_q8 + Q8 / 2;
    const int64_t floor_us = ahead_q8 >= 0 ? ahead_q8 / Q8 : -((Q8 - 1 - ahead_q8) / Q8);
    time->stm32_us = self->anchor_stm32_us + (uint64_t)((int64_t)after_us + floor_us);
    time->flags |= FRAME_HAS_ESTIMATE | FRAME_HAS_BOUND;
    time->window_us = self->window_us;
    time->window_count = self->window_count;
    time->mean_us = self->mean_q8 / Q8;
    time->skew_ppb = (int32_t)((int64_t)self->line.skew_q31 * 1000000000 / ((int64_t)1 << 31));
}
