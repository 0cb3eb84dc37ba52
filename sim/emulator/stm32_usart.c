#include "stm32.h"

/// RM0090, 30.6.
enum {
    SR = 0x00,
    DR = 0x04,
    BRR = 0x08,
    CR1 = 0x0C,
    CR2 = 0x10,
    CR3 = 0x14,
    SR_FE = 1 << 1,
    SR_ORE = 1 << 3,
    SR_RXNE = 1 << 5,
    SR_TC = 1 << 6,
    SR_TXE = 1 << 7,
    SR_WRITE_ZERO = SR_RXNE | SR_TC,
    SR_RESET = SR_TC | SR_TXE,
    CR1_RE = 1 << 2,
    CR1_TE = 1 << 3,
    CR1_RXNEIE = 1 << 5,
    CR1_TCIE = 1 << 6,
    CR1_TXEIE = 1 << 7,
    CR1_UE = 1 << 13,
    CR1_MODELLED = CR1_RE | CR1_TE | CR1_RXNEIE | CR1_TCIE | CR1_TXEIE | CR1_UE,
    BITS = 10, ///< start, eight, stop
    BAUD_MAX = 0xFFFF,
    BAUD_MIN = 16,
    MISMATCH_PERCENT = 4, ///< half a bit at the stop bit, less the sampling's own error (30.3.5)
};

static const struct {
    const char *name;
    int irq;
    int clock; ///< bit of RCC_APB1ENR
} USARTS[STM32_USARTS] = {[STM32_USART3] = {"USART3", 39, 18}, [STM32_USART2] = {"USART2", 38, 17}};

static usart_t *usart_of(emulator_t *e, int index) {
    return &stm32_chip(e)->usarts[index];
}

static void set_line(emulator_t *e, int index) {
    const usart_t *usart = usart_of(e, index);
    uint32_t enabled = usart->control1;
    uint32_t causes = ((enabled & CR1_RXNEIE) != 0 ? SR_RXNE | SR_ORE : 0U) |
                      ((enabled & CR1_TCIE) != 0 ? SR_TC : 0U) | ((enabled & CR1_TXEIE) != 0 ? SR_TXE : 0U);
    cortex_m_line(e, USARTS[index].irq, (usart->status & causes) != 0);
}

void stm32_usart_reset(usart_t *usart) {
    usart->status = SR_RESET;
}

static uint32_t read_data(usart_t *usart) {
    usart->status &= ~(uint32_t)SR_RXNE;
    if (usart->status_read) {
        usart->status &= ~(uint32_t)(SR_ORE | SR_FE);
    }
    usart->status_read = false;
    return usart->received;
}

uint32_t stm32_usart_read(emulator_t *e, int index, uint32_t offset) {
    usart_t *usart = usart_of(e, index);
    if (!stm32_has_clock(e, USARTS[index].name, USARTS[index].clock)) {
        return 0;
    }
    uint32_t value;
    switch (offset) {
    case SR:
        usart->status_read = true;
        return usart->status;
    case DR:
        value = read_data(usart);
        set_line(e, index);
        return value;
    case BRR:
        return usart->baud;
    case CR1:
        return usart->control1;
    case CR2:
        return usart->control2;
    case CR3:
        return usart->control3;
    default:
        return 0;
    }
}

static void write_data(emulator_t *e, int index, uint8_t byte) {
    usart_t *usart = usart_of(e, index);
    if ((usart->control1 & (CR1_UE | CR1_TE)) != (CR1_UE | CR1_TE) || usart->baud < BAUD_MIN) {
        emulator_fail(e, "%s: DR was written while CR1 is 0x%x and BRR %u: it cannot send",
                      USARTS[index].name, usart->control1, usart->baud);
    }
    if (usart->status_read) {
        usart->status &= ~(uint32_t)SR_TC;
    }
    usart->status_read = false;
    if (usart->sender == SENDER_IDLE) {
        usart->sending = byte;
        usart->sender = SENDER_WRITTEN;
    } else { // if one waits already it is lost, as there
        usart->waiting = byte;
        usart->status &= ~(uint32_t)SR_TXE;
    }
}

void stm32_usart_write(emulator_t *e, int index, uint32_t offset, uint32_t value) {
    usart_t *usart = usart_of(e, index);
    if (!stm32_has_clock(e, USARTS[index].name, USARTS[index].clock)) {
        return;
    }
    bool modelled = true;
    switch (offset) {
    case SR:
        usart->status &= value | ~(uint32_t)SR_WRITE_ZERO;
        break;
    case DR:
        write_data(e, index, (uint8_t)value);
        break;
    case BRR:
        usart->baud = value & BAUD_MAX;
        break;
    case CR1:
        usart->control1 = value;
        modelled = (value & ~(uint32_t)CR1_MODELLED) == 0;
        break;
    case CR2:
        usart->control2 = value;
        modelled = value == 0;
        break;
    case CR3:
        usart->control3 = value;
        modelled = value == 0;
        break;
    default:
        modelled = value == 0;
        break;
    }
    if (!modelled) {
        emulator_fail(
            e, "%s: 0x%x was written to its register 0x%02x, which asks for something that is not modelled",
            USARTS[index].name, value, offset);
    }
    set_line(e, index);
}

static bool mismatch(emulator_t *e, int index) {
    int64_t wire_ps = e->wire_byte_ps[index];
    int64_t own_ps = stm32_usart_byte_ps(e, index);
    int64_t difference_ps = own_ps > wire_ps ? own_ps - wire_ps : wire_ps - own_ps;
    return wire_ps != 0 && difference_ps * 100 > wire_ps * MISMATCH_PERCENT;
}

void stm32_usart_receive(emulator_t *e, int index, uint8_t byte) {
    usart_t *usart = usart_of(e, index);
    if ((usart->control1 & (CR1_UE | CR1_RE)) != (CR1_UE | CR1_RE)) {
        return;
    }
    if ((usart->status & SR_RXNE) != 0) {
        usart->status |= SR_ORE; // DR keeps the byte before
    } else {
        usart->received = byte;
        usart->status |= SR_RXNE | (mismatch(e, index) ? SR_FE : 0U);
    }
    set_line(e, index);
}

void stm32_usart_sent(emulator_t *e, int index) {
    usart_t *usart = usart_of(e, index);
    if (usart->sender != SENDER_ON_LINE) {
        return;
    }
    if ((usart->status & SR_TXE) == 0) {
        usart->sending = usart->waiting;
        usart->sender = SENDER_WRITTEN;
        usart->status |= SR_TXE;
    } else {
        usart->sender = SENDER_IDLE;
        usart->status |= SR_TC;
    }
    set_line(e, index);
}

size_t stm32_usart_take(emulator_t *e, int index, uint8_t *byte) {
    usart_t *usart = usart_of(e, index);
    if (usart->sender != SENDER_WRITTEN) {
        return 0;
    }
    usart->sender = SENDER_ON_LINE;
    *byte = usart->sending;
    return 1;
}

int64_t stm32_usart_byte_ps(emulator_t *e, int index) {
    // BRR cycles of the bus take one bit (30.3.4), and a cycle 1e9/kHz ps.
    int64_t khz = stm32_chip(e)->clocks.apb1_khz;
    return ((int64_t)usart_of(e, index)->baud * BITS * 1000000000 + khz / 2) / khz;
}
