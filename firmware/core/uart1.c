#include "uart1.h"

#include <string.h>

enum { SIGN_BYTES_MAX = 4 };

void uart1_rx_init(uart1_rx_t *self, uint8_t kinds) {
    *self = (uart1_rx_t){.kinds = kinds};
}

void uart1_rx_put(uart1_rx_t *self, uint8_t byte) {
    self->rx[self->fill++] = byte;
}

/// The kind whose messages start like this; 0: none of them.
static uint8_t kind_of(bytes_t in) {
    switch (in.data[0]) {
    case STAMP_SYNC_0:
        return in.size > 1 && in.data[1] == ECHO_ANSWER ? UART1_ECHO : UART1_STAMP;
    case PAPER_STAMP_START:
        return UART1_PAPER;
    case '!':
        return UART1_NANOCOCKPIT;
    default:
        return 0;
    }
}

static int decode(bytes_t in, uint8_t kind, uart1_message_t *message) {
    switch (kind) {
    case UART1_STAMP:
        return stamp_decode(in, &message->stamp);
    case UART1_ECHO:
        return echo_answer_decode(in, &message->echo);
    case UART1_PAPER:
        return paper_stamp_decode(in, &message->paper);
    case UART1_NANOCOCKPIT:
        return nanocockpit_uart_decode(in, &message->state);
    default:
        return ERR_START;
    }
}

/// How many bytes there must be before another look is worth it: what a message starts with is looked at as
/// it comes, so that a false start is known at once.
static uint8_t needed(uint8_t kind, uint8_t fill) {
    const bool native = kind == UART1_STAMP || kind == UART1_ECHO;
    const uint8_t least = native                ? STAMP_BYTES
                          : kind == UART1_PAPER ? PAPER_STAMP_BYTES
                                                : NANOCOCKPIT_NOISE_BYTES;
    return fill >= SIGN_BYTES_MAX && fill < least ? least : (uint8_t)(fill + 1);
}

static void drop(uart1_rx_t *self, size_t size) {
    self->fill = (uint8_t)(self->fill - size);
    memmove(self->rx, self->rx + size, self->fill);
}

bool uart1_rx_take(uart1_rx_t *self, uart1_message_t *message) {
    if (self->fill < self->needs) {
        return false;
    }
    while (self->fill > 0) {
        const bytes_t in = {self->rx, self->fill};
        const uint8_t kind = kind_of(in) & self->kinds;
        const int result = decode(in, kind, message);
        self->needs = 0;
        if (result > 0) {
            message->kind = kind;
            message->size = (uint8_t)result;
            self->received += kind != UART1_ECHO;
            self->answers += kind == UART1_ECHO;
            drop(self, (size_t)result);
            return true;
        }
        if (result == ERR_SHORT) {
            self->needs = needed(kind, self->fill);
            return false;
        }
        self->bad_check += result == ERR_CHECK;
        self->garbage_bytes++;
        drop(self, 1);
    }
    return false;
}
