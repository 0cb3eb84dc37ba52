/// Private to the Cortex-M: cortex_m.c runs the code and finds out why it has stopped, cortex_m_exceptions.c
/// takes exceptions and returns from them.
#ifndef SPINDECK_SIM_CORTEX_M_PARTS_H
#define SPINDECK_SIM_CORTEX_M_PARTS_H

#include "cortex_m.h"

enum {
    XPSR_THUMB = 1 << 24,
    VECTOR_BYTES = 4,
    CORTEX_M_FLASH = 0x08000000, ///< also at 0, where VTOR points after a reset
};

typedef enum { NOTHING, TAKEN, HELD_BY_PRIMASK, HELD } outcome_t;

/// Takes the most urgent exception, if it may be taken.
outcome_t cortex_m_take(emulator_t *e);

/// Whether cortex_m_take would take the one that nvic.next names, which is not 0.
bool cortex_m_may_take(emulator_t *e);

/// A handler has ended with EXC_RETURN in pc: the next one follows without a new frame, or what was
/// interrupted goes on, or with SLEEPONEXIT the core sleeps, and the frame waits for the next handler.
void cortex_m_leave(emulator_t *e);

/// What wakes a core that sleeps so is held back: what was interrupted goes on.
void cortex_m_unpark(emulator_t *e);

static inline cortex_m_t *cortex_m_of(const emulator_t *e) {
    return e->cpu_state;
}

static inline uint32_t cortex_m_get(const emulator_t *e, unicorn_reg_t reg) {
    uint32_t value = 0;
    e->api->read(e->engine, e->api->registers[reg], &value);
    return value;
}

static inline void cortex_m_set(const emulator_t *e, unicorn_reg_t reg, uint32_t value) {
    e->api->write(e->engine, e->api->registers[reg], &value);
}

#endif
