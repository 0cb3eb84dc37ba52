/// The echo on UART1: the GAP8 asks, the STM32 answers. What both take beyond their bits and the STM32's wait
/// is the sum of the delays both ways, which stamps alone cannot show.
///
/// Question, GAP8 -> STM32: D5 2B | u8 number | u16 CRC. Answer: D5 2C | u8 number | u64 STM32 stamp clock at
/// the question's last stop bit, us | u32 us from then until the answer's first byte starts to leave | u16
/// CRC. Both end with the CRC-16/CCITT-FALSE of what lies between start and CRC. An answer is as long as a
/// stamp message: on the wire they take the same time, and a false start of either never hides the last byte
/// of the other.
#ifndef SPINDECK_CORE_ECHO_H
#define SPINDECK_CORE_ECHO_H

#include "stamp.h"

enum {
    ECHO_QUESTION = 0x2B, ///< second byte; the first is STAMP_SYNC_0
    ECHO_ANSWER = 0x2C,
    ECHO_QUESTION_BYTES = 5,
    ECHO_ANSWER_BYTES = STAMP_BYTES,
    ECHO_QUESTION_WIRE_NS = 434000, ///< 5 bytes of 10 bits at 50 MHz / 434
};

typedef struct {
    uint8_t number; ///< of the question
    uint64_t received_stm32_us;
    uint32_t held_us; ///< and then, until the answer began to leave
} echo_answer_t;

void echo_question_encode(uint8_t number, uint8_t out[5]);
/// ECHO_QUESTION_BYTES, or ERR_SHORT, ERR_START, ERR_CHECK. `*number` is untouched on error.
int echo_question_decode(bytes_t in, uint8_t *number);

void echo_answer_encode(const echo_answer_t *answer, uint8_t out[17]);
/// Likewise.
int echo_answer_decode(bytes_t in, echo_answer_t *answer);

#endif
