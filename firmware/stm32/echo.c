#include "parts.h"

#include <string.h>

enum {
    /// The stamp clock, which may count 84 of 85, keeps to uptime within 1/64 of what has passed, and two
    /// readings' worth.
    RATE_SHIFT = 6,
    READINGS_US = 2,
};

void stm32_echo_hear(stm32_t *self, uint8_t byte, instant_t now) {
    stm32_echo_t *echo = &self->echo;
    memmove(echo->heard, echo->heard + 1, ECHO_QUESTION_BYTES - 1);
    echo->heard[ECHO_QUESTION_BYTES - 1] = byte;
    uint8_t number;
    if (echo_question_decode((bytes_t){echo->heard, ECHO_QUESTION_BYTES}, &number) < 0 ||
        self->config.stamp_format != STM32_NATIVE) {
        return;
    }
    echo->waits = true;
    echo->number = number;
    echo->received = now;
}

uint8_t stm32_echo_answer(stm32_t *self, instant_t now) {
    stm32_echo_t *echo = &self->echo;
    if (!echo->waits) {
        return 0;
    }
    echo->waits = false;
    const uint64_t held_us = now.stamp_us - echo->received.stamp_us;
    const uint64_t passed_us = now.up_us - echo->received.up_us;
    const uint64_t apart_us = held_us > passed_us ? held_us - passed_us : passed_us - held_us;
    if (apart_us > (passed_us >> RATE_SHIFT) + READINGS_US) {
        return 0; // it was set meanwhile
    }
    const echo_answer_t answer = {echo->number, echo->received.stamp_us, (uint32_t)held_us};
    echo_answer_encode(&answer, self->stamp);
    return ECHO_ANSWER_BYTES;
}
