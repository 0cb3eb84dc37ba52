/// The registers of the ESP32 that this board uses: addresses and bits as in Espressif's ESP32 Technical
/// Reference Manual (the chapter behind each name).
#ifndef SPINDECK_ESP32_BOARD_REGISTERS_H
#define SPINDECK_ESP32_BOARD_REGISTERS_H

#include <stdint.h>

typedef volatile uint32_t register_t;

/// UART controllers.
typedef struct {
    register_t fifo, int_raw, int_st, int_ena, int_clr, clkdiv, autobaud, status;
} uart_t;

enum {
    UART_CLKDIV_FRACTION = 20, ///< bit of the sixteenths
    UART_STATUS_RX_COUNT = 0xFF,
    UART_STATUS_TX = 0x0FFF0000, ///< bytes in the FIFO, and the transmitter's state; 0: all have left
};

#define UART0 ((uart_t *)0x3FF40000U)

/// Watchdog timers. The boot ROM starts two, which reset the chip when nobody stops them.
#define WATCHDOG_RTC (*(register_t *)0x3FF4808CU)
#define WATCHDOG_RTC_LOCK (*(register_t *)0x3FF480A4U)
#define WATCHDOG_TIMER0 (*(register_t *)0x3FF5F048U)
#define WATCHDOG_TIMER0_LOCK (*(register_t *)0x3FF5F064U)
#define WATCHDOG_KEY 0x50D83AA1U

#endif
