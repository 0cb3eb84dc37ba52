/// The board around the STM32's app, for a Crazyflie 2.1: registers on one side, the four verbs on the other.
///
/// Interrupt handlers take what has come, note which ports have become idle, and wake the service loop; the
/// loop asks the idle ports for bytes and sets the alarm. Within a message on UART1 the handler itself asks
/// for the next byte, and the loop sleeps on. All handlers have one priority, so none interrupts another, and
/// the loop masks them from its waking until it sleeps again.
#ifndef SPINDECK_STM32_BOARD_BOARD_H
#define SPINDECK_STM32_BOARD_BOARD_H

#include "../../board/barrier.h"
#include "config.h"

#include "registers.h"

extern const volatile stm32_board_config_t board_config;

/// The next reading of the stamp clock, taken over by the handler of EXTI line 0.
extern volatile uint64_t board_stamp_reset;

/// What stm32_init has returned; without a 0 nothing runs.
extern volatile int board_init_result;

extern stm32_t board_app;

/// Faults of the lines, all only grow.
typedef struct {
    uint32_t overruns; ///< bytes lost because the one before had not been taken
    uint32_t framing;  ///< bytes without a stop bit, not given to the app
} board_counters_t;

extern board_counters_t board_counters;

static inline void interrupts_off(void) {
    __asm volatile("cpsid i" ::: "memory");
}

static inline void interrupts_on(void) {
    __asm volatile("cpsie i\n\tisb" ::: "memory");
}

/// Whether the last handler ends in sleep, or returns to what it has interrupted.
static inline void sleep_on_exit(bool on) {
    SCB_SCR = on ? SCB_SCR_SLEEPONEXIT : 0;
    __asm volatile("dsb" ::: "memory");
}

/// Until the FPU is used again, an interrupt need not save its registers: the caller holds nothing in them.
static inline void fpu_unused(void) {
    __asm volatile("msr control, %0\n\tisb" ::"r"(0)
                   : "memory", "s0", "s1", "s2", "s3", "s4", "s5", "s6", "s7", "s8", "s9", "s10", "s11",
                     "s12", "s13", "s14", "s15");
}

static inline void interrupt_enable(uint32_t irq) {
    NVIC_ISER[irq / 32] = 1U << (irq % 32);
}

static inline void interrupt_raise(uint32_t irq) {
    NVIC_ISPR[irq / 32] = 1U << (irq % 32);
}

// startup.c
void board_reset(void);
/// Any exception that this board does not expect: stops with all registers as they were.
void board_trap(void);

// main.c
int main(void);

// rcc.c
/// 168 MHz from the 8 MHz crystal, APB1 at 42 MHz and its timers at 84 MHz.
void rcc_init(void);

// clock.c. Called from handlers, or with interrupts off.
void clock_init(void);
instant_t clock_now(void);
uint64_t clock_up_us(void); ///< of it, up_us alone
/// Sets the stamp clock, and starts its next microsecond now.
void clock_set_stamp(uint64_t stamp_us);

// alarm.c. Likewise.
void alarm_init(void);
/// Wakes at this uptime, or at once if that has passed by now. NEVER_US: none.
void alarm_set(uint64_t due_us);
/// The timer has run out: true if the alarm has come.
bool alarm_came(uint64_t now_us);

// usart.c. Likewise.
typedef struct {
    bool received;
    bool sent; ///< what was given to usart_put has left: the line is idle
    uint8_t byte;
} usart_news_t;

void usart_init(void);
void usart_put(usart_t *usart, uint8_t byte);
/// What the handler was called for.
usart_news_t usart_news(usart_t *usart);

// storage.c. Likewise.
void storage_init(void);
/// For a request.
bytes_mut_t storage_room(void);
/// Begins it. Returns its answer, if there is one at once: without a card.
bytes_t storage_begin(size_t size);
/// The answer that the handler was called for.
bytes_t storage_news(void);

void storage_handler(void);
void tim3_handler(void);
void usart2_handler(void);
void usart3_handler(void);
void exti0_handler(void);

#endif
