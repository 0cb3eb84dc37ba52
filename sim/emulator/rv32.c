#include "rv32.h"

#include <stdio.h>

enum {
    MSTATUS_MIE = 1 << 3,
    MSTATUS_MPIE = 1 << 7,
    MACHINE_MODE = 3,
    /// Handlers return to an ecall. That stops Unicorn at the least expense: after each start it looks for
    /// what it has translated at `until`, unless that is 0.
    RETURN = RV32_ROM,
    ECALL = 0x00000073,
    EBREAK = 0x00100073,
    C_EBREAK = 0x9002,
    HANDLERS_MAX = 1000, ///< in one go: one that does not clear its interrupt is called again at once
    AFTER = 4,           ///< Unicorn's pc after an exception is this far behind
    NONE = -1,
};

static const uint32_t MCAUSE_INTERRUPT = 0x80000000;

typedef struct {
    uint32_t lines;
    uint32_t vectors;
    uint32_t thread;  ///< pc of the main program, which sleeps
    uint32_t mstatus; ///< likewise
    bool woken;       ///< a handler has run since it slept
    int line;         ///< whose handler runs, or NONE
    uint32_t pc;      ///< where the code has stopped
    int exception;    ///< that has stopped it, or NONE
} rv32_t;

static rv32_t *cpu_of(const emulator_t *e) {
    return e->cpu_state;
}

void rv32_lines(emulator_t *e, uint32_t lines) {
    cpu_of(e)->lines = lines;
}

/// `after` counts on from a register that Unicorn numbers with those behind it.
static uint32_t get(const emulator_t *e, unicorn_reg_t which, int after) {
    uint32_t value = 0;
    e->api->read(e->engine, e->api->registers[which] + after, &value);
    return value;
}

static void set(const emulator_t *e, const unicorn_reg_t *which, uint32_t *values, int count) {
    int regs[3];
    void *places[3];
    for (int i = 0; i < count; i++) {
        regs[i] = e->api->registers[which[i]];
        places[i] = &values[i];
    }
    e->api->write_batch(e->engine, regs, places, count);
}

static void on_block(unicorn_t *engine, uint64_t address, uint32_t size, void *user) {
    emulator_t *e = user;
    (void)engine;
    (void)address;
    (void)size;
    emulator_may_go_on(e);
}

static void on_exception(unicorn_t *engine, uint32_t number, void *user) {
    emulator_t *e = user;
    cpu_of(e)->exception = (int)number;
    e->api->stop(engine);
}

static void fail_on(emulator_t *e, int error) {
    const rv32_t *cpu = cpu_of(e);
    const uint8_t *code = emulator_at(e, cpu->pc, 4);
    if (code != NULL && (load16_le(code) == C_EBREAK || load32_le(code) == EBREAK)) {
        emulator_fail(e, "breakpoint");
    } else if (code != NULL && load32_le(code) == ECALL) {
        emulator_fail(e, "environment call");
    } else if (cpu->exception != NONE || error == e->api->error_instruction) {
        emulator_fail(e, "illegal instruction");
    } else if (code == NULL) {
        emulator_fail(e, "jump to 0x%08x, where no code is", cpu->pc);
    } else {
        emulator_fail_on_access(e, cpu->pc, 0, error, "ROM");
    }
}

/// Until the CPU sleeps, or a handler has returned.
static void start(emulator_t *e, uint32_t pc) {
    rv32_t *cpu = cpu_of(e);
    cpu->exception = NONE;
    const int error = e->api->start(e->engine, pc, 0, 0, 0);
    cpu->pc = get(e, UNICORN_REG_RISCV_PC, 0);
    if (cpu->exception != NONE) {
        cpu->pc -= AFTER;
    }
    const bool returned = cpu->exception != NONE && cpu->pc == RETURN && cpu->line != NONE;
    if (!emulator_failed(e) && !returned && (error != 0 || cpu->exception != NONE || cpu->pc == 0)) {
        fail_on(e, error);
    }
}

// As RI5CY does it, but for what would make Unicorn forget its table of pages each time: MPIE and MPP stay as
// they are. So mret sets MIE and leads to user mode, and both are put right after it.
static void handle(emulator_t *e, int line) {
    static const unicorn_reg_t ENTRY[] = {UNICORN_REG_RISCV_MEPC, UNICORN_REG_RISCV_MCAUSE,
                                          UNICORN_REG_RISCV_MSTATUS};
    static const unicorn_reg_t EXIT[] = {UNICORN_REG_RISCV_PRIV, UNICORN_REG_RISCV_MSTATUS};
    rv32_t *cpu = cpu_of(e);
    const bool masked = (cpu->mstatus & MSTATUS_MIE) == 0;
    const uint32_t off = cpu->mstatus & ~(uint32_t)MSTATUS_MIE;
    set(e, ENTRY, (uint32_t[]){RETURN, MCAUSE_INTERRUPT | (uint32_t)line, off}, masked ? 2 : 3);
    cpu->line = line;
    start(e, cpu->vectors + 4 * (uint32_t)line);
    if (!emulator_failed(e) && cpu->exception == NONE) {
        emulator_fail(e, "wfi in an interrupt handler");
    }
    if (!emulator_failed(e)) {
        cpu->line = NONE;
        cpu->woken = true;
        set(e, EXIT, (uint32_t[]){MACHINE_MODE, cpu->mstatus | MSTATUS_MPIE}, 2);
    }
}

static void run_thread(emulator_t *e) {
    rv32_t *cpu = cpu_of(e);
    cpu->woken = false;
    start(e, cpu->thread);
    cpu->thread = cpu->pc;
    cpu->mstatus = get(e, UNICORN_REG_RISCV_MSTATUS, 0);
    cpu->vectors = get(e, UNICORN_REG_RISCV_MTVEC, 0) & ~(uint32_t)0xFF;
}

static void run(emulator_t *e, bool thread) {
    rv32_t *cpu = cpu_of(e);
    int handled = 0;
    while (!emulator_failed(e)) {
        const int line = cpu->lines == 0 ? NONE : __builtin_ctz(cpu->lines);
        if (handled == HANDLERS_MAX) {
            emulator_fail(e, "interrupt %d comes again and again: its handler does not clear it", line);
        } else if (line != NONE) {
            handled++;
            handle(e, line);
        } else if (thread && cpu->woken) {
            run_thread(e);
        } else {
            return;
        }
    }
}

static bool open(emulator_t *e) {
    const unicorn_api_t *api = e->api;
    const struct {
        int type;
        void *callback;
    } hooks[] = {{api->hook_interrupt, (void *)on_exception}, {api->hook_block, (void *)on_block}};
    size_t hook;
    int error = api->open(api->arch_riscv, api->mode_riscv, &e->engine);
    for (size_t i = 0; i < sizeof hooks / sizeof hooks[0] && error == 0; i++) {
        error = api->add_hook(e->engine, &hook, hooks[i].type, hooks[i].callback, e, 1, 0);
    }
    if (error != 0) {
        emulator_fail(e, "Unicorn cannot make an RV32: %s", api->describe(error));
    }
    return error == 0;
}

static void reset(emulator_t *e) {
    *cpu_of(e) = (rv32_t){.thread = e->image->entry, .woken = true, .line = NONE, .exception = NONE};
    store32_le(emulator_at(e, RETURN, 4), ECALL);
}

static void describe(emulator_t *e, char *out, size_t size) {
    static const char *const NAMES[] = {"ra", "sp", "gp", "tp",  "t0",  "t1", "t2", "s0", "s1", "a0", "a1",
                                        "a2", "a3", "a4", "a5",  "a6",  "a7", "s2", "s3", "s4", "s5", "s6",
                                        "s7", "s8", "s9", "s10", "s11", "t3", "t4", "t5", "t6"};
    const rv32_t *cpu = cpu_of(e);
    size_t used = (size_t)snprintf(out, size, "; pc=0x%08x", cpu->pc);
    if (cpu->line != NONE && used < size) {
        used +=
            (size_t)snprintf(out + used, size - used, " interrupt=%d thread=0x%08x", cpu->line, cpu->thread);
    }
    for (int i = 0; i < 31 && used < size; i++) {
        used += (size_t)snprintf(out + used, size - used, " %s=0x%08x", NAMES[i],
                                 get(e, UNICORN_REG_RISCV_X0, 1 + i));
    }
}

const cpu_t rv32_cpu = {
    .state_bytes = sizeof(rv32_t),
    .open = open,
    .reset = reset,
    .run = run,
    .describe = describe,
};
