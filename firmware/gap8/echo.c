#include "parts.h"

#include <string.h>

enum {
    /// Of the three readings in a round trip, and of what is rounded off here.
    READING_US = 4,
    /// More than this between question and answer is no echo.
    ROUND_MAX_US = 1000000,
    Q31_BITS = 31,
    /// As a skew, a stamp clock that counts 84 of 85.
    SLOW_Q31 = -25264513,
    KNOWN_US = (int)((ECHO_QUESTION_WIRE_NS + CLOCK_STAMP_WIRE_NS) / 1000),
};

/// What was found of another epoch, or of a wire on which nobody answers any more.
static void forget(gap8_t *self) {
    gap8_echo_t *echo = &self->echo;
    if (self->clock.young || self->clock.expired || echo->unanswered >= GAP8_ECHO_UNANSWERED) {
        echo->count[0] = 0;
        echo->count[1] = 0;
    }
}

void gap8_echo_ask(gap8_t *self, uint64_t up_us) {
    gap8_echo_t *echo = &self->echo;
    forget(self);
    if (self->config.firmware != GAP8_NATIVE || self->config.echo_period_us == 0 || up_us < echo->next_us ||
        echo->left > 0) {
        return;
    }
    echo->next_us = up_us + self->config.echo_period_us;
    echo->waits = false;
    echo->unanswered =
        (uint8_t)(echo->unanswered < GAP8_ECHO_UNANSWERED ? echo->unanswered + 1 : GAP8_ECHO_UNANSWERED);
    echo->number++;
    echo->left = ECHO_QUESTION_BYTES;
    echo_question_encode(echo->number, echo->question);
}

size_t gap8_echo_transmit(gap8_t *self, bytes_mut_t out, uint64_t stamp_us) {
    gap8_echo_t *echo = &self->echo;
    if (echo->left == 0 || out.size == 0) {
        return 0;
    }
    if (echo->left == ECHO_QUESTION_BYTES) {
        echo->asked_us = stamp_us;
        echo->waits = true;
    }
    const size_t size = out.size < echo->left ? out.size : echo->left;
    memcpy(out.data, echo->question + ECHO_QUESTION_BYTES - echo->left, size);
    echo->left = (uint8_t)(echo->left - size);
    return size;
}

static uint64_t size_of(int64_t value) {
    return (uint64_t)(value < 0 ? -value : value);
}

/// By how much the times on the wire may be wrong in this clock's us: the STM32's oscillator is as far from
/// the GAP8's as its stamp clock says, if that counts right, or counts 84 of 85.
static uint32_t rate_us(int32_t skew_q31) {
    const uint64_t right = size_of(skew_q31);
    const uint64_t slow = size_of((int64_t)skew_q31 - SLOW_Q31);
    const uint64_t rate = right < slow ? right : slow;
    return (uint32_t)(rate * KNOWN_US >> Q31_BITS);
}

static uint32_t doubt_us(const gap8_t *self) {
    const uint32_t tick_us = (self->config.stamp_tick_ns + 999) / 1000;
    return READING_US + (tick_us > 1 ? tick_us : 0) + rate_us(self->clock.line.skew_q31);
}

void gap8_echo_take(gap8_t *self, const echo_answer_t *answer, uint64_t stamp_us) {
    gap8_echo_t *echo = &self->echo;
    if (!echo->waits || answer->number != echo->number) {
        return;
    }
    echo->waits = false;
    const uint32_t round_us = (uint32_t)(stamp_us - echo->asked_us); // clocks of 32 bits may wrap
    if (round_us > ROUND_MAX_US || answer->held_us > round_us || !self->clock.fitted || self->clock.young) {
        return;
    }
    const int32_t held_us = (int32_t)answer->held_us -
                            (int32_t)((int64_t)answer->held_us * self->clock.line.skew_q31 >> Q31_BITS);
    const int32_t sum_us = (int32_t)round_us - held_us - KNOWN_US;
    if (sum_us < -(int32_t)doubt_us(self)) {
        return; // one of the clocks was set meanwhile
    }
    if (echo->count[0] == GAP8_ECHO_HALF) {
        echo->count[1] = echo->count[0];
        echo->sum_us[1] = echo->sum_us[0];
        echo->count[0] = 0;
    }
    const uint32_t sum = sum_us > 0 ? (uint32_t)sum_us : 0;
    echo->sum_us[0] = echo->count[0] == 0 || sum < echo->sum_us[0] ? sum : echo->sum_us[0];
    echo->count[0]++;
    echo->unanswered = 0;
}

void gap8_echo_set(gap8_t *self, native_frame_t *header) {
    const gap8_echo_t *echo = &self->echo;
    forget(self);
    header->echoes = (uint32_t)echo->count[0] + echo->count[1];
    if (header->echoes == 0) {
        return;
    }
    const bool newer = echo->count[1] == 0 || (echo->count[0] > 0 && echo->sum_us[0] < echo->sum_us[1]);
    const uint32_t sum_us = echo->sum_us[newer ? 0 : 1];
    header->minimum_delay_us = sum_us / 2;
    header->minimum_delay_error_us = sum_us - sum_us / 2 + doubt_us(self);
}
