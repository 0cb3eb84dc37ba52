#include "board.h"

enum { BAUD = 115200, DIVIDER = (GAP8_FC_HZ + BAUD / 2) / BAUD };

/// One byte for each transfer, again and again: each has its own time of arrival. It must be taken within the
/// 87 us until the next one: a byte that comes while interrupts are off for longer is lost, and its message.
static volatile uint8_t byte __attribute__((aligned(4)));

static uint8_t out[ECHO_QUESTION_BYTES] __attribute__((aligned(4)));
static bool busy; ///< it is on its way

void uart_init(void) {
    UDMA_CLOCKS |= 1U << UDMA_ID_UART;
    UART->setup =
        UART_SETUP_TX | UART_SETUP_RX | UART_SETUP_8_BITS | (uint32_t)(DIVIDER - 1) << UART_SETUP_DIVIDER_BIT;
    soc_event_enable(SOC_EVENT_UART_RX);
    soc_event_enable(SOC_EVENT_UART_TX);
    udma_start(&UART->rx, &byte, sizeof byte, UDMA_EN | UDMA_CONTINUOUS);
}

static void ask(instant_t now) {
    if (busy) {
        return;
    }
    const size_t size = gap8_transmit(&board_app, GAP8_PORT_UART1, (bytes_mut_t){out, sizeof out}, now);
    if (size != 0) {
        busy = true;
        udma_start(&UART->tx, out, size, UDMA_EN);
    }
}

void uart_received(instant_t now) {
    const uint8_t taken = byte;
    gap8_receive(&board_app, GAP8_PORT_UART1, (bytes_t){&taken, 1}, now);
    ask(now);
}

void uart_sent(void) {
    busy = false;
}
