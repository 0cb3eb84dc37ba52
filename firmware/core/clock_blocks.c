#include "clock_parts.h"

#include <string.h>

enum {
    BLOCK_FIRST_US = 31250,
    HISTORY_MAX_US = 20000000,
};

static void open_block(clock_track_t *self, int32_t gap8_us) {
    self->open = (clock_block_t){0};
    self->sums = (clock_sums_t){0};
    self->open_begin_us = gap8_us;
}

void clock_track_blocks_begin(clock_track_t *self) {
    self->blocks_fill = 0;
    self->means.count = 0;
    self->block_us = BLOCK_FIRST_US;
    open_block(self, 0);
}

void clock_track_blocks_add(clock_track_t *self, int32_t gap8_us, int32_t ahead_us, int64_t above_q8) {
    if (is_coarse(self)) {
        clock_track_scatter_add(self, gap8_us, ahead_us, above_q8);
    }
    if (self->open.count == 0 || above_q8 > self->open_best_q8) {
        self->open_best_q8 = above_q8;
        self->open.gap8_us = gap8_us;
        self->open.ahead_us = ahead_us;
    }
    self->open.count = (uint16_t)(self->open.count < UINT16_MAX / 4 ? self->open.count + 1 : UINT16_MAX / 4);
}

void clock_track_blocks_drop(clock_track_t *self, uint8_t count) {
    self->blocks_fill = (uint8_t)(self->blocks_fill - count);
    memmove(self->blocks, self->blocks + count, self->blocks_fill * sizeof self->blocks[0]);
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
    clock_block_t better = a_q8 > b_q8 ? a : b;
    const int64_t apart_us = (a_q8 > b_q8 ? a_q8 - b_q8 : b_q8 - a_q8) / Q8;
    clock_track_scatter_merge(&better, a_q8 > b_q8 ? &b : &a, apart_us);
    better.count = (uint16_t)at_most((uint64_t)a.count + b.count, UINT16_MAX / 2);
    return better;
}

void clock_track_blocks_close(clock_track_t *self, int32_t gap8_us) {
    self->means.count = 0;
    if (is_coarse(self)) {
        clock_track_scatter_close(self);
    }
    const int32_t after_us = gap8_us - self->open.gap8_us;
    if (self->blocks_fill == CLOCK_BLOCKS && self->block_us < BLOCK_LAST_US) {
        for (uint8_t i = 0; i < CLOCK_BLOCKS / 2; i++) {
            self->blocks[i] = merged(&self->line, self->blocks[2 * i], self->blocks[2 * i + 1]);
        }
        self->blocks_fill = CLOCK_BLOCKS / 2;
        self->block_us *= 2;
        // A window of so many blocks is now as long as the next was.
        self->apart[0] = self->apart[1];
        self->apart[1] = self->apart[2];
    } else if (self->blocks_fill == CLOCK_BLOCKS) {
        clock_track_blocks_drop(self, 1);
    }
    self->blocks[self->blocks_fill++] = self->open;
    rebase(self);
    uint8_t old = 0;
    while (self->blocks[old].gap8_us < -HISTORY_MAX_US) {
        old++;
    }
    clock_track_blocks_drop(self, old);
    open_block(self, after_us);
}
