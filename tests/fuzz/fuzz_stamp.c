/// A message that decodes encodes to the same bytes; a refusal leaves it alone. In a stream each byte is in a
/// message, garbage, or waiting, and each message found is really there, and ends with the byte that came
/// last.
#include "claim.h"

#include "firmware/core/uart1.h"

static void decode(const uint8_t *data, size_t size) {
    stamp_t stamp;
    memset(&stamp, POISON, sizeof stamp);
    const int used = stamp_decode((bytes_t){data, size}, &stamp);
    if (used < 0) {
        CLAIM(untouched(&stamp, sizeof stamp));
        return;
    }
    uint8_t out[STAMP_BYTES];
    stamp_encode(&stamp, out);
    CLAIM(used == STAMP_BYTES && memcmp(out, data, STAMP_BYTES) == 0);
}

static void echoes(const uint8_t *data, size_t size) {
    uint8_t out[ECHO_ANSWER_BYTES];
    uint8_t number = POISON;
    if (echo_question_decode((bytes_t){data, size}, &number) > 0) {
        echo_question_encode(number, out);
        CLAIM(memcmp(out, data, ECHO_QUESTION_BYTES) == 0);
    } else {
        CLAIM(number == POISON);
    }
    echo_answer_t answer;
    memset(&answer, POISON, sizeof answer);
    if (echo_answer_decode((bytes_t){data, size}, &answer) < 0) {
        CLAIM(untouched(&answer, sizeof answer));
        return;
    }
    echo_answer_encode(&answer, out);
    CLAIM(memcmp(out, data, ECHO_ANSWER_BYTES) == 0);
}

static void search(const uint8_t *data, size_t size) {
    uart1_rx_t rx;
    uart1_message_t message;
    uart1_rx_init(&rx, UART1_STAMP | UART1_ECHO);
    for (size_t i = 0; i < size; i++) {
        uart1_rx_put(&rx, data[i]);
        if (uart1_rx_take(&rx, &message)) {
            uint8_t out[STAMP_BYTES];
            if (message.kind == UART1_ECHO) {
                echo_answer_encode(&message.echo, out);
            } else {
                stamp_encode(&message.stamp, out);
            }
            CLAIM(memcmp(out, data + i + 1 - STAMP_BYTES, STAMP_BYTES) == 0);
        }
        CLAIM(rx.fill < STAMP_BYTES);
        CLAIM(((size_t)rx.received + rx.answers) * STAMP_BYTES + rx.garbage_bytes + rx.fill == i + 1);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    decode(data, size);
    echoes(data, size);
    search(data, size);
    return 0;
}
