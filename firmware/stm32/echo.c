#include "parts.h"

#include <string.h>

void stm32_echo_hear(stm32_t *self, uint8_t byte, uint64_t stamp_us) {
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
    echo->received_us = stamp_us;
}

uint8_t stm32_echo_answer(stm32_t *self, uint64_t stamp_us) {
    stm32_echo_t *echo = &self->echo;
    if (!echo->waits) {
        return 0;
    }
    echo->waits = false;
    const echo_answer_t answer = {echo->number, echo->received_us, (uint32_t)(stamp_us - echo->received_us)};
    echo_answer_encode(&answer, self->stamp);
    return ECHO_ANSWER_BYTES;
}
