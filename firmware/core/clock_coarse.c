#include "clock_parts.h"

enum {
    LATE_MEANS = 5,     ///< a message later than so many is left out,
    LATE_SHARE = 8,     ///< one of so many,
    LATE_MORE = 2,      ///< and some by chance
    Y_MAX_US = 1 << 17, ///< of a block's messages among each other
    UNFIT = UINT16_MAX, ///< spread of a block that nothing can be said of
    WEIGHT_MAX = 255,   ///< of a block
    STEP_US = 1024,     ///< unit of a line's x
    OFF_MAX_Q8 = 1 << 25,
    BLOCKS_MIN = 16, ///< for a line of means,
    MEANS_MIN = 100, ///< messages, too
    PASSES = 3,      ///< the later ones without blocks that do not belong to the others:
    SPREAD_MOST = 9, ///< the square of their spread is more than so many times that of all,
    FAR_MOST = 16, ///< or that of their mean from the line more than so many times its variance: 4 deviations
    BENT = 2,      ///< all of them together: 5 deviations of 64 blocks, 3 of 16
    UNEVEN_10THS = 25, ///< delays have changed: by so much the newest quarter's square is not that of all
    OFF_MOST = 5,      ///< in halves of the deviation of a line's end
    SWAY = 10,         ///< of a tick: phases that sweep it slowly make means sway by 1/20 either way
    TOPS = 3,          ///< blocks that show that the line is too low
};

void clock_moments_add(clock_moments_t *self, int64_t weight, int64_t x, int64_t y) {
    self->weight += weight;
    self->x += weight * x;
    self->y += weight * y;
    self->xx += weight * x * x;
    self->xy += weight * x * y;
}

clock_least_squares_t clock_moments_line(const clock_moments_t *self) {
    clock_least_squares_t line = {self->x / self->weight, self->y / self->weight, 0};
    // About the whole mean_x; what it is less than the mean by is taken into account, or constants would
    // tilt.
    const int64_t rest = self->x - line.mean_x * self->weight;
    const int64_t xx = self->xx - line.mean_x * (self->x + rest) - rest * rest / self->weight;
    const int64_t xy = self->xy - line.mean_x * self->y - rest * self->y / self->weight;
    if (xx > 0) {
        line.slope_q16 = xy / xx * 65536 + xy % xx * 65536 / xx;
        line.mean_y -= line.slope_q16 * rest / self->weight / 65536;
    }
    return line;
}

int64_t clock_least_squares_at(const clock_least_squares_t *self, int64_t x) {
    return self->mean_y + self->slope_q16 * (x - self->mean_x) / 65536;
}

/// From the block's first message, along the line.
static int64_t after_first_us(const clock_track_t *self, int32_t gap8_us, int32_t ahead_us) {
    const int64_t skew_us =
        (int64_t)self->line.skew_q31 * (gap8_us - self->sums.gap8_us) / ((int64_t)1 << 31);
    return (int64_t)ahead_us - self->sums.ahead_us - skew_us;
}

void clock_track_scatter_add(clock_track_t *self, int32_t gap8_us, int32_t ahead_us, int64_t above_q8) {
    clock_sums_t *sums = &self->sums;
    if (sums->count == 0) {
        sums->gap8_us = gap8_us;
        sums->ahead_us = ahead_us;
    }
    const int64_t y_us = after_first_us(self, gap8_us, ahead_us);
    const bool late = self->fitted && -above_q8 > (int64_t)self->mean_q8 * LATE_MEANS + tick_q8(self);
    if (late || y_us > Y_MAX_US || y_us < -Y_MAX_US) {
        sums->late = (uint16_t)at_most(sums->late + 1U, UINT16_MAX);
    } else if (sums->count < UINT16_MAX / 4) {
        sums->count++;
        sums->y_us += y_us;
        sums->square_us += (uint64_t)(y_us * y_us);
    }
}

void clock_track_scatter_close(clock_track_t *self) {
    const clock_sums_t *sums = &self->sums;
    clock_block_t *block = &self->open;
    block->spread_us = UNFIT;
    if (sums->count < 2 || sums->late > sums->count / LATE_SHARE + LATE_MORE) {
        return;
    }
    const int64_t below_us = after_first_us(self, block->gap8_us, block->ahead_us) - sums->y_us / sums->count;
    const uint64_t chance = (uint64_t)(sums->y_us * sums->y_us) / sums->count;
    const uint64_t square = (sums->square_us > chance ? sums->square_us - chance : 0) / (sums->count - 1U);
    block->below_us = (uint16_t)(below_us < 0 ? 0 : at_most((uint64_t)below_us, UINT16_MAX));
    block->spread_us = (uint16_t)at_most(clock_root(square), UNFIT);
}

void clock_track_scatter_merge(clock_block_t *better, const clock_block_t *other, int64_t apart_us) {
    const uint64_t count = (uint64_t)better->count + other->count;
    const uint64_t below =
        (uint64_t)better->below_us * better->count + (other->below_us + (uint64_t)apart_us) * other->count;
    const uint64_t square = (uint64_t)better->spread_us * better->spread_us * better->count +
                            (uint64_t)other->spread_us * other->spread_us * other->count;
    better->below_us = (uint16_t)at_most(below / count, UINT16_MAX);
    better->spread_us = better->spread_us == UNFIT || other->spread_us == UNFIT
                            ? UNFIT
                            : (uint16_t)at_most(clock_root(square / count), UNFIT);
}

typedef struct {
    clock_least_squares_t line; ///< of blocks' means from the edge, in us * 256
    uint64_t square_us;         ///< messages' mean square about them,
    uint64_t ticks_us;          ///< and of those about the line, if ticks are most of it
    uint32_t count;             ///< messages
} fit_t;

static int64_t weight_of(const clock_block_t *block) {
    return block->count < WEIGHT_MAX ? block->count : WEIGHT_MAX;
}

static uint64_t square_of(const clock_block_t *block) {
    return (uint64_t)block->spread_us * block->spread_us;
}

/// By how much the mean of its messages is above the edge.
static int64_t off_q8(const clock_track_t *self, const clock_block_t *block) {
    const int64_t mean_us = (int64_t)block->ahead_us - block->below_us;
    const int64_t off = mean_us * Q8 - line_at(&self->line, block->gap8_us);
    return off > OFF_MAX_Q8 ? OFF_MAX_Q8 : off < -OFF_MAX_Q8 ? -OFF_MAX_Q8 : off;
}

/// Of its mean from the line, times its messages: delays make it the square of their spread.
static uint64_t deviation_q16(const clock_track_t *self, const clock_block_t *block, const fit_t *fit) {
    const int64_t off = off_q8(self, block) - clock_least_squares_at(&fit->line, block->gap8_us / STEP_US);
    const uint64_t far_q8 = at_most((uint64_t)(off < 0 ? -off : off), 2 * OFF_MAX_Q8);
    return far_q8 * far_q8 * (uint64_t)weight_of(block);
}

/// Of the newest blocks. False: they are not those of one straight line and of one kind of delays.
static bool fit(const clock_track_t *self, uint8_t blocks, fit_t *fit) {
    const clock_block_t *from = self->blocks + self->blocks_fill - blocks;
    const uint64_t ticks_us = (uint64_t)tick_q8(self) * tick_q8(self) / (12 * Q8 * Q8);
    uint64_t kept = UINT64_MAX;
    for (uint8_t pass = 0; pass < PASSES; pass++) {
        clock_moments_t moments = {0};
        uint64_t square = 0;
        for (uint8_t i = 0; i < blocks; i++) {
            if (from[i].spread_us == UNFIT) {
                kept &= ~((uint64_t)1 << i);
            } else if ((kept >> i & 1) != 0) {
                const int64_t weight = weight_of(&from[i]);
                clock_moments_add(&moments, weight, from[i].gap8_us / STEP_US, off_q8(self, &from[i]));
                square += square_of(&from[i]) * (uint64_t)weight;
            }
        }
        if (moments.weight == 0) {
            return false;
        }
        *fit = (fit_t){.line = clock_moments_line(&moments),
                       .square_us = square / (uint64_t)moments.weight + 1,
                       .count = (uint32_t)moments.weight};
        fit->ticks_us = fit->square_us < 2 * ticks_us ? ticks_us : 0;
        const uint64_t each_us = fit->square_us + fit->ticks_us;
        for (uint8_t i = 0; i < blocks && pass + 1 < PASSES; i++) {
            const uint64_t most_us = fit->square_us + fit->ticks_us * (uint64_t)weight_of(&from[i]);
            if (square_of(&from[i]) > each_us * SPREAD_MOST ||
                deviation_q16(self, &from[i], fit) > most_us * Q8 * Q8 * FAR_MOST) {
                kept &= ~((uint64_t)1 << i);
            }
        }
    }
    uint64_t deviation = 0;
    uint64_t newest_square = 0;
    uint32_t newest = 0;
    uint32_t newest_all = 0;
    uint32_t all = 0;
    uint32_t points = 0;
    for (uint8_t i = 0; i < blocks; i++) {
        const uint32_t weight = (uint32_t)weight_of(&from[i]);
        const bool is_newest = i >= blocks - blocks / 4;
        all += weight;
        newest_all += is_newest ? weight : 0;
        if ((kept >> i & 1) != 0) {
            points++;
            deviation += deviation_q16(self, &from[i], fit) / (Q8 * Q8);
            newest += is_newest ? weight : 0;
            newest_square += is_newest ? square_of(&from[i]) * weight : 0;
        }
    }
    if (fit->count * 4 < all * 3 || newest * 4 < newest_all * 3 || (kept >> (blocks - 1) & 1) == 0) {
        return false;
    }
    const uint64_t newest_us = newest_square / newest + fit->ticks_us;
    const uint64_t all_us = fit->square_us + fit->ticks_us;
    return deviation <= (fit->square_us * points + fit->ticks_us * fit->count) * BENT &&
           newest_us * 10 <= all_us * UNEVEN_10THS && all_us * 10 <= newest_us * UNEVEN_10THS;
}

/// By how much a line's end may be off.
static uint32_t off_most_q8(const fit_t *fit) {
    return OFF_MOST * clock_root(fit->square_us * Q8 * Q8 / fit->count) + clock_root(fit->ticks_us * Q8 * Q8);
}

/// The line of the newest blocks, if those of their halves agree with it.
static bool agreed(const clock_track_t *self, uint8_t blocks, fit_t *longest) {
    if (blocks < BLOCKS_MIN || !fit(self, blocks, longest) || longest->count < MEANS_MIN) {
        return false;
    }
    for (uint8_t half = blocks / 2; half >= BLOCKS_MIN; half /= 2) {
        fit_t each;
        if (!fit(self, half, &each)) {
            return false;
        }
        const int64_t apart_q8 =
            clock_least_squares_at(&each.line, 0) - clock_least_squares_at(&longest->line, 0);
        if ((apart_q8 < 0 ? -apart_q8 : apart_q8) > off_most_q8(&each) + tick_q8(self) / SWAY) {
            return false;
        }
    }
    return true;
}

void clock_track_means(clock_track_t *self) {
    self->means.count = 0;
    if (!is_coarse(self)) {
        return;
    }
    fit_t longest;
    if (!agreed(self, self->blocks_fill, &longest) && !agreed(self, self->blocks_fill / 2, &longest)) {
        return;
    }
    const uint64_t ticks_q16 = (uint64_t)tick_q8(self) * tick_q8(self) / 12;
    const uint64_t square_q16 = longest.square_us * Q8 * Q8;
    const uint32_t mean_q8 = square_q16 > ticks_q16 ? clock_root(square_q16 - ticks_q16) : 0;
    clock_line_t line = {
        self->line.ahead_q8 + clock_least_squares_at(&longest.line, 0) + mean_q8 + tick_q8(self) / 2,
        clamp_skew(self->line.skew_q31 + longest.line.slope_q16 * ((1 << 23) / 65536) / STEP_US)};
    // Where delays are not exponential the earliest messages may be above it.
    int64_t above_q8[TOPS] = {0};
    for (uint8_t i = 0; i < self->blocks_fill; i++) {
        const clock_block_t *block = &self->blocks[i];
        int64_t each_q8 = (int64_t)block->ahead_us * Q8 - line_at(&line, block->gap8_us);
        for (uint8_t j = 0; j < TOPS && each_q8 < tick_q8(self) / 2; j++) {
            const int64_t lower_q8 = above_q8[j] < each_q8 ? above_q8[j] : each_q8;
            above_q8[j] = above_q8[j] < each_q8 ? each_q8 : above_q8[j];
            each_q8 = lower_q8;
        }
    }
    line.ahead_q8 += above_q8[TOPS - 1];
    self->means = (clock_means_t){line, 2 * off_most_q8(&longest), longest.count};
}

clock_line_t clock_track_line(const clock_track_t *self, int32_t gap8_us) {
    const int64_t edge_q8 = line_at(&self->line, gap8_us);
    int64_t above_q8 = line_at(&self->means.line, gap8_us) - edge_q8;
    const int64_t tick = tick_q8(self);
    above_q8 = above_q8 > tick ? tick : above_q8 < -tick / 2 ? -tick / 2 : above_q8;
    return (clock_line_t){self->line.ahead_q8 + above_q8, self->line.skew_q31};
}
