#include "cortex_m.h"

#include <stdio.h>
#include <string.h>

enum {
    XPSR_EXCEPTION = 0x1FF,
    XPSR_ALIGNED = 1 << 9, ///< in a frame: four bytes were left out before it
    XPSR_IT = 0x0600FC00,
    XPSR_THUMB = 1 << 24,
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
    VECTOR_BYTES = 4,
    WFI = 0xBF30,
    WFI_WIDE = 0xF3AF,
    WFI_WIDE_SECOND = 0x8003,
    WFI_BYTES = 2,
    CPSIE = 0xB662, ///< i
    CPSIE_BYTES = 2,
    RETURN_PAGE_BYTES = 4096,
};
static const uint32_t EXC_RETURN = 0xFFFFFFE1U;
static const uint32_t RETURN_PAGE_AT = 0xFFFFF000U;
static const uint32_t FLASH = 0x08000000U; ///< also at 0, where VTOR points after a reset

/// What Unicorn says it cannot do (QEMU's EXCP_ numbers).
enum { INTERRUPT_SVC = 2, INTERRUPT_BKPT = 7, INTERRUPT_RETURN = 8 };

/// A handler's return address points into the last page. What it finds there is wfi, which stops it.
_Alignas(RETURN_PAGE_BYTES) static const uint16_t RETURN_PAGE[RETURN_PAGE_BYTES / 2] = {
    [0 ... RETURN_PAGE_BYTES / 2 - 1] = WFI};

/// Registers that go into a frame, and those that decide how; in this order.
enum { R0, R1, R2, R3, R12, LR, XPSR, CONTROL, SP, FAULTMASK, PRIMASK, BASEPRI, REGISTERS };
static const unicorn_reg_t READ[REGISTERS] = {
    UNICORN_REG_ARM_R0,  UNICORN_REG_ARM_R1,        UNICORN_REG_ARM_R2,      UNICORN_REG_ARM_R3,
    UNICORN_REG_ARM_R12, UNICORN_REG_ARM_LR,        UNICORN_REG_ARM_XPSR,    UNICORN_REG_ARM_CONTROL,
    UNICORN_REG_ARM_SP,  UNICORN_REG_ARM_FAULTMASK, UNICORN_REG_ARM_PRIMASK, UNICORN_REG_ARM_BASEPRI,
};

static cortex_m_t *cpu_of(emulator_t *e) {
    return e->cpu_state;
}

static uint32_t read(emulator_t *e, unicorn_reg_t reg) {
    uint32_t value = 0;
    e->api->read(e->engine, e->api->registers[reg], &value);
    return value;
}

static void write(emulator_t *e, unicorn_reg_t reg, uint32_t value) {
    e->api->write(e->engine, e->api->registers[reg], &value);
}

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

static void save_fpu(emulator_t *e, uint8_t *frame) {
    for (int i = 0; i < FPU_DOUBLES; i++) {
        uint64_t value = 0;
        e->api->read(e->engine, e->api->registers[UNICORN_REG_ARM_D0] + i, &value);
        store64_le(frame + FRAME_FPU_AT + 8 * i, value);
    }
    store32_le(frame + FRAME_FPSCR_AT, read(e, UNICORN_REG_ARM_FPSCR));
    store32_le(frame + FRAME_FPSCR_AT + 4, 0);
}

static void restore_fpu(emulator_t *e, const uint8_t *frame) {
    for (int i = 0; i < FPU_DOUBLES; i++) {
        uint64_t value = load64_le(frame + FRAME_FPU_AT + 8 * i);
        e->api->write(e->engine, e->api->registers[UNICORN_REG_ARM_D0] + i, &value);
    }
    write(e, UNICORN_REG_ARM_FPSCR, load32_le(frame + FRAME_FPSCR_AT));
}

static uint32_t vector(emulator_t *e, int exception) {
    const nvic_t *nvic = &cpu_of(e)->nvic;
    uint32_t table = nvic->vectors == 0 ? FLASH : nvic->vectors;
    const uint8_t *at = emulator_at(e, table + (uint32_t)exception * VECTOR_BYTES, VECTOR_BYTES);
    uint32_t address = at == NULL ? 0 : load32_le(at);
    if ((address & 1) == 0) {
        emulator_fail(e, "exception %d has no handler: its vector is 0x%08x", exception, address);
    }
    return address & ~1U;
}

static bool fpu_is_on(emulator_t *e) {
    if ((cpu_of(e)->nvic.fpu & FPU_ENABLED) != FPU_ENABLED) {
        emulator_fail(e, "the FPU was used before CPACR enabled it");
        return false;
    }
    return true;
}

static void push_frame(emulator_t *e, const uint32_t *values, uint32_t return_value) {
    cortex_m_t *cpu = cpu_of(e);
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
    cortex_m_t *cpu = cpu_of(e);
    int exception = cpu->nvic.next;
    nvic_begin(&cpu->nvic, exception);
    cpu->running[cpu->depth++] = (uint8_t)exception;
    cpu->pc = vector(e, exception);
    if (!control_is_clear) { // before the other: a handler cannot choose the stack
        write(e, UNICORN_REG_ARM_CONTROL, 0);
    }
    write(e, UNICORN_REG_ARM_XPSR_NZCVQG, XPSR_THUMB | (uint32_t)exception);
}

typedef enum { NOTHING, TAKEN, HELD_BY_PRIMASK, HELD } outcome_t;

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

/// Takes the most urgent exception, if it may be taken.
static outcome_t take(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
    if (cpu->nvic.next == 0) {
        return NOTHING;
    }
    uint32_t values[REGISTERS];
    read_some(e, values, R0, REGISTERS);
    outcome_t outcome = allowed(&cpu->nvic, values);
    if (outcome != TAKEN) {
        return outcome;
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
    uint32_t sp = psp ? read(e, UNICORN_REG_ARM_PSP) : msp;
    uint32_t bytes = fpu ? FRAME_FPU_BYTES : FRAME_BYTES;
    const uint8_t *frame = emulator_at(e, sp, bytes);
    if (frame == NULL) {
        emulator_fail(e, "an exception returns to a frame at 0x%08x, where there is no memory", sp);
        return;
    }
    uint32_t xpsr = load32_le(frame + 28);
    bool thread = (return_value & RETURN_THREAD) != 0;
    if ((xpsr & XPSR_THUMB) == 0 || thread != ((xpsr & XPSR_EXCEPTION) == 0) ||
        thread != (cpu_of(e)->depth == 0)) {
        emulator_fail(e, "an exception returns with 0x%08x to a frame at 0x%08x whose xPSR is 0x%08x",
                      return_value, sp, xpsr);
        return;
    }
    if (fpu && !fpu_is_on(e)) {
        return;
    }
    cpu_of(e)->pc = load32_le(frame + 24) & ~1U;
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

/// A handler has ended with EXC_RETURN in cpu->pc: the next one follows without a new frame, or what was
/// interrupted goes on.
static void leave(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
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
        write(e, UNICORN_REG_ARM_FAULTMASK, 0);
        values[FAULTMASK] = 0;
    }
    if (cpu->nvic.next != 0 && allowed(&cpu->nvic, values) == TAKEN) {
        write(e, UNICORN_REG_ARM_LR, return_value);
        go_to_handler(e, false);
    } else {
        pop_frame(e, values[SP], return_value);
    }
}

static void call_supervisor(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
    nvic_pend(&cpu->nvic, EXCEPTION_SVC);
    if (cpu->nvic.next != EXCEPTION_SVC || take(e) != TAKEN) {
        emulator_fail(e, "svc where its priority does not allow it");
    }
}

static void on_interrupt(unicorn_t *engine, uint32_t number, void *user) {
    emulator_t *e = user;
    cpu_of(e)->interrupt = (int)number;
    cpu_of(e)->stop = STOPPED_OTHER;
    e->api->stop(engine);
}

static void on_block(unicorn_t *engine, uint64_t address, uint32_t size, void *user) {
    emulator_t *e = user;
    cortex_m_t *cpu = cpu_of(e);
    (void)size;
    cpu->pc = (uint32_t)address;
    if (e->blocks_left == 0) {
        emulator_fail(e, "the code has run %d blocks without going to sleep", EMULATOR_BLOCKS_MAX);
        return;
    }
    e->blocks_left--;
    if (cpu->nvic.next == 0) {
        return;
    }
    uint32_t values[REGISTERS];
    read_some(e, values, FAULTMASK, 3);
    if (allowed(&cpu->nvic, values) == TAKEN) {
        cpu->stop = STOPPED_TO_INTERRUPT;
        e->api->stop(engine);
    }
}

static bool on_bad_access(unicorn_t *engine, int type, uint64_t address, int size, int64_t value,
                          void *user) {
    cortex_m_t *cpu = cpu_of(user);
    (void)engine;
    (void)value;
    cpu->access = type;
    cpu->access_address = (uint32_t)address;
    cpu->access_bytes = size;
    return false;
}

/// A hook for bad accesses would make all stores slow: so the one that has failed is done again, with a hook.
static void fail_on_access(emulator_t *e, int error) {
    cortex_m_t *cpu = cpu_of(e);
    size_t hook;
    e->api->add_hook(e->engine, &hook, e->api->hook_memory_invalid, (void *)on_bad_access, e, 1, 0);
    e->api->start(e->engine, cpu->pc | 1, 0, 0, 0);
    const char *what = cpu->access == e->api->access_write_protected  ? "write to flash"
                       : cpu->access == e->api->access_write_unmapped ? "write where nothing is"
                       : cpu->access == e->api->access_read_unmapped  ? "read where nothing is"
                                                                      : NULL;
    if (what == NULL) {
        emulator_fail(e, "%s", e->api->describe(error));
    } else {
        emulator_fail(e, "%s: %d bytes at 0x%08x", what, cpu->access_bytes, cpu->access_address);
    }
}

static void fail_on(emulator_t *e, int error) {
    const cortex_m_t *cpu = cpu_of(e);
    if (cpu->interrupt == INTERRUPT_BKPT) {
        emulator_fail(e, "breakpoint");
    } else if (cpu->interrupt >= 0) {
        emulator_fail(e, "exception %d of the CPU", cpu->interrupt);
    } else if (error == e->api->error_instruction) {
        emulator_fail(e, "undefined instruction");
    } else if (emulator_at(e, cpu->pc, WFI_BYTES) == NULL || emulator_ram_at(e, cpu->pc, WFI_BYTES) != NULL) {
        emulator_fail(e, "jump to 0x%08x, where no code is", cpu->pc);
    } else {
        fail_on_access(e, error);
    }
}

static bool is_wfi(const emulator_t *e, uint32_t pc) {
    const uint8_t *at = emulator_at(e, pc - 4, 4);
    return at != NULL &&
           (load16_le(at + 2) == WFI || (load16_le(at) == WFI_WIDE && load16_le(at + 2) == WFI_WIDE_SECOND));
}

/// Runs code from cpu->pc until it stops.
static void go(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
    cpu->stop = STOPPED_ASLEEP;
    cpu->interrupt = -1;
    int error = e->api->start(e->engine, cpu->pc | 1, 0, 0, 0);
    if (emulator_failed(e)) {
        return;
    }
    if (cpu->stop != STOPPED_TO_INTERRUPT) { // then cpu->pc is the block's, Unicorn's may be older
        cpu->pc = read(e, UNICORN_REG_ARM_PC);
    }
    if (cpu->stop == STOPPED_ASLEEP && cpu->pc > RETURN_PAGE_AT) {
        cpu->pc -= WFI_BYTES;
        cpu->interrupt = INTERRUPT_RETURN;
    }
    if (cpu->interrupt == INTERRUPT_RETURN && cpu->depth != 0) {
        leave(e);
    } else if (cpu->interrupt == INTERRUPT_RETURN) {
        emulator_fail(e, "jump to 0x%08x, where no code is", cpu->pc);
    } else if (cpu->interrupt == INTERRUPT_SVC) {
        call_supervisor(e);
    } else if (error != 0 || cpu->stop == STOPPED_OTHER) {
        fail_on(e, error);
    } else if (cpu->stop == STOPPED_ASLEEP) {
        if (cpu->pc == 0) {
            emulator_fail(e, "jump to 0");
        }
        cpu->asleep = is_wfi(e, cpu->pc); // else it was a hint to wait: yield, wfe
    }
}

/// Code that sleeps masked lets interrupts in as soon as it wakes: mostly by the next instruction, for which
/// it need not be started.
static bool let_in(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
    const uint8_t *at = emulator_at(e, cpu->pc, CPSIE_BYTES);
    if (at == NULL || load16_le(at) != CPSIE) {
        return false;
    }
    cpu->pc += CPSIE_BYTES;
    write(e, UNICORN_REG_ARM_PRIMASK, 0);
    return true;
}

static void run(emulator_t *e, bool thread) {
    cortex_m_t *cpu = cpu_of(e);
    while (!emulator_failed(e)) {
        outcome_t outcome = take(e);
        if (cpu->asleep) {
            // An exception that PRIMASK holds back wakes the code, which then lets it in.
            if (outcome != TAKEN && outcome != HELD_BY_PRIMASK) {
                return;
            }
            cpu->asleep = false;
            if (outcome == HELD_BY_PRIMASK && let_in(e)) {
                continue;
            }
        } else if (!thread && outcome != TAKEN && outcome != HELD_BY_PRIMASK && cpu->depth == 0) {
            return;
        }
        if (!emulator_failed(e)) {
            go(e);
        }
    }
}

static bool open(emulator_t *e) {
    const unicorn_api_t *api = e->api;
    size_t hook;
    int error = api->open(api->arch_arm, api->mode_arm, &e->engine);
    if (error == 0) {
        error = api->control(e->engine, api->control_cpu, api->cpu_arm);
    }
    if (error == 0) { // a Cortex-M has pages of 1024, of which Unicorn looks up many more
        error = api->control(e->engine, api->control_page, RETURN_PAGE_BYTES);
    }
    const struct {
        int type;
        void *callback;
    } hooks[] = {{api->hook_interrupt, (void *)on_interrupt}, {api->hook_block, (void *)on_block}};
    for (size_t i = 0; i < sizeof hooks / sizeof hooks[0] && error == 0; i++) {
        error = api->add_hook(e->engine, &hook, hooks[i].type, hooks[i].callback, e, 1, 0);
    }
    if (error == 0) {
        error = api->map_memory(e->engine, RETURN_PAGE_AT, RETURN_PAGE_BYTES,
                                (uint32_t)(api->rights_read | api->rights_execute),
                                (void *)(uintptr_t)RETURN_PAGE);
    }
    if (error != 0) {
        emulator_fail(e, "Unicorn cannot make a Cortex-M4: %s", api->describe(error));
    }
    return error == 0;
}

static void reset(emulator_t *e) {
    cortex_m_t *cpu = cpu_of(e);
    memset(cpu, 0, sizeof *cpu);
    cpu->nvic.enabled[0] = (1U << CORTEX_M_FIRST_IRQ) - 1;
    const uint8_t *table = emulator_at(e, FLASH, 2 * VECTOR_BYTES);
    cpu->pc = load32_le(table + VECTOR_BYTES) & ~1U;
    write(e, UNICORN_REG_ARM_SP, load32_le(table) & ~3U);
    write(e, UNICORN_REG_ARM_LR, UINT32_MAX);
}

// To know the PC, Unicorn 2.1.4 takes the state of the instruction at hand out of what it has noted of the
// block; so the rest of the block runs with that instruction's bits of an IT block, which nobody clears at
// its end.
static void looked_up(emulator_t *e) {
    write(e, UNICORN_REG_ARM_EPSR, XPSR_THUMB);
}

static void describe(emulator_t *e, char *out, size_t size) {
    const cortex_m_t *cpu = cpu_of(e);
    int used =
        snprintf(out, size, "; pc=0x%08x lr=0x%08x sp=0x%08x xpsr=0x%08x", cpu->pc,
                 read(e, UNICORN_REG_ARM_LR), read(e, UNICORN_REG_ARM_SP), read(e, UNICORN_REG_ARM_XPSR));
    for (int i = 0; i <= 12 && used > 0 && (size_t)used < size; i++) {
        used += snprintf(out + used, size - (size_t)used, " r%d=0x%08x", i,
                         read(e, (unicorn_reg_t)((int)UNICORN_REG_ARM_R0 + i)));
    }
}

const cpu_t cortex_m = {
    .state_bytes = sizeof(cortex_m_t),
    .open = open,
    .reset = reset,
    .run = run,
    .looked_up = looked_up,
    .describe = describe,
};
