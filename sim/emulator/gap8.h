/// Private to the model of the GAP8: its state, and what its parts do for each other. Addresses and bits are
/// those of GreenWaves' gap_sdk and of pulp-platform's RTL, written down here a second time: the board's own
/// header is what this model is to find wrong.
#ifndef SPINDECK_SIM_GAP8_H
#define SPINDECK_SIM_GAP8_H

#include "rv32.h"

enum {
    GAP8_TIMER = 0x00200400,
    GAP8_SOC_EVENTS = 0x00200F00,
    GAP8_EVENT_UNIT = 0x00204000,
    GAP8_GPIO = 0x1A101000,
    GAP8_SPIM1 = 0x1A102100,
    GAP8_UART = 0x1A102200,
    GAP8_UDMA_CLOCKS = 0x1A102780,
    GAP8_PADS = 0x1A104140,
    GAP8_SOC_EVENT_MASKS = 0x1A106004,
    GAP8_CAMERA = 0x1A170000,
    GAP8_FC_TCDM = 0x1B000000,
    GAP8_L2 = 0x1C000000,
};

/// The clock of the fabric controller and its periphery, as the boot ROM leaves it.
enum { GAP8_FC_MHZ = 50 };

/// gap8_port_t.
enum { GAP8_UART1 = 0, GAP8_SPI = 1, GAP8_CAMERA_PORT = 2 };

enum { GAP8_LINE_SOFTWARE = 0, GAP8_LINE_TIMER = 10, GAP8_LINE_CAMERA = 20, GAP8_LINE_SOC = 27 };

enum {
    GAP8_EVENT_SPIM1_RX = 4,
    GAP8_EVENT_UART_RX = 8,
    GAP8_EVENT_UART_TX = 9,
    GAP8_EVENT_SPIM1_EOT = 23,
    GAP8_EVENT_GPIO = 42,
    GAP8_EVENTS_MAX = 8, ///< waiting in the event unit
};

/// One of the two counters.
typedef struct {
    uint32_t cfg;
    uint32_t value; ///< at start_ns
    uint32_t compare;
    int64_t start_ns; ///< when it was started or set
    int64_t match_ns; ///< its next event
} gap8_timer_t;

typedef struct {
    uint32_t address, size, cfg;
} gap8_channel_t;

typedef struct {
    gap8_timer_t timers[2];
    uint32_t irq_mask;
    uint32_t buffer;       ///< of the event unit: lines that have been raised
    uint32_t soc_masks[2]; ///< high, low
    uint8_t soc_events[GAP8_EVENTS_MAX];
    uint32_t soc_count;
    gap8_channel_t uart_rx, uart_tx, spi_rx, spi_tx;
    uint32_t uart_setup;
    uint32_t udma_clocks;
    uint32_t pads[4];
    uint32_t gpio[8];
    uint32_t camera[7];
    bool uart_given;     ///< the kernel has the first byte of uart_tx
    bool spi_given;      ///< the kernel has what spi_tx sends
    bool camera_started; ///< it has not got the command yet
    bool news;           ///< something has come since the kernel last asked a port: it asks because of that
} gap8_machine_t;

extern const machine_t gap8_machine;

static inline gap8_machine_t *gap8_of(emulator_t *e) {
    return e->machine_state;
}

/// Reads and writes of a block's registers: false if there is none at this offset.
bool gap8_timer_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_timer_write(emulator_t *e, uint32_t offset, uint32_t value);
bool gap8_event_unit_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_event_unit_write(emulator_t *e, uint32_t offset, uint32_t value);
bool gap8_uart_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_uart_write(emulator_t *e, uint32_t offset, uint32_t value);
bool gap8_spi_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_spi_write(emulator_t *e, uint32_t offset, uint32_t value);
bool gap8_gpio_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_gpio_write(emulator_t *e, uint32_t offset, uint32_t value);
bool gap8_camera_read(emulator_t *e, uint32_t offset, uint32_t *value);
bool gap8_camera_write(emulator_t *e, uint32_t offset, uint32_t value);

// gap8_timer.c
int64_t gap8_timer_ns(const gap8_machine_t *m); ///< of the next event, INT64_MAX for none
void gap8_timer_due(emulator_t *e);

// gap8_events.c
void gap8_raise(emulator_t *e, int line);
void gap8_soc_event(emulator_t *e, uint32_t event);
uint32_t gap8_soc_event_pop(emulator_t *e);

// gap8_ports.c
void gap8_uart_receive(emulator_t *e, bytes_t in);
/// What had been given to the kernel has left.
void gap8_uart_sent(emulator_t *e);
size_t gap8_uart_take(emulator_t *e, bytes_mut_t out);
int64_t gap8_uart_byte_ps(emulator_t *e);
void gap8_spi_receive(emulator_t *e, bytes_t in);
/// The kernel wants to know what the GAP8 sends: what it had has been sent, or the ESP32's line goes up and
/// down.
void gap8_spi_asked(emulator_t *e);
/// The ESP32 is ready, and has something to say: its line stays up until the window has ended.
void gap8_spi_window(emulator_t *e);
size_t gap8_spi_take(emulator_t *e, bytes_mut_t out);
void gap8_camera_receive(emulator_t *e, bytes_t body);
size_t gap8_camera_take(emulator_t *e, bytes_mut_t out);

#endif
