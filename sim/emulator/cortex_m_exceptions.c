#include "cortex_m_parts.h"

enum {
    XPSR_EXCEPTION = 0x1FF,
    XPSR_ALIGNED = 1 << 9, ///< in a frame: four bytes were left out before it
    CONTROL_UNPRIVILEGED = 1,
    CONTROL_PSP = 2,
    CONTROL_FPU = 4,
    RETURN_THREAD = 1 << 3, ///< EXC_RETURN
    RETURN_PSP = 1 << 2,
    RETURN_NO_FPU = 1 << 4,
    FRAME_BYTES = 32,
    FRAME_FPU_BYTES = 104,
    FRAME_FPU_AT = 32,
    FRAME_FPSCR_AT = 96,
    FPU_DOUBLES = 8, ///< S0 to S15
    FPU_ENABLED = 0xF << 20,
};
static const uint32_t EXC_RETURN = 0xFFFFFFE1U;

/// Registers that go into a frame, and those that decide how; in this order.
enum { R0, R1, R2, R3, R12, LR, XPSR, CONTROL, SP, FAULTMASK, PRIMASK, BASEPRI, REGISTERS };
static const unicorn_reg_t READ[REGISTERS] = {
    UNICORN_REG_ARM_R0,  UNICORN_REG_ARM_R1,        UNICORN_REG_ARM_R2,      UNICORN_REG_ARM_R3,
    UNICORN_REG_ARM_R12, UNICORN_REG_ARM_LR,        UNICORN_REG_ARM_XPSR,    UNICORN_REG_ARM_CONTROL,
    UNICORN_REG_ARM_SP,  UNICORN_REG_ARM_FAULTMASK, UNICORN_REG_ARM_PRIMASK, UNICORN_REG_ARM_BASEPRI,
};

static void read_some(emulator_t *e, uint32_t *values, int first, int count) {
    int regs[REGISTERS];
    void *places[REGISTERS];
    for (int i = 0; i < count; i++) {
        regs[i] = e->api->registers[READ[first + i]];
        places[i] = &values[first + i];
    }
    e->api->read_batch(e->engine, regs, places, count);
}

typedef struct {
    unicorn_reg_t reg;
    uint32_t value;
} setting_t;

static void write_some(emulator_t *e, setting_t *settings, int count) {
    int regs[REGISTERS];
    void *places[REGISTERS];
    for (int i = 0; i < count; i++) {
        regs[i] = e->api->registers[settings[i].reg];
        places[i] = &settings[i].value;
    }
    e->api->write_batch(e->engine, regs, places, count);
}

/// S0 to S15 and FPSCR: Unicorn's numbers, and places for what they hold.
enum { FPU_REGISTERS = FPU_DOUBLES + 1 };
typedef struct {
    uint64_t doubles[FPU_DOUBLES];
    uint32_t fpscr;
    int regs[FPU_REGISTERS];
    void *places[FPU_REGISTERS];
} fpu_t;

static void name_fpu(emulator_t *e, fpu_t *fpu) {
    for (int i = 0; i < FPU_DOUBLES; i++) {
        fpu->regs[i] = e->api->registers[UNICORN_REG_ARM_D0] + i;
        fpu->places[i] = &fpu->doubles[i];
    }
    fpu->regs[FPU_DOUBLES] = e->api->registers[UNICORN_REG_ARM_FPSCR];
    fpu->places[FPU_DOUBLES] = &fpu->fpscr;
}

static void save_fpu(emulator_t *e, uint8_t *frame) {
    fpu_t fpu;
    name_fpu(e, &fpu);
    e->api->read_batch(e->engine, fpu.regs, fpu.places, FPU_REGISTERS);
    for (int i = 0; i < FPU_DOUBLES; i++) {
        store64_le(frame + FRAME_FPU_AT + 8 * i, fpu.doubles[i]);
    }
    store32_le(frame + FRAME_FPSCR_AT, fpu.fpscr);
    store32_le(frame + FRAME_FPSCR_AT + 4, 0);
}

static void restore_fpu(emulator_t *e, const uint8_t *frame) {
    fpu_t fpu;
    name_fpu(e, &fpu);
    for (int i = 0; i < FPU_DOUBLES; i++) {
        fpu.doubles[i] = load64_le(frame + FRAME_FPU_AT + 8 * i);
    }
    fpu.fpscr = load32_le(frame + FRAME_FPSCR_AT);
    e->api->write_batch(e->engine, fpu.regs, fpu.places, FPU_REGISTERS);
}

static uint32_t vector(emulator_t *e, int exception) {
    const nvic_t *nvic = &cortex_m_of(e)->nvic;
    uint32_t table = nvic->vectors == 0 ? CORTEX_M_FLASH : nvic->vectors;
    const uint8_t *at = emulator_at(e, table + (uint32_t)exception * VECTOR_BYTES, VECTOR_BYTES);
    uint32_t address = at == NULL ? 0 : load32_le(at);
    if ((address & 1) == 0) {
        emulator_fail(e, "exception %d has no handler: its vector is 0x%08x", exception, address);
    }
    return address & ~1U;
}

static bool fpu_is_on(emulator_t *e) {
    if ((cortex_m_of(e)->nvic.fpu & FPU_ENABLED) != FPU_ENABLED) {
        emulator_fail(e, "the FPU was used before CPACR enabled it");
        return false;
    }
    return true;
}

static void push_frame(emulator_t *e, const uint32_t *values, uint32_t return_value) {
    cortex_m_t *cpu = cortex_m_of(e);
    bool fpu = (values[CONTROL] & CONTROL_FPU) != 0;
    uint32_t bytes = fpu ? FRAME_FPU_BYTES : FRAME_BYTES;
    uint32_t sp = (values[SP] - bytes) & ~7U;
    uint8_t *frame = emulator_ram_at(e, sp, bytes);
    if (frame == NULL) {
        emulator_fail(e, "the stack is full: no room for an exception's frame at 0x%08x", sp);
        return;
    }
    if (fpu && !fpu_is_on(e)) {
        return;
    }
    for (int i = R0; i <= LR; i++) {
        store32_le(frame + 4 * i, values[i]);
    }
    store32_le(frame + 24, cpu->pc);
    store32_le(frame + 28, values[XPSR] | ((values[SP] & 4) != 0 ? XPSR_ALIGNED : 0U));
    if (fpu) {
        save_fpu(e, frame);
    }
    write_some(e, (setting_t[]){{UNICORN_REG_ARM_SP, sp}, {UNICORN_REG_ARM_LR, return_value}}, 2);
}

// The flags are not defined at the start of a handler.
static void go_to_handler(emulator_t *e, bool control_is_clear) {
    cortex_m_t *cpu = cortex_m_of(e);
    int exception = cpu->nvic.next;
    nvic_begin(&cpu->nvic, exception);
    cpu->running[cpu->depth++] = (uint8_t)exception;
    cpu->pc = vector(e, exception);
    if (!control_is_clear) { // before the other: a handler cannot choose the stack
        cortex_m_set(e, UNICORN_REG_ARM_CONTROL, 0);
    }
    cortex_m_set(e, UNICORN_REG_ARM_XPSR_NZCVQG, XPSR_THUMB | (uint32_t)exception);
}

static outcome_t allowed(const nvic_t *nvic, const uint32_t *values) {
    int priority = nvic_priority(nvic, nvic->next);
    if (priority >= 0 && (values[FAULTMASK] & 1) != 0) {
        return HELD;
    }
    uint32_t threshold = values[BASEPRI] & (0xFFFFFFFEU << nvic->grouping);
    if (values[BASEPRI] != 0 && priority >= (int)threshold) {
        return HELD;
    }
    return priority >= 0 && (values[PRIMASK] & 1) != 0 ? HELD_BY_PRIMASK : TAKEN;
}

outcome_t cortex_m_take(emulator_t *e) {
    cortex_m_t *cpu = cortex_m_of(e);
    if (cpu->nvic.next == 0) {
        return NOTHING;
    }
    uint32_t values[REGISTERS];
    int first = cpu->parked != 0 ? CONTROL : R0;
    read_some(e, values, first, REGISTERS - first);
    outcome_t outcome = allowed(&cpu->nvic, values);
    if (outcome != TAKEN) {
        return outcome;
    }
    if (cpu->parked != 0) {
        cortex_m_set(e, UNICORN_REG_ARM_LR, cpu->parked);
        cpu->parked = 0;
        go_to_handler(e, values[CONTROL] == 0);
        return TAKEN;
    }
    if ((values[CONTROL] & CONTROL_UNPRIVILEGED) != 0) {
        emulator_fail(e, "code runs unprivileged, which is not modelled");
    }
    uint32_t return_value = EXC_RETURN | ((values[CONTROL] & CONTROL_FPU) != 0 ? 0U : RETURN_NO_FPU);
    if (cpu->depth == 0) {
        return_value |= RETURN_THREAD | ((values[CONTROL] & CONTROL_PSP) != 0 ? RETURN_PSP : 0U);
    }
    push_frame(e, values, return_value);
    if (!emulator_failed(e)) {
        go_to_handler(e, values[CONTROL] == 0);
    }
    return TAKEN;
}

static void pop_frame(emulator_t *e, uint32_t msp, uint32_t return_value) {
    bool fpu = (return_value & RETURN_NO_FPU) == 0;
    bool psp = (return_value & RETURN_PSP) != 0;
    uint32_t sp = psp ? cortex_m_get(e, UNICORN_REG_ARM_PSP) : msp;
    uint32_t bytes = fpu ? FRAME_FPU_BYTES : FRAME_BYTES;
    const uint8_t *frame = emulator_at(e, sp, bytes);
    if (frame == NULL) {
        emulator_fail(e, "an exception returns to a frame at 0x%08x, where there is no memory", sp);
        return;
    }
    uint32_t xpsr = load32_le(frame + 28);
    bool thread = (return_value & RETURN_THREAD) != 0;
    if ((xpsr & XPSR_THUMB) == 0 || thread != ((xpsr & XPSR_EXCEPTION) == 0) ||
        thread != (cortex_m_of(e)->depth == 0)) {
        emulator_fail(e, "an exception returns with 0x%08x to a frame at 0x%08x whose xPSR is 0x%08x",
                      return_value, sp, xpsr);
        return;
    }
    if (fpu && !fpu_is_on(e)) {
        return;
    }
    cortex_m_of(e)->pc = load32_le(frame + 24) & ~1U;
    sp += bytes + ((xpsr & XPSR_ALIGNED) != 0 ? 4 : 0);
    write_some(e,
               (setting_t[]){{UNICORN_REG_ARM_XPSR_NZCVQG, xpsr & ~(uint32_t)XPSR_ALIGNED},
                             {UNICORN_REG_ARM_CONTROL, (psp ? CONTROL_PSP : 0U) | (fpu ? CONTROL_FPU : 0U)},
                             {UNICORN_REG_ARM_SP, sp},
                             {UNICORN_REG_ARM_R0, load32_le(frame)},
                             {UNICORN_REG_ARM_R1, load32_le(frame + 4)},
                             {UNICORN_REG_ARM_R2, load32_le(frame + 8)},
                             {UNICORN_REG_ARM_R3, load32_le(frame + 12)},
                             {UNICORN_REG_ARM_R12, load32_le(frame + 16)},
                             {UNICORN_REG_ARM_LR, load32_le(frame + 20)}},
               9);
    if (fpu) {
        restore_fpu(e, frame);
    }
}

void cortex_m_leave(emulator_t *e) {
    cortex_m_t *cpu = cortex_m_of(e);
    uint32_t return_value = cpu->pc | 1;
    uint32_t kind = return_value & (RETURN_THREAD | RETURN_PSP);
    if ((return_value & ~(uint32_t)(RETURN_THREAD | RETURN_PSP | RETURN_NO_FPU)) != EXC_RETURN ||
        kind == RETURN_PSP) {
        emulator_fail(e, "a handler returns to 0x%08x", return_value);
        return;
    }
    nvic_end(&cpu->nvic, cpu->running[--cpu->depth]);
    uint32_t values[REGISTERS];
    read_some(e, values, SP, cpu->nvic.next == 0 ? 2 : REGISTERS - SP);
    if ((values[FAULTMASK] & 1) != 0) {
        cortex_m_set(e, UNICORN_REG_ARM_FAULTMASK, 0);
        values[FAULTMASK] = 0;
    }
    if (cpu->nvic.next != 0 && allowed(&cpu->nvic, values) == TAKEN) {
        cortex_m_set(e, UNICORN_REG_ARM_LR, return_value);
        go_to_handler(e, false);
    } else if (cpu->nvic.sleep_on_exit && cpu->depth == 0 && (return_value & RETURN_THREAD) != 0) {
        cpu->parked = return_value;
        cpu->asleep = true;
    } else {
        pop_frame(e, values[SP], return_value);
    }
}

void cortex_m_unpark(emulator_t *e) {
    cortex_m_t *cpu = cortex_m_of(e);
    pop_frame(e, cortex_m_get(e, UNICORN_REG_ARM_SP), cpu->parked);
    cpu->parked = 0;
}

bool cortex_m_may_take(emulator_t *e) {
    uint32_t values[REGISTERS];
    read_some(e, values, FAULTMASK, 3);
    return allowed(&cortex_m_of(e)->nvic, values) == TAKEN;
}
