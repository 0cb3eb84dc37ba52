#include "clock_parts.h"

enum {
    APART_COUNT = 32, ///< blocks that the means of the shortest window are over
    VOTES_MIN_Q16 = 20000,
    SKEW_KNOWN_US = 4000000, ///< window that makes a skew worth keeping
    SKEW_SPAN_US = 2000000,  ///< shorter ones are of less worth than a skew that was kept
    UNUSUAL = 14,            ///< times the mean square of how far two windows are apart: not the oscillators
    LEAP_US = 1000,          ///< starved by more: a leap, not drift
    MESSAGES_MIN = 8,        ///< for a first line
    SAG = 8,                 ///< as DOUBT, of many blocks
    STRAY_BLOCKS = 12,       ///< since when the rate may be another
    STRAY_SHIFT = 10,        ///< time in 2^10 us
    STRAY_RATE_BITS = 7,
    STARVED = 24,                ///< as DOUBT: history is wrong
    STARVED_BLOCKS_US = 1000000, ///< for so long
};

typedef struct {
    clock_line_t line;
    uint32_t count;
    uint32_t span_us;
} fit_t;

static uint64_t squared(uint64_t value) {
    return value * value;
}

/// b is not above the line from a to c.
static bool below(const clock_block_t *a, const clock_block_t *b, const clock_block_t *c) {
    return ((int64_t)b->ahead_us - a->ahead_us) * ((int64_t)c->gap8_us - a->gap8_us) <=
           ((int64_t)c->ahead_us - a->ahead_us) * ((int64_t)b->gap8_us - a->gap8_us);
}

/// What ticks add: readings spread evenly over one, and few of many are near its end.
static uint32_t tick_error(const clock_track_t *self, uint32_t count) {
    if (self->known.tick_ns <= FINE_NS) {
        return 0;
    }
    return clock_root((uint64_t)tick_q8(self) * self->mean_q8 / count);
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
    uint8_t hull[CLOCK_BLOCKS] = {0};
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
    uint8_t at = 1;
    while (at + 1 < fill && from[hull[at]].gap8_us < middle_us) {
        at++;
    }
    const clock_block_t *left = &from[hull[at - 1]];
    const clock_block_t *right = &from[hull[at]];
    const int64_t skew = ((int64_t)right->ahead_us - left->ahead_us) * ((int64_t)1 << 31) /
                         ((int64_t)right->gap8_us - left->gap8_us);
    result.line.skew_q31 = clamp_skew(skew);
    result.line.ahead_q8 =
        (int64_t)right->ahead_us * Q8 - line_at(&result.line, right->gap8_us) + low_by(self, result.count, 2);
    return result;
}

/// Lines of coarse ticks may be apart by so much when nothing is wrong.
static uint32_t blurred_q8(const clock_track_t *self) {
    return is_coarse(self) ? hidden_q8(self) : 0;
}

/// How far the line of window i + 1 is from that of half its length, at the end of the time that it will
/// serve. Longer windows' lines change less often, so the means are over more.
static void compare(clock_track_t *self, const fit_t *half, const fit_t *whole, uint8_t i) {
    clock_apart_t *apart = &self->apart[i];
    const int32_t horizon_us = 2 * (int32_t)self->block_us;
    const int64_t signed_q8 = line_at(&whole->line, horizon_us) - line_at(&half->line, horizon_us);
    const uint64_t apart_q8 = at_most((uint64_t)(signed_q8 < 0 ? -signed_q8 : signed_q8), (uint32_t)1 << 28);
    const int32_t vote_q16 = apart_q8 > per_message(self, half->count, 8) ? 65536 : 0;
    apart->count = (uint8_t)(apart->count < APART_COUNT << i ? apart->count + 1 : apart->count);
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
    // Where blocks are missing, all of as long a time as they would have taken are the longest window.
    const uint32_t least = self->blocks[0].gap8_us < -CLOCK_BLOCKS * BLOCK_LAST_US ? 5 : 8;
    while (count < CLOCK_WINDOWS && self->blocks_fill >= least << count) {
        const uint32_t most = 8U << count;
        fits[count] = fit(self, (uint8_t)(self->blocks_fill < most ? self->blocks_fill : most));
        compare(self, &fits[count - 1], &fits[count], (uint8_t)(count - 1));
        excess[count] = unexplained(self, &self->apart[count - 1], fits[count - 1].count);
        count++;
    }
    for (uint8_t i = (uint8_t)(count - 1); i > 1; i--) {
        excess[i - 1] = excess[i - 1] > excess[i] / 2 ? excess[i] / 2 : excess[i - 1];
    }
    uint8_t best = 0;
    uint32_t torn_us = 0;
    uint64_t best_cost = squared(per_message(self, fits[0].count, 7)) / 4;
    uint64_t wander = self->apart[0].square_q16 / 4;
    for (uint8_t i = 1; i < count; i++) {
        const clock_apart_t *apart = &self->apart[i - 1];
        if (apart->newest_q8 > per_message(self, fits[i - 1].count, 40)) {
            const bool unusual = squared(apart->newest_q8) > UNUSUAL * apart->square_q16 &&
                                 apart->newest_q8 > blurred_q8(self);
            torn_us = unusual ? at_most(apart->newest_q8 / Q8, LATE_US) : 0;
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
    self->wander_q8 = clock_root(wander) * 5 / 4;
    self->doubt_windows_us = torn_us;
    for (uint8_t i = 0; i < best; i++) {
        const int64_t apart_q8 = fits[i].line.ahead_q8 - fits[best].line.ahead_q8;
        const uint64_t far_q8 = (uint64_t)(apart_q8 < 0 ? -apart_q8 : apart_q8);
        const uint32_t chance_q8 = per_message(self, fits[i].count, 24) + blurred_q8(self);
        if (far_q8 > chance_q8) {
            const uint32_t far_us = at_most(far_q8 / Q8, LATE_US);
            self->doubt_windows_us = far_us > self->doubt_windows_us ? far_us : self->doubt_windows_us;
        }
    }
}

/// By how much a block lies below the line, more than ticks hide.
static int64_t gap(const clock_track_t *self, const clock_block_t *block) {
    return line_at(&self->line, block->gap8_us) - (int64_t)block->ahead_us * Q8 - hidden_q8(self);
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
        const int64_t each_q8 = gap(self, block);
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
            clock_track_blocks_drop(self, at);
            choose(self);
            return;
        }
    }
}

/// By how much the newest blocks of the line's window, however many, are farther below it than chance has it.
/// Of so many messages the least delay, times their count, is exponential as one delay is.
static void sag(clock_track_t *self) {
    self->doubt_sag_us = 0;
    uint64_t sum_q8 = 0;
    uint32_t count = 0;
    for (uint8_t i = 0; i < self->blocks_fill && count < self->window_count; i++) {
        const clock_block_t *block = &self->blocks[self->blocks_fill - 1 - i];
        const int64_t gap_q8 = gap(self, block);
        sum_q8 += (gap_q8 < 0 ? 0 : at_most((uint64_t)gap_q8, LATE_US * Q8)) * (uint64_t)block->count;
        count += block->count;
        const uint64_t over_q8 = clock_late_by_no_chance(self, sum_q8, i + 1U, SAG);
        const uint32_t far_us = at_most(2 * over_q8 / count / Q8, LATE_US);
        self->doubt_sag_us = far_us > self->doubt_sag_us ? far_us : self->doubt_sag_us;
    }
}

/// By how much the newest blocks are late as if the rate had stepped some blocks ago, when that is no chance.
/// They all lie below a straight line that leaves the old one there, and the steepest such touches one of
/// them. How far it is below the old one, summed over all their messages, is exponential as one delay is: no
/// test of these blocks is sharper, if the rate did step there.
static void stray(clock_track_t *self) {
    self->doubt_stray_us = 0;
    uint32_t late_q8[STRAY_BLOCKS];
    for (uint8_t i = 0; i < STRAY_BLOCKS && i < self->blocks_fill; i++) {
        const int64_t gap_q8 = gap(self, &self->blocks[self->blocks_fill - 1 - i]);
        late_q8[i] = gap_q8 > 0 ? at_most((uint64_t)gap_q8, LATE_US * Q8) : 0;
    }
    for (uint8_t since = 2; since <= STRAY_BLOCKS && since < self->blocks_fill; since++) {
        const int32_t begin_us = self->blocks[self->blocks_fill - 1 - since].gap8_us;
        uint32_t least = UINT32_MAX; // rate
        uint64_t weight = 0;
        for (uint8_t i = 0; i < since && least > 0; i++) {
            const clock_block_t *block = &self->blocks[self->blocks_fill - 1 - i];
            const uint32_t after = (uint32_t)(block->gap8_us - begin_us) >> STRAY_SHIFT;
            const uint32_t rate = (late_q8[i] << STRAY_RATE_BITS) / (after + 1);
            least = rate < least ? rate : least;
            weight += (uint64_t)after * block->count;
        }
        if (least * weight >> STRAY_RATE_BITS > (uint64_t)DOUBT * self->mean_q8) {
            const uint32_t now = (uint32_t)-begin_us >> STRAY_SHIFT;
            const uint32_t far_us = at_most(((uint64_t)least * now >> STRAY_RATE_BITS) / Q8, LATE_US);
            self->doubt_stray_us = far_us > self->doubt_stray_us ? far_us : self->doubt_stray_us;
        }
    }
}

void clock_track_window_renew(clock_track_t *self) {
    uint32_t count = 0;
    for (uint8_t i = 0; i < self->blocks_fill && count < MESSAGES_MIN; i++) {
        count += self->blocks[i].count;
    }
    if (count >= MESSAGES_MIN && self->blocks_fill >= 2) {
        choose(self);
        self->fitted = true;
        starve(self);
        sag(self);
        stray(self);
        clock_track_means(self);
    }
    if (self->window_us >= SKEW_KNOWN_US) {
        self->skewed = true;
        self->skew_q31 = self->line.skew_q31;
    }
}
