#include "stm32.h"

#include <string.h>

/// firmware/stm32/board/registers.h, storage_t. No STM32 has this: it stands where the SDIO is.
enum { REQUEST = 0x00, SIZE = 0x04, ANSWER = 0x08, ROOM = 0x0C, ANSWERED = 0x10, IRQ_SDIO = 49 };

uint32_t stm32_storage_read(emulator_t *e, uint32_t offset) {
    return offset == ANSWERED ? stm32_chip(e)->storage.answered : 0;
}

void stm32_storage_write(emulator_t *e, uint32_t offset, uint32_t value) {
    stm32_mailbox_t *mailbox = &stm32_chip(e)->storage;
    switch (offset) {
    case REQUEST:
        mailbox->request = value;
        break;
    case SIZE:
        if (mailbox->size != 0 || value == 0 || emulator_at(e, mailbox->request, value) == NULL) {
            emulator_fail(e,
                          "storage: a request of %u bytes at 0x%08x, which is no memory, or one is under way",
                          value, mailbox->request);
            return;
        }
        mailbox->size = value;
        break;
    case ANSWER:
        mailbox->answer = value;
        break;
    case ROOM:
        mailbox->room = value;
        break;
    default:
        mailbox->answered = 0;
        cortex_m_line(e, IRQ_SDIO, false);
        break;
    }
}

size_t stm32_storage_take(emulator_t *e, bytes_mut_t out) {
    stm32_mailbox_t *mailbox = &stm32_chip(e)->storage;
    const size_t size = mailbox->size < out.size ? mailbox->size : out.size;
    if (mailbox->taken || size == 0) {
        return 0;
    }
    mailbox->taken = true;
    memcpy(out.data, emulator_at(e, mailbox->request, size), size);
    return size;
}

void stm32_storage_receive(emulator_t *e, bytes_t in) {
    stm32_mailbox_t *mailbox = &stm32_chip(e)->storage;
    uint8_t *out = emulator_ram_at(e, mailbox->answer, in.size);
    if (in.size > mailbox->room || out == NULL) {
        emulator_fail(e, "storage: there is no room at 0x%08x for an answer of %zu bytes", mailbox->answer,
                      in.size);
        return;
    }
    memcpy(out, in.data, in.size);
    mailbox->answered = (uint32_t)in.size;
    mailbox->size = 0;
    mailbox->taken = false;
    cortex_m_line(e, IRQ_SDIO, true);
}
