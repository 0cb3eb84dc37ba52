#include "clock_parts.h"

enum {
    WEIGHT_MAX = 255,
    STEP_US = 1024, ///< unit of a line's x
    Y_MAX_Q8 = 1 << 25,
    SCATTER_BLOCKS = 64,
    MEAN_MIN_Q8 = Q8,
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
    const int64_t xx = self->xx - line.mean_x * self->x;
    const int64_t xy = self->xy - line.mean_x * self->y;
    if (xx > 0) {
        line.slope_q16 = xy / xx * 65536 + xy % xx * 65536 / xx;
    }
    return line;
}

uint32_t clock_track_means_below(const clock_track_t *self) {
    return self->mean_q8 + tick_q8(self) / 2;
}

clock_line_t clock_track_means(const clock_track_t *self, uint8_t blocks, bool is_tilted) {
    clock_line_t line = {self->line.ahead_q8, is_tilted ? self->skew_q31 : self->line.skew_q31};
    clock_moments_t moments = {0};
    for (const clock_block_t *block = self->blocks + self->blocks_fill - blocks;
         block != self->blocks + self->blocks_fill; block++) {
        const int64_t off_q8 = (int64_t)block->ahead_us * Q8 - line_at(&line, block->gap8_us);
        const int64_t y_q8 = off_q8 > Y_MAX_Q8 ? Y_MAX_Q8 : off_q8 < -Y_MAX_Q8 ? -Y_MAX_Q8 : off_q8;
        clock_moments_add(&moments, block->count < WEIGHT_MAX ? block->count : WEIGHT_MAX,
                          block->gap8_us / STEP_US, y_q8);
    }
    const clock_least_squares_t among = clock_moments_line(&moments);
    line.ahead_q8 += among.mean_y + clock_track_means_below(self);
    if (!is_tilted) {
        line.ahead_q8 -= among.slope_q16 * among.mean_x / 65536;
        line.skew_q31 = clamp_skew(line.skew_q31 + among.slope_q16 * ((1 << 23) / 65536) / STEP_US);
    }
    return line;
}

void clock_track_scatter(clock_track_t *self) {
    self->scatter_fill =
        (uint8_t)(self->scatter_fill < SCATTER_BLOCKS ? self->scatter_fill + 1 : SCATTER_BLOCKS);
    const uint64_t square_q16 = self->open_sums.square_q16 / self->open.count;
    self->scatter_q16 = (uint64_t)((int64_t)self->scatter_q16 +
                                   ((int64_t)square_q16 - (int64_t)self->scatter_q16) / self->scatter_fill);
    const uint64_t ticks_q16 = (uint64_t)tick_q8(self) * tick_q8(self) / 12;
    const uint32_t mean_q8 = self->scatter_q16 > ticks_q16 ? clock_root(self->scatter_q16 - ticks_q16) : 0;
    self->mean_q8 = mean_q8 > MEAN_MIN_Q8 ? mean_q8 : MEAN_MIN_Q8;
}
