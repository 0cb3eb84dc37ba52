#include "board.h"

// A window here is one transfer of both channels, whose length the longer side sets. A real one begins with
// an exchange of four bytes of header each way, and the master's length of the second part follows from them;
// and the master takes its commands (clock, chip select, full duplex, end of transfer) through the TX channel
// too.

enum {
    PIN_READY = 18, ///< from the ESP32: ready for a window
    PAD_READY = 32,
    PAD_GPIO = 1, ///< function of a pad
};

static uint8_t out[NANOCOCKPIT_FRAME_MAX] __attribute__((aligned(4)));
static uint8_t in[NANOCOCKPIT_FRAME_MAX] __attribute__((aligned(4)));
static bool busy; ///< a window is under way

void spi_init(void) {
    UDMA_CLOCKS |= 1U << UDMA_ID_SPIM1;
    PAD_FUNCTIONS[PAD_READY / 16] |= (uint32_t)PAD_GPIO << (PAD_READY % 16 * 2);
    GPIO->clock_enable |= 1U << PIN_READY;
    GPIO->event_type[PIN_READY / 16] |= (uint32_t)GPIO_EVENT_RISE << (PIN_READY % 16 * 2);
    GPIO->event_enable |= 1U << PIN_READY;
    soc_event_enable(SOC_EVENT_SPIM1_RX);
    soc_event_enable(SOC_EVENT_SPIM1_EOT);
    soc_event_enable(SOC_EVENT_GPIO);
    spi_listen();
}

bytes_mut_t spi_room(void) {
    return (bytes_mut_t){out, busy ? 0 : sizeof out};
}

void spi_start(size_t size) {
    busy = true;
    udma_start(&SPIM1->tx, out, size, UDMA_EN);
}

void spi_start_empty(void) {
    memset(out, 0, CPX_LINK_HEADER_BYTES);
    spi_start(CPX_LINK_HEADER_BYTES);
}

void spi_end(void) {
    busy = false;
}

bytes_t spi_received(void) {
    return (bytes_t){in, sizeof in - SPIM1->rx.size};
}

void spi_listen(void) {
    udma_start(&SPIM1->rx, in, sizeof in, UDMA_EN);
}

bool spi_wanted(void) {
    return (GPIO->in >> PIN_READY & 1) != 0;
}

bool spi_handshake(void) {
    return (GPIO->event_status >> PIN_READY & 1) != 0;
}
