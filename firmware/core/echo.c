#include "echo.h"

#include "checks.h"

enum { START_BYTES = 2, CHECK_BYTES = 2 };

static uint16_t check(const uint8_t *message, size_t size) {
    return crc16_ccitt_false((bytes_t){message + START_BYTES, size - START_BYTES - CHECK_BYTES});
}

static void frame(uint8_t *message, uint8_t kind, size_t size) {
    message[0] = STAMP_SYNC_0;
    message[1] = kind;
    store16_le(message + size - CHECK_BYTES, check(message, size));
}

static int framed(bytes_t in, uint8_t kind, size_t size) {
    if ((in.size > 0 && in.data[0] != STAMP_SYNC_0) || (in.size > 1 && in.data[1] != kind)) {
        return ERR_START;
    }
    if (in.size < size) {
        return ERR_SHORT;
    }
    return load16_le(in.data + size - CHECK_BYTES) == check(in.data, size) ? (int)size : ERR_CHECK;
}

void echo_question_encode(uint8_t number, uint8_t out[5]) {
    out[START_BYTES] = number;
    frame(out, ECHO_QUESTION, ECHO_QUESTION_BYTES);
}

int echo_question_decode(bytes_t in, uint8_t *number) {
    const int result = framed(in, ECHO_QUESTION, ECHO_QUESTION_BYTES);
    if (result > 0) {
        *number = in.data[START_BYTES];
    }
    return result;
}

void echo_answer_encode(const echo_answer_t *answer, uint8_t out[17]) {
    out[2] = answer->number;
    store64_le(out + 3, answer->received_stm32_us);
    store32_le(out + 11, answer->held_us);
    frame(out, ECHO_ANSWER, ECHO_ANSWER_BYTES);
}

int echo_answer_decode(bytes_t in, echo_answer_t *answer) {
    const int result = framed(in, ECHO_ANSWER, ECHO_ANSWER_BYTES);
    if (result > 0) {
        *answer = (echo_answer_t){
            .number = in.data[2],
            .received_stm32_us = load64_le(in.data + 3),
            .held_us = load32_le(in.data + 11),
        };
    }
    return result;
}
