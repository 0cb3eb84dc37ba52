/// Everything that a Crazyflie's firmware says to the GAP8 over UART1, found in one byte stream.
#ifndef SPINDECK_CORE_UART1_H
#define SPINDECK_CORE_UART1_H

#include "echo.h"
#include "nanocockpit.h"
#include "paper.h"

enum { UART1_MESSAGE_MAX = NANOCOCKPIT_RANGES_BYTES };

/// Kinds of messages; their sum says which ones a receiver looks for.
enum {
    UART1_STAMP = 1, ///< native
    UART1_PAPER = 2,
    UART1_NANOCOCKPIT = 4,
    UART1_ECHO = 8, ///< native: an answer
    UART1_ALL = 15,
};

/// One message. Only the part that `kind` names is filled.
typedef struct {
    uint8_t kind;
    uint8_t size; ///< bytes it took; UART1_NANOCOCKPIT: only NANOCOCKPIT_STATE_BYTES has filled `state`
    stamp_t stamp;
    echo_answer_t echo;
    paper_stamp_t paper;
    nanocockpit_state_t state;
} uart1_message_t;

/// Messages out of a byte stream. After a bad check the search goes on inside the bytes already read, so that
/// one false start never costs the message behind it.
typedef struct {
    uint8_t kinds;
    uint8_t rx[UART1_MESSAGE_MAX];
    uint8_t fill;
    uint8_t needs;     ///< until it has so many bytes nothing in it is new
    uint32_t received; ///< all but UART1_ECHO
    uint32_t answers;  ///< UART1_ECHO
    uint32_t bad_check;
    uint32_t garbage_bytes;
} uart1_rx_t;

void uart1_rx_init(uart1_rx_t *self, uint8_t kinds);

/// One byte came in. Call uart1_rx_take until it returns false before the next one.
void uart1_rx_put(uart1_rx_t *self, uint8_t byte);

/// True when there is a message. If `kinds` is just one of them, or the two native ones, that is at its last
/// byte, and only once; otherwise a long false start may give way to several at a time.
bool uart1_rx_take(uart1_rx_t *self, uart1_message_t *message);

#endif
