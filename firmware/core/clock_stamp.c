#include "clock_parts.h"

#include "image.h"

#include <string.h>

enum {
    HOLDOVER_US = 250000,
    STUCK_MIN = 3,
    SLOW_Q31 = -25264513, ///< skew of an STM32 clock that counts 84 where 85 have passed: -2^31 / 85
};

/// By how much the line may be wrong, by what does not agree with it.
static uint32_t doubt_us(const clock_track_t *self) {
    const uint32_t each[] = {self->doubt_recent_us, self->doubt_blocks_us, self->doubt_windows_us,
                             self->doubt_early_us,  self->doubt_sag_us,    self->doubt_stray_us};
    uint32_t most = 0;
    for (uint8_t i = 0; i < sizeof each / sizeof each[0]; i++) {
        most = each[i] > most ? each[i] : most;
    }
    return most;
}

/// The line of coarse ticks' means is of use as long as nothing speaks against the edge.
static bool has_means(const clock_track_t *self) {
    return self->means.count > 0 && doubt_us(self) == 0;
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
static uint64_t bound_us(const clock_track_t *self, uint64_t gap8_us, uint32_t spread_q8) {
    const uint64_t reach_q8 = Q8 + (uint64_t)reach_us(self, gap8_us) * 2 * Q8 / (self->window_us + 1);
    if (has_means(self)) {
        return (self->means.noise_q8 * reach_q8 / Q8 + tick_q8(self) + spread_q8) / Q8 + 1;
    }
    const uint64_t wander_q8 = self->wander_q8 * reach_q8 / Q8 * reach_q8 / Q8;
    const uint32_t ticks_q8 = is_coarse(self) ? 2 * tick_q8(self) : tick_q8(self);
    return (self->noise_q8 * reach_q8 / Q8 + wander_q8 + ticks_q8 + spread_q8) / Q8 + 1 + doubt_us(self);
}

/// The known delay in GAP8 time. It is the STM32's crystal that sets it, and of the two clocks' skew only
/// what the divider of the stamp clock does not explain is its own.
static int64_t delay_q8(const clock_track_t *self) {
    const int64_t whole_q8 = (int64_t)((uint64_t)self->known.delay_ns * Q8 / 1000);
    const int64_t right = self->line.skew_q31;
    const int64_t slow = right - SLOW_Q31;
    const int64_t skew = (slow < 0 ? -slow : slow) < (right < 0 ? -right : right) ? slow : right;
    return whole_q8 - whole_q8 * skew / ((int64_t)1 << 31);
}

void clock_track_stamp(clock_track_t *self, uint64_t gap8_us, bool regular, clock_time_t *time) {
    memset(time, 0, sizeof *time);
    const bool coarse = self->known.tick_ns > FINE_NS;
    const clock_reading_t reading = clock_track_frame(self, gap8_us, regular);
    time->flags = FRAME_REFUSED | FRAME_COLD;
    time->age_us = UINT32_MAX;
    time->bound_us = UINT32_MAX;
    if (!self->anchored) {
        return;
    }
    const int32_t since_us = passed(self->used_gap8_us, gap8_us);
    const bool long_ago = gap8_us > self->used_gap8_us && gap8_us - self->used_gap8_us > EXPIRED_US;
    self->expired = self->expired || long_ago || since_us > EXPIRED_US || since_us < -(int32_t)LATE_US;
    time->epoch = self->epoch;
    time->age_us = self->expired ? UINT32_MAX - 1 : since_us > 0 ? (uint32_t)since_us : 0;
    time->flags = state_flags(self, gap8_us, time->age_us);
    if (self->expired || since_us > CLOCK_AGE_MAX_US || !self->fitted || self->held_fill > 1 ||
        (time->flags & FRAME_BEFORE_EPOCH) != 0) {
        time->flags |= FRAME_REFUSED;
        return;
    }
    const uint64_t bound = bound_us(self, gap8_us, reading.spread_q8);
    if (bound > CLOCK_BOUND_MAX_US) {
        time->flags |= FRAME_REFUSED;
        return;
    }
    time->bound_us = (uint32_t)bound;
    const int32_t after_us = passed(self->anchor_gap8_us, gap8_us);
    const int64_t after_q8 = delay_q8(self);
    const int32_t line_us = after_us + (int32_t)(after_q8 / Q8);
    // Both readings of a message are rounded down, and the earliest of many shows it.
    const int64_t rounded_q8 = coarse ? (int64_t)tick_q8(self) - Q8 / 2 : Q8 / 4;
    const clock_line_t line = has_means(self) ? clock_track_line(self, line_us) : self->line;
    const int64_t ahead_q8 = line_at(&line, line_us) + after_q8 + reading.shift_q8 - rounded_q8 + Q8 / 2;
    const int64_t floor_us = ahead_q8 >= 0 ? ahead_q8 / Q8 : -((Q8 - 1 - ahead_q8) / Q8);
    const uint64_t stm32_us = self->anchor_stm32_us + (uint64_t)((int64_t)after_us + floor_us);
    // A clock of few bits wraps: the reading that is nearest to a message's.
    time->stm32_us = self->used_stm32_us + (uint64_t)(int64_t)passed(self->used_stm32_us, stm32_us);
    time->latency_us = reading.spread_q8 / Q8;
    time->flags |= FRAME_HAS_ESTIMATE | FRAME_HAS_BOUND;
    time->window_us = self->window_us;
    time->window_count = self->window_count;
    time->mean_us = self->mean_q8 / Q8;
    time->skew_ppb = (int32_t)((int64_t)self->line.skew_q31 * 1000000000 / ((int64_t)1 << 31));
}
