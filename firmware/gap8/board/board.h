/// The board around the GAP8's app, for an AI-deck 1.1: registers on one side, the four verbs on the other.
///
/// Interrupt handlers take what has come, note which ports have become idle, and wake the service loop; the
/// loop asks the idle ports for something to send and sets the alarm. No handler interrupts another, and the
/// loop masks them while it is inside the app.
///
/// What a real AI-deck needs beyond this: the SPI master's commands and its exchange of headers before each
/// window (spi.c), the camera's own driver (camera.c), and the FLL, which stays as the boot ROM sets it.
#ifndef SPINDECK_GAP8_BOARD_BOARD_H
#define SPINDECK_GAP8_BOARD_BOARD_H

#include "../../board/barrier.h"
#include "config.h"

#include "registers.h"

/// Of the fabric controller and its periphery; whole MHz, 1 to 256.
#ifndef GAP8_FC_HZ
#define GAP8_FC_HZ 50000000U
#endif

extern const volatile gap8_board_config_t board_config;

/// The next reading of the stamp clock, taken over by the handler of IRQ_SOFTWARE_0.
extern volatile uint64_t board_stamp_reset;

/// What gap8_init has returned; without a 0 nothing runs.
extern volatile int board_init_result;

extern gap8_t board_app;

static inline void interrupts_off(void) {
    __asm volatile("csrci mstatus, 8" ::: "memory");
}

static inline void interrupts_on(void) {
    __asm volatile("csrsi mstatus, 8" ::: "memory");
}

static inline void interrupt_enable(uint32_t line) {
    EVENT_UNIT->irq_mask_or = 1U << line;
}

static inline void interrupt_clear(uint32_t line) {
    EVENT_UNIT->buffer_clear = 1U << line;
}

/// Of the SoC, below 64: its interrupt is IRQ_SOC_EVENT.
static inline void soc_event_enable(uint32_t event) {
    if (event < 32) {
        SOC_EVENT_MASK_LOW &= ~(1U << event);
    } else {
        SOC_EVENT_MASK_HIGH &= ~(1U << (event - 32));
    }
}

/// What a DMA moves lies in L2, at a word.
static inline void udma_start(udma_channel_t *channel, const volatile void *address, size_t size,
                              uint32_t cfg) {
    memory_barrier();
    channel->address = (uint32_t)(uintptr_t)address;
    channel->size = (uint32_t)size;
    channel->cfg = cfg;
    memory_barrier();
}

// startup.S
void board_reset(void);
/// Any exception or interrupt that this board does not expect: stops with all registers as they were.
void board_trap(void);

// main.c
int main(void);
void software_handler(void);
void timer_handler(void);
void camera_handler(void);
void soc_event_handler(void);

// clock.c. All below are called from handlers, or with interrupts off.
void clock_init(void);
instant_t clock_now(void);
uint64_t clock_up_us(void);
/// Sets the stamp clock, and starts its next tick now.
void clock_set_stamp(uint64_t stamp_us);

// alarm.c
void alarm_init(void);
/// Wakes at this uptime, false if that has passed by now. NEVER_US: not at all.
bool alarm_set(uint64_t due_us);
/// The timer has come round: true if the alarm has come.
bool alarm_came(uint64_t now_us);

// uart.c
void uart_init(void);
/// A byte has come: the app gets it, and sends on UART1 what it then has to say.
void uart_received(instant_t now);
/// It has left, or at least the DMA.
void uart_sent(void);

// spi.c
void spi_init(void);
/// Where to put the next window, or no room while one is under way.
bytes_mut_t spi_room(void);
void spi_start(size_t size);
/// The window has ended.
void spi_end(void);
/// What the slave has sent, empty if nothing; valid until spi_listen, which must follow.
bytes_t spi_received(void);
void spi_listen(void);
/// Nothing to say, in a window for what the slave has.
void spi_start_empty(void);
/// The ESP32's line has risen: it may have something to say.
bool spi_handshake(void);
/// The line is still up: it waits for a window.
bool spi_wanted(void);

// camera.c
void camera_init(void);
void camera_start(const uint8_t command[GAP8_CAMERA_COMMAND_BYTES]);
/// The body of the capture that has ended, empty if it failed; valid until the next command for its slot.
bytes_t camera_take(void);

#endif
