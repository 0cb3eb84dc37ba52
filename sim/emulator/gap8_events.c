#include "gap8.h"

enum { IRQ_MASK = 0x0C, IRQ_MASK_AND = 0x10, IRQ_MASK_OR = 0x14, BUFFER = 0x1C, BUFFER_CLEAR = 0x28 };

static const uint32_t SOC_EVENT_VALID = 0x80000000;

static void update(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    if (m->soc_count != 0) {
        m->buffer |= 1U << GAP8_LINE_SOC;
    }
    rv32_lines(e, m->buffer & m->irq_mask);
}

void gap8_raise(emulator_t *e, int line) {
    gap8_of(e)->buffer |= 1U << line;
    update(e);
}

void gap8_soc_event(emulator_t *e, uint32_t event) {
    gap8_machine_t *m = gap8_of(e);
    if ((m->soc_masks[event < 32 ? 1 : 0] >> (event % 32) & 1) != 0) {
        return;
    }
    if (m->soc_count == GAP8_EVENTS_MAX) {
        emulator_fail(e, "event %u of the SoC is lost: %u others wait", event, m->soc_count);
        return;
    }
    m->soc_events[m->soc_count++] = (uint8_t)event;
    update(e);
}

uint32_t gap8_soc_event_pop(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    if (m->soc_count == 0) {
        return 0;
    }
    const uint32_t oldest = m->soc_events[0];
    m->soc_count--;
    memmove(m->soc_events, m->soc_events + 1, m->soc_count);
    return SOC_EVENT_VALID | oldest;
}

bool gap8_event_unit_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    const gap8_machine_t *m = gap8_of(e);
    switch (offset) {
    case IRQ_MASK:
        *value = m->irq_mask;
        return true;
    case BUFFER:
        *value = m->buffer;
        return true;
    default:
        return false;
    }
}

bool gap8_event_unit_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_machine_t *m = gap8_of(e);
    switch (offset) {
    case IRQ_MASK:
        m->irq_mask = value;
        break;
    case IRQ_MASK_AND: // clears what is set in the value
        m->irq_mask &= ~value;
        break;
    case IRQ_MASK_OR:
        m->irq_mask |= value;
        break;
    case BUFFER_CLEAR:
        m->buffer &= ~value;
        break;
    default:
        return false;
    }
    update(e);
    return true;
}
