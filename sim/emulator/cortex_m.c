#include "cortex_m_parts.h"

#include <stdio.h>
#include <string.h>

enum {
    WFI = 0xBF30,
    WFI_WIDE = 0xF3AF,
    WFI_WIDE_SECOND = 0x8003,
    WFI_BYTES = 2,
    CPSIE = 0xB662, ///< i
    CPSIE_BYTES = 2,
    RETURN_PAGE_BYTES = 4096,
};
static const uint32_t RETURN_PAGE_AT = 0xFFFFF000U;

/// What Unicorn says it cannot do (QEMU's EXCP_ numbers).
enum { INTERRUPT_SVC = 2, INTERRUPT_BKPT = 7, INTERRUPT_RETURN = 8 };

/// A handler's return address points into the last page. What it finds there is wfi, which stops it.
_Alignas(RETURN_PAGE_BYTES) static const uint16_t RETURN_PAGE[RETURN_PAGE_BYTES / 2] = {
    [0 ... RETURN_PAGE_BYTES / 2 - 1] = WFI};

static void call_supervisor(emulator_t *e) {
    cortex_m_t *cpu = cortex_m_of(e);
    nvic_pend(&cpu->nvic, EXCEPTION_SVC);
    if (cpu->nvic.next != EXCEPTION_SVC || cortex_m_take(e) != TAKEN) {
        emulator_fail(e, "svc where its priority does not allow it");
    }
}

static void on_interrupt(unicorn_t *engine, uint32_t number, void *user) {
    emulator_t *e = user;
    cortex_m_of(e)->interrupt = (int)number;
    cortex_m_of(e)->stop = STOPPED_OTHER;
    e->api->stop(engine);
}

static void on_block(unicorn_t *engine, uint64_t address, uint32_t size, void *user) {
    emulator_t *e = user;
    cortex_m_t *cpu = cortex_m_of(e);
    (void)size;
    cpu->pc = (uint32_t)address;
    if (emulator_may_go_on(e) && cpu->nvic.next != 0 && cortex_m_may_take(e)) {
        cpu->stop = STOPPED_TO_INTERRUPT;
        e->api->stop(engine);
    }
}

static void fail_on(emulator_t *e, int error) {
    const cortex_m_t *cpu = cortex_m_of(e);
    if (cpu->interrupt == INTERRUPT_BKPT) {
        emulator_fail(e, "breakpoint");
    } else if (cpu->interrupt >= 0) {
        emulator_fail(e, "exception %d of the CPU", cpu->interrupt);
    } else if (error == e->api->error_instruction) {
        emulator_fail(e, "undefined instruction");
    } else if (emulator_at(e, cpu->pc, WFI_BYTES) == NULL || emulator_ram_at(e, cpu->pc, WFI_BYTES) != NULL) {
        emulator_fail(e, "jump to 0x%08x, where no code is", cpu->pc);
    } else {
        emulator_fail_on_access(e, cpu->pc | 1, 0, error, "flash");
    }
}

static bool is_wfi(const emulator_t *e, uint32_t pc) {
    const uint8_t *at = emulator_at(e, pc - 4, 4);
    return at != NULL &&
           (load16_le(at + 2) == WFI || (load16_le(at) == WFI_WIDE && load16_le(at + 2) == WFI_WIDE_SECOND));
}

/// Runs code from cpu->pc until it stops.
static void go(emulator_t *e) {
    cortex_m_t *cpu = cortex_m_of(e);
    cpu->stop = STOPPED_ASLEEP;
    cpu->interrupt = -1;
    int error = e->api->start(e->engine, cpu->pc | 1, 0, 0, 0);
    if (emulator_failed(e)) {
        return;
    }
    if (cpu->stop != STOPPED_TO_INTERRUPT) { // then cpu->pc is the block's, Unicorn's may be older
        cpu->pc = cortex_m_get(e, UNICORN_REG_ARM_PC);
    }
    if (cpu->stop == STOPPED_ASLEEP && cpu->pc > RETURN_PAGE_AT) {
        cpu->pc -= WFI_BYTES;
        cpu->interrupt = INTERRUPT_RETURN;
    }
    if (cpu->interrupt == INTERRUPT_RETURN && cpu->depth != 0) {
        cortex_m_leave(e);
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
    cortex_m_t *cpu = cortex_m_of(e);
    const uint8_t *at = emulator_at(e, cpu->pc, CPSIE_BYTES);
    if (at == NULL || load16_le(at) != CPSIE) {
        return false;
    }
    cpu->pc += CPSIE_BYTES;
    cortex_m_set(e, UNICORN_REG_ARM_PRIMASK, 0);
    return true;
}

static void run(emulator_t *e, bool thread) {
    cortex_m_t *cpu = cortex_m_of(e);
    while (!emulator_failed(e)) {
        outcome_t outcome = cortex_m_take(e);
        if (cpu->asleep) {
            // An exception that PRIMASK holds back wakes the code, which then lets it in.
            if (outcome != TAKEN && outcome != HELD_BY_PRIMASK) {
                return;
            }
            cpu->asleep = false;
            if (cpu->parked != 0) {
                cortex_m_unpark(e);
            } else if (outcome == HELD_BY_PRIMASK && let_in(e)) {
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
    cortex_m_t *cpu = cortex_m_of(e);
    memset(cpu, 0, sizeof *cpu);
    cpu->nvic.enabled[0] = (1U << CORTEX_M_FIRST_IRQ) - 1;
    const uint8_t *table = emulator_at(e, CORTEX_M_FLASH, 2 * VECTOR_BYTES);
    cpu->pc = load32_le(table + VECTOR_BYTES) & ~1U;
    cortex_m_set(e, UNICORN_REG_ARM_SP, load32_le(table) & ~3U);
    cortex_m_set(e, UNICORN_REG_ARM_LR, UINT32_MAX);
}

// To know the PC, Unicorn 2.1.4 takes the state of the instruction at hand out of what it has noted of the
// block; so the rest of the block runs with that instruction's bits of an IT block, which nobody clears at
// its end.
static void looked_up(emulator_t *e) {
    cortex_m_set(e, UNICORN_REG_ARM_EPSR, XPSR_THUMB);
}

static void describe(emulator_t *e, char *out, size_t size) {
    const cortex_m_t *cpu = cortex_m_of(e);
    int used = snprintf(out, size, "; pc=0x%08x lr=0x%08x sp=0x%08x xpsr=0x%08x", cpu->pc,
                        cortex_m_get(e, UNICORN_REG_ARM_LR), cortex_m_get(e, UNICORN_REG_ARM_SP),
                        cortex_m_get(e, UNICORN_REG_ARM_XPSR));
    for (int i = 0; i <= 12 && used > 0 && (size_t)used < size; i++) {
        used += snprintf(out + used, size - (size_t)used, " r%d=0x%08x", i,
                         cortex_m_get(e, (unicorn_reg_t)((int)UNICORN_REG_ARM_R0 + i)));
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
