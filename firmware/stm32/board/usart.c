#include "board.h"

enum {
    PIN_USART2_TX = 2,  ///< of GPIOA
    PIN_USART2_RX = 3,  ///< of GPIOA
    PIN_USART3_TX = 10, ///< of GPIOC
    PIN_USART3_RX = 11, ///< of GPIOC
    USART2_BRR = 73,    ///< sixteenths: 42 MHz / 4.5625 / 16 = 575342 Bd
    USART3_BRR = 365,   ///< 42 MHz / 22.8125 / 16 = 115068 Bd
};

board_counters_t board_counters;

static void route(gpio_t *gpio, uint32_t pin) {
    gpio->afr[pin / 8] |= (uint32_t)GPIO_AF_USART1_TO_3 << (pin % 8 * 4);
    gpio->pupdr |= (uint32_t)GPIO_PULL_UP << (pin * 2);
    gpio->moder |= (uint32_t)GPIO_ALTERNATE << (pin * 2);
}

static void clear_sent(usart_t *usart) {
    usart->sr = ~(uint32_t)USART_SR_TC;
}

/// TC is up after a reset, and nothing was sent. The idle frame that goes out first may bring one more.
static void enable_sent(usart_t *usart) {
    clear_sent(usart);
    usart->cr1 |= USART_CR1_TCIE;
}

void usart_init(void) {
    route(GPIOA, PIN_USART2_TX);
    route(GPIOA, PIN_USART2_RX);
    route(GPIOC, PIN_USART3_TX);
    route(GPIOC, PIN_USART3_RX);
    USART2->brr = USART2_BRR;
    USART2->cr1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    USART3->brr = USART3_BRR;
    USART3->cr1 = USART_CR1_UE | USART_CR1_TE | USART_CR1_RE | USART_CR1_RXNEIE;
    enable_sent(USART2);
    enable_sent(USART3);
    interrupt_enable(IRQ_USART2);
    interrupt_enable(IRQ_USART3);
}

void usart_put(usart_t *usart, uint8_t byte) {
    usart->dr = byte;
    if ((usart->sr & USART_SR_TC) != 0) {
        // A line that takes no time, and whose model raises no interrupt for it (QEMU 7.2).
        interrupt_raise(usart == USART2 ? IRQ_USART2 : IRQ_USART3);
    }
}

usart_news_t usart_news(usart_t *usart) {
    usart_news_t news = {0};
    const uint32_t status = usart->sr;
    if ((status & (USART_SR_RXNE | USART_SR_ORE | USART_SR_FE)) != 0) {
        news.byte = (uint8_t)usart->dr; // reading sr and then dr clears all three
        const bool framing = (status & USART_SR_FE) != 0;
        board_counters.overruns += (status & USART_SR_ORE) != 0;
        board_counters.framing += framing;
        news.received = (status & USART_SR_RXNE) != 0 && !framing;
    }
    if ((status & USART_SR_TC) != 0) {
        clear_sent(usart);
        news.sent = true;
    }
    return news;
}
