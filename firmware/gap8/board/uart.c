#include "board.h"

enum { BAUD = 115200, DIVIDER = (GAP8_FC_HZ + BAUD / 2) / BAUD };

/// One byte for each transfer, again and again: each has its own time of arrival, and is taken before the
/// next one has come.
static volatile uint8_t byte __attribute__((aligned(4)));

void uart_init(void) {
    UDMA_CLOCKS |= 1U << UDMA_ID_UART;
    UART->setup = UART_SETUP_RX | UART_SETUP_8_BITS | (uint32_t)(DIVIDER - 1) << UART_SETUP_DIVIDER_BIT;
    soc_event_enable(SOC_EVENT_UART_RX);
    udma_start(&UART->rx, &byte, sizeof byte, UDMA_EN | UDMA_CONTINUOUS);
}

uint8_t uart_take(void) {
    return byte;
}
