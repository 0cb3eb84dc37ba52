#include "board.h"

enum { UARTS = 2 }; ///< the first of stm32_port_t

stm32_t board_app;
volatile int board_init_result;
volatile uint64_t board_stamp_reset;

static struct {
    bool busy[UARTS]; ///< a byte is on the line
    bool wake;
    instant_t now;   ///< of the last interrupt
    uint64_t due_us; ///< what the app has said last
} board;

static usart_t *line_of(stm32_port_t port) {
    return port == STM32_PORT_UART1 ? USART3 : USART2;
}

/// The service loop goes on when the handlers have returned.
static void wake(void) {
    board.wake = true;
    sleep_on_exit(false);
}

/// False if there is nothing to be sent.
static bool send(stm32_port_t port) {
    uint8_t byte;
    board.busy[port] = stm32_transmit(&board_app, port, (bytes_mut_t){&byte, 1}, board.now) != 0;
    if (board.busy[port]) {
        usart_put(line_of(port), byte);
    }
    return board.busy[port];
}

// Within a message on UART1 nothing else is to be done: the service loop sleeps on.
static void on_sent(stm32_port_t port) {
    board.busy[port] = false;
    if (port != STM32_PORT_UART1 || board.now.up_us >= board.due_us || !send(port)) {
        wake();
    }
}

static void on_usart(stm32_port_t port) {
    board.now = clock_now();
    const usart_news_t news = usart_news(line_of(port));
    if (news.sent) {
        on_sent(port);
    }
    if (news.received) {
        stm32_receive(&board_app, port, (bytes_t){&news.byte, 1}, board.now);
        wake();
    }
}

void usart2_handler(void) {
    on_usart(STM32_PORT_UART2);
}

void usart3_handler(void) {
    on_usart(STM32_PORT_UART1);
}

void tim3_handler(void) {
    board.now = clock_now();
    if (alarm_came(board.now.up_us)) {
        wake();
    }
}

static void take_answer(bytes_t answer) {
    wake();
    stm32_receive(&board_app, STM32_PORT_STORAGE, answer, board.now);
}

void storage_handler(void) {
    board.now = clock_now();
    take_answer(storage_news());
}

// Nothing is due because of it, so the service loop sleeps on.
void exti0_handler(void) {
    EXTI->pr = EXTI_LINE_0;
    clock_set_stamp(board_stamp_reset);
    board.now = clock_now();
}

static void service_storage(void) {
    const size_t size = stm32_transmit(&board_app, STM32_PORT_STORAGE, storage_room(), board.now);
    if (size == 0) {
        return;
    }
    const bytes_t answer = storage_begin(size);
    if (answer.size != 0) {
        take_answer(answer);
    }
}

/// With the instant of the last interrupt: an app's time never goes back. Not inlined, so that sizes and
/// faults tell it from main().
__attribute__((noinline)) static void service(void) {
    for (int port = 0; port < UARTS; port++) {
        if (!board.busy[port]) {
            send((stm32_port_t)port);
        }
    }
    service_storage();
    if (board.wake) { // an answer at once: the idle ports are to be asked again first
        return;
    }
    board.due_us = stm32_deadline(&board_app);
    // One that has passed was served just now: it waits for the next event.
    alarm_set(board.due_us > board.now.up_us ? board.due_us : NEVER_US);
}

int main(void) {
    interrupts_off();
    rcc_init();
    clock_init();
    alarm_init();
    usart_init();
    storage_init();
    EXTI->imr |= EXTI_LINE_0; // raised by software only (EXTI->swier): no pin is routed to it
    interrupt_enable(IRQ_EXTI0);
    board.now = clock_now();
    const stm32_config_t config = board_config.app;
    board_init_result = stm32_init(&board_app, &config, board.now);
    board.wake = board_init_result == 0;
    for (;;) { // interrupts are off here
        if (board.wake) {
            board.wake = false;
            service();
            fpu_unused();
        }
        if (!board.wake) {
            sleep_on_exit(true);                // a handler that does not wake the loop leaves it asleep
            __asm volatile("wfi" ::: "memory"); // a pending interrupt ends it, or keeps it from beginning
        }
        interrupts_on(); // its handler runs here
        interrupts_off();
    }
}
