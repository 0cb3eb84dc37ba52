#include "board.h"

#define HANDLER __attribute__((interrupt("machine")))

gap8_t board_app;
volatile int board_init_result;
volatile uint64_t board_stamp_reset;

/// What the service loop is woken for: to ask SPI, because the ESP32 is ready, or all idle ports.
enum { ASK_SPI = 1, ASK_ALL = 3 };

static struct {
    volatile uint8_t asked;
    instant_t now;   ///< of the last interrupt
    uint64_t due_us; ///< what the app has said last
} board;

static void receive(gap8_port_t port, bytes_t in) {
    gap8_receive(&board_app, port, in, board.now);
    board.asked = ASK_ALL;
}

// Of 1700 bytes a second, none alone makes the app send anything but on UART1.
static void receive_uart(void) {
    uart_received(board.now);
    if (board.now.up_us >= board.due_us) {
        board.asked = ASK_ALL;
    }
}

static void receive_spi(void) {
    receive(GAP8_PORT_SPI, spi_received());
    spi_listen();
}

// Each takes one event: while there are more, the line stays up.
HANDLER void soc_event_handler(void) {
    board.now = clock_now();
    const uint32_t event = SOC_EVENT_POP;
    interrupt_clear(IRQ_SOC_EVENT);
    switch (event & SOC_EVENT_NUMBER) {
    case SOC_EVENT_UART_RX:
        receive_uart();
        break;
    case SOC_EVENT_UART_TX:
        uart_sent();
        break;
    case SOC_EVENT_SPIM1_RX:
        receive_spi();
        break;
    case SOC_EVENT_SPIM1_EOT:
        spi_end();
        board.asked = ASK_ALL;
        break;
    case SOC_EVENT_GPIO:
        board.asked = (uint8_t)(board.asked | (spi_handshake() ? ASK_SPI : 0));
        break;
    default:
        break;
    }
}

HANDLER void camera_handler(void) {
    board.now = clock_now();
    receive(GAP8_PORT_CAMERA, camera_take());
}

HANDLER void timer_handler(void) {
    board.now = clock_now();
    if (alarm_came(board.now.up_us)) {
        board.asked = ASK_ALL;
    }
}

// Nothing is due because of it, so the service loop sleeps on.
HANDLER void software_handler(void) {
    interrupt_clear(IRQ_SOFTWARE_0);
    clock_set_stamp(board_stamp_reset);
    board.now = clock_now();
}

static void ask_spi(void) {
    const bytes_mut_t room = spi_room();
    if (room.size == 0) {
        return;
    }
    const size_t size = gap8_transmit(&board_app, GAP8_PORT_SPI, room, board.now);
    if (size != 0) {
        spi_start(size);
    } else if (spi_wanted()) {
        spi_start_empty();
    }
}

static void ask_camera(void) {
    uint8_t command[GAP8_CAMERA_COMMAND_BYTES];
    const bytes_mut_t room = {command, sizeof command};
    if (gap8_transmit(&board_app, GAP8_PORT_CAMERA, room, board.now) != 0) {
        camera_start(command);
    }
}

static void set_alarm(void) {
    board.due_us = gap8_deadline(&board_app);
    // One that has passed was served just now: it waits for the next event.
    if (!alarm_set(board.due_us > board.now.up_us ? board.due_us : NEVER_US)) {
        board.now = clock_now();
        board.asked = ASK_ALL;
    }
}

/// With the instant of the last interrupt: an app's time never goes back. Not inlined, so that sizes and
/// faults tell it from main().
__attribute__((noinline)) static void service(void) {
    const bool all = board.asked == ASK_ALL;
    board.asked = 0;
    ask_spi();
    if (all) {
        ask_camera();
    }
    set_alarm();
}

int main(void) {
    clock_init();
    alarm_init();
    uart_init();
    spi_init();
    camera_init();
    interrupt_enable(IRQ_SOFTWARE_0);
    interrupt_enable(IRQ_SOC_EVENT);
    board.now = clock_now();
    const gap8_config_t config = board_config.app;
    board_init_result = gap8_init(&board_app, &config, board.now);
    if (board_init_result == 0) {
        board.asked = ASK_ALL;
    } else {
        EVENT_UNIT->irq_mask = 0;
    }
    for (;;) { // interrupts are off here
        if (board.asked != 0) {
            service();
        } else {
            __asm volatile("wfi" ::: "memory"); // a pending interrupt ends it, or keeps it from beginning
        }
        interrupts_on(); // the handlers run here
        interrupts_off();
    }
}
