/// A board for the ESP32's app as far as it goes without ESP-IDF: UART2 works by polling, nothing else is
/// there. It shows that the app compiles and links for the chip. Nothing has run it.

#include "../app.h"

#include "registers.h"

/// The crystal's, which the boot ROM runs the CPU and the periphery on.
#ifndef ESP32_CPU_MHZ
#define ESP32_CPU_MHZ 40U
#endif

enum { BAUD = 576000, SIXTEENTHS = (int)(ESP32_CPU_MHZ * 16000000U / BAUD) };

const volatile esp32_config_t board_config __attribute__((section(".board_config"))) = {0};
volatile int board_init_result;
esp32_t board_app;

int main(void);

static struct {
    uint64_t up_us;
    uint32_t cycles; ///< since up_us
    uint32_t last;   ///< cycle counter when it was read
} clock;

// The cycle counter wraps after 107 s; the loop comes round within microseconds.
static instant_t clock_now(void) {
    uint32_t count;
    __asm volatile("rsr %0, ccount" : "=a"(count));
    clock.cycles += count - clock.last;
    clock.last = count;
    clock.up_us += clock.cycles / ESP32_CPU_MHZ;
    clock.cycles %= ESP32_CPU_MHZ;
    return (instant_t){clock.up_us, clock.up_us};
}

static void watchdogs_off(void) {
    WATCHDOG_RTC_LOCK = WATCHDOG_KEY;
    WATCHDOG_RTC = 0;
    WATCHDOG_TIMER0_LOCK = WATCHDOG_KEY;
    WATCHDOG_TIMER0 = 0;
}

static void service(void) {
    while ((UART0->status & UART_STATUS_RX_COUNT) != 0) {
        const uint8_t byte = (uint8_t)UART0->fifo;
        esp32_receive(&board_app, ESP32_PORT_UART2, (bytes_t){&byte, 1}, clock_now());
    }
    uint8_t byte;
    if ((UART0->status & UART_STATUS_TX) == 0 &&
        esp32_transmit(&board_app, ESP32_PORT_UART2, (bytes_mut_t){&byte, 1}, clock_now()) != 0) {
        UART0->fifo = byte;
    }
    uint8_t command[128]; // for a Wi-Fi driver that is not there
    esp32_transmit(&board_app, ESP32_PORT_NETWORK, (bytes_mut_t){command, sizeof command}, clock_now());
}

int main(void) {
    watchdogs_off();
    UART0->clkdiv = (uint32_t)(SIXTEENTHS / 16 | SIXTEENTHS % 16 << UART_CLKDIV_FRACTION);
    const esp32_config_t config = board_config;
    board_init_result = esp32_init(&board_app, &config, clock_now());
    while (board_init_result == 0) {
        service();
    }
    return board_init_result;
}
