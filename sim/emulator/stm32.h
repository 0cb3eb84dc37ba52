/// The STM32F405 of a Crazyflie 2.1 around its Cortex-M4F, as far as the firmware uses it (RM0090).
///
/// USART2 and USART3 with byte times from BRR, overrun and framing error; TIM2, TIM3 and TIM5 as up-counters;
/// EXTI line 0, which stands for whatever sets the stamp clock from outside; a mailbox for the card, in the
/// place of a driver and a file system; the clock tree, from which all but these two get their clocks. GPIO,
/// FLASH, PWR and SYSCFG take what is written and give it back. Everything else ends the run, as does a
/// peripheral whose clock is off.
#ifndef SPINDECK_SIM_STM32_H
#define SPINDECK_SIM_STM32_H

#include "cortex_m.h"

/// Clocks from the RCC's registers, in kHz.
typedef struct {
    uint32_t core_khz;
    uint32_t apb1_khz;
    uint32_t apb1_timers_khz;
} stm32_clocks_t;

typedef enum { SENDER_IDLE, SENDER_WRITTEN, SENDER_ON_LINE } sender_t;

typedef struct {
    uint32_t status, baud, control1, control2, control3;
    bool status_read; ///< the first half of how SR's flags are cleared
    uint8_t received;
    uint8_t waiting; ///< written to DR while a byte was on its way
    sender_t sender; ///< the byte that has left DR
    uint8_t sending;
} usart_t;

typedef struct {
    ticks_t ticks;
    uint32_t control, interrupts, status, count, reload;
    uint32_t prescaler;      ///< in use
    uint32_t prescaler_next; ///< PSC as written: from the next update on
    uint32_t count_max;
} stm32_timer_t;

/// A request to the card, and where its answer goes.
typedef struct {
    uint32_t request, size, answer, room, answered;
    bool taken;
} stm32_mailbox_t;

enum { STM32_USARTS = 2, STM32_TIMERS = 3, STM32_PLAIN_BLOCKS = 12, STM32_PLAIN_WORDS = 64 };

/// State of all peripherals.
typedef struct {
    stm32_clocks_t clocks;
    usart_t usarts[STM32_USARTS];
    stm32_timer_t timers[STM32_TIMERS];
    stm32_mailbox_t storage;
    int64_t alarm_ns; ///< of the timers; INT64_MIN: to be found out
    uint32_t exti_mask, exti_pending;
    uint32_t rcc[STM32_PLAIN_WORDS];
    uint32_t plain[STM32_PLAIN_BLOCKS][STM32_PLAIN_WORDS];
} stm32_chip_t;

static inline stm32_chip_t *stm32_chip(emulator_t *e) {
    return e->machine_state;
}

/// True if bit `bit` of RCC_APB1ENR is set; else the run has ended.
bool stm32_has_clock(emulator_t *e, const char *name, int bit);

// stm32_rcc.c
void stm32_rcc_reset(emulator_t *e);
uint32_t stm32_rcc_read(emulator_t *e, uint32_t offset);
void stm32_rcc_write(emulator_t *e, uint32_t offset, uint32_t value);

// stm32_usart.c
enum { STM32_USART3 = 0, STM32_USART2 = 1 }; ///< by the port that they serve
void stm32_usart_reset(usart_t *usart);
uint32_t stm32_usart_read(emulator_t *e, int index, uint32_t offset);
void stm32_usart_write(emulator_t *e, int index, uint32_t offset, uint32_t value);
void stm32_usart_receive(emulator_t *e, int index, uint8_t byte);
/// What it had on the line has left.
void stm32_usart_sent(emulator_t *e, int index);
size_t stm32_usart_take(emulator_t *e, int index, uint8_t *byte);
int64_t stm32_usart_byte_ps(emulator_t *e, int index);

// stm32_storage.c
enum { STM32_STORAGE = 2 }; ///< likewise
uint32_t stm32_storage_read(emulator_t *e, uint32_t offset);
void stm32_storage_write(emulator_t *e, uint32_t offset, uint32_t value);
size_t stm32_storage_take(emulator_t *e, bytes_mut_t out);
void stm32_storage_receive(emulator_t *e, bytes_t in);

// stm32_timer.c
enum { STM32_TIM2 = 0, STM32_TIM3 = 1, STM32_TIM5 = 2 };
void stm32_timer_reset(emulator_t *e, int index);
uint32_t stm32_timer_read(emulator_t *e, int index, uint32_t offset);
void stm32_timer_write(emulator_t *e, int index, uint32_t offset, uint32_t value);
/// Counts up to now, and raises the interrupts of updates.
void stm32_timers_settle(emulator_t *e);
int64_t stm32_timers_alarm_ns(emulator_t *e);

extern const machine_t stm32_machine;

#endif
