#include "stm32.h"

/// RM0090, 2.3 (memory map) and 12.2 (vectors).
enum {
    FLASH = 0x08000000,
    FLASH_BYTES = 1 << 20,
    RAM = 0x20000000,
    RAM_BYTES = 128 << 10,
    BLOCK_BYTES = 0x400,
    IRQ_EXTI0 = 6,
    EXTI_IMR = 0x00,
    EXTI_SWIER = 0x10,
    EXTI_PR = 0x14,
    EXTI_LINE_0 = 1,
    RCC_APB1ENR = 0x40,
};
static const uint32_t STORAGE = 0x40012C00, EXTI = 0x40013C00, RCC = 0x40023800;

/// Registers that give back what was written to them.
static const uint32_t PLAIN[STM32_PLAIN_BLOCKS] = {
    0x40007000, // PWR
    0x40013800, // SYSCFG
    0x40020000, 0x40020400, 0x40020800, 0x40020C00, 0x40021000,
    0x40021400, 0x40021800, 0x40021C00, 0x40022000, // GPIO
    0x40023C00,                                     // FLASH
};

bool stm32_has_clock(emulator_t *e, const char *name, int bit) {
    bool on = (stm32_chip(e)->rcc[RCC_APB1ENR / 4] >> bit & 1) != 0;
    if (!on) {
        emulator_fail(e, "%s is used before bit %d of RCC_APB1ENR gives it a clock", name, bit);
    }
    return on;
}

static void set_exti_line(emulator_t *e) {
    const stm32_chip_t *chip = stm32_chip(e);
    cortex_m_line(e, IRQ_EXTI0, (chip->exti_pending & chip->exti_mask & EXTI_LINE_0) != 0);
}

static void raise_exti(emulator_t *e, uint32_t lines) {
    stm32_chip(e)->exti_pending |= lines;
    set_exti_line(e);
}

static uint32_t exti_read(emulator_t *e, uint32_t offset) {
    const stm32_chip_t *chip = stm32_chip(e);
    return offset == EXTI_IMR ? chip->exti_mask : offset == EXTI_PR ? chip->exti_pending : 0;
}

static void exti_write(emulator_t *e, uint32_t offset, uint32_t value) {
    stm32_chip_t *chip = stm32_chip(e);
    if (offset == EXTI_IMR) {
        chip->exti_mask = value;
    } else if (offset == EXTI_SWIER) {
        chip->exti_pending |= value & chip->exti_mask;
    } else if (offset == EXTI_PR) {
        chip->exti_pending &= ~value;
    }
    if (((chip->exti_mask | chip->exti_pending) & ~(uint32_t)EXTI_LINE_0) != 0) {
        emulator_fail(e, "EXTI lines other than 0 are not modelled");
    }
    set_exti_line(e);
}

static int usart_at(uint32_t block) {
    return block == 0x40004400 ? STM32_USART2 : block == 0x40004800 ? STM32_USART3 : -1;
}

static int timer_at(uint32_t block) {
    return block == 0x40000000   ? STM32_TIM2
           : block == 0x40000400 ? STM32_TIM3
           : block == 0x40000C00 ? STM32_TIM5
                                 : -1;
}

static uint32_t *plain_at(emulator_t *e, uint32_t block, uint32_t offset) {
    for (int i = 0; i < STM32_PLAIN_BLOCKS && offset / 4 < STM32_PLAIN_WORDS; i++) {
        if (PLAIN[i] == block) {
            return &stm32_chip(e)->plain[i][offset / 4];
        }
    }
    emulator_fail(e, "access to 0x%08x, a peripheral that is not modelled", block + offset);
    return NULL;
}

static uint32_t chip_read(emulator_t *e, uint32_t address, unsigned size) {
    uint32_t block = address & ~(uint32_t)(BLOCK_BYTES - 1);
    uint32_t offset = address - block;
    if (usart_at(block) >= 0) {
        return stm32_usart_read(e, usart_at(block), offset);
    }
    if (timer_at(block) >= 0) {
        return stm32_timer_read(e, timer_at(block), offset);
    }
    if (address >> 12 == 0xE000E) {
        return cortex_m_read(e, address, size);
    }
    if (block == EXTI) {
        return exti_read(e, offset);
    }
    if (block == STORAGE) {
        return stm32_storage_read(e, offset);
    }
    if (block == RCC && offset / 4 < STM32_PLAIN_WORDS) {
        return stm32_rcc_read(e, offset);
    }
    const uint32_t *plain = plain_at(e, block, offset);
    return plain == NULL ? 0 : *plain;
}

static void chip_write(emulator_t *e, uint32_t address, unsigned size, uint32_t value) {
    uint32_t block = address & ~(uint32_t)(BLOCK_BYTES - 1);
    uint32_t offset = address - block;
    if (usart_at(block) >= 0) {
        stm32_usart_write(e, usart_at(block), offset, value);
    } else if (timer_at(block) >= 0) {
        stm32_timer_write(e, timer_at(block), offset, value);
    } else if (address >> 12 == 0xE000E) {
        cortex_m_write(e, address, size, value);
        stm32_chip(e)->alarm_ns = INT64_MIN; // SysTick's among them
    } else if (block == EXTI) {
        exti_write(e, offset, value);
    } else if (block == STORAGE) {
        stm32_storage_write(e, offset, value);
    } else if (block == RCC && offset / 4 < STM32_PLAIN_WORDS) {
        stm32_rcc_write(e, offset, value);
    } else {
        uint32_t *plain = plain_at(e, block, offset);
        if (plain != NULL) {
            *plain = value;
        }
    }
}

static void reset(emulator_t *e) {
    stm32_chip_t *chip = stm32_chip(e);
    for (int index = 0; index < STM32_TIMERS; index++) {
        stm32_timer_reset(e, index);
    }
    for (int index = 0; index < STM32_USARTS; index++) {
        stm32_usart_reset(&chip->usarts[index]);
    }
    stm32_rcc_reset(e);
}

static void receive(emulator_t *e, int port, bytes_t in) {
    if (port == STM32_STORAGE) {
        stm32_storage_receive(e, in);
        emulator_run(e, false);
        return;
    }
    for (size_t i = 0; i < in.size && !emulator_failed(e); i++) {
        stm32_usart_receive(e, port, in.data[i]);
        emulator_run(e, false);
    }
}

static void asked(emulator_t *e, int port) {
    if (port != STM32_STORAGE) {
        stm32_usart_sent(e, port);
    }
}

static size_t take(emulator_t *e, int port, bytes_mut_t out) {
    if (port == STM32_STORAGE) {
        return stm32_storage_take(e, out);
    }
    return out.size == 0 ? 0 : stm32_usart_take(e, port, out.data);
}

static int64_t alarm_ns(emulator_t *e) {
    stm32_chip_t *chip = stm32_chip(e);
    if (chip->alarm_ns == INT64_MIN) {
        int64_t timers_ns = stm32_timers_alarm_ns(e);
        int64_t systick_ns = cortex_m_alarm_ns(e);
        chip->alarm_ns = timers_ns < systick_ns ? timers_ns : systick_ns;
    }
    return chip->alarm_ns;
}

static void alarm(emulator_t *e) {
    stm32_timers_settle(e);
    cortex_m_alarm(e);
    stm32_chip(e)->alarm_ns = INT64_MIN;
}

static void reset_stamp(emulator_t *e) {
    if ((stm32_chip(e)->exti_mask & EXTI_LINE_0) != 0) {
        raise_exti(e, EXTI_LINE_0);
    }
}

const machine_t stm32_machine = {
    .name = "stm32",
    .cpu = &cortex_m,
    .memories = {{FLASH, FLASH_BYTES, false}, {RAM, RAM_BYTES, true}},
    .devices = {{0x40000000, 0x8000}, {0x40010000, 0x6000}, {0x40020000, 0x4000}, {0xE000E000, 0x1000}},
    .state_bytes = sizeof(stm32_chip_t),
    .reset = reset,
    .read = chip_read,
    .write = chip_write,
    .receive = receive,
    .asked = asked,
    .take = take,
    .alarm_ns = alarm_ns,
    .alarm = alarm,
    .byte_ps = stm32_usart_byte_ps,
    .reset_stamp = reset_stamp,
};
