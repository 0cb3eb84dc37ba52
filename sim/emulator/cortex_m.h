/// The CPU of the STM32: a Cortex-M4F in Unicorn, and around it what Unicorn lacks: exceptions with their
/// frames, the NVIC, SysTick, and the system control block (ARMv7-M Architecture Reference Manual, B1.5, B3).
///
/// Exceptions are taken where a basic block ends. FPU state is stacked at once, never lazily. All code is
/// privileged. A fault ends the run instead of raising HardFault.
#ifndef SPINDECK_SIM_CORTEX_M_H
#define SPINDECK_SIM_CORTEX_M_H

#include "machine.h"
#include "ticks.h"

enum {
    CORTEX_M_IRQS = 82,
    CORTEX_M_FIRST_IRQ = 16, ///< exceptions have the numbers of their vectors
    CORTEX_M_EXCEPTIONS = CORTEX_M_FIRST_IRQ + CORTEX_M_IRQS,
    CORTEX_M_WORDS = 4,                                                     ///< of a bit for each
    CORTEX_M_PRIORITIES = CORTEX_M_FIRST_IRQ + (CORTEX_M_IRQS + 3) / 4 * 4, ///< in whole registers
    CORTEX_M_IDLE = 256, ///< priority of the main program: below all others
};

enum {
    EXCEPTION_NMI = 2,
    EXCEPTION_HARD_FAULT = 3,
    EXCEPTION_SVC = 11,
    EXCEPTION_PENDSV = 14,
    EXCEPTION_SYSTICK = 15
};

typedef struct {
    ticks_t ticks;
    uint32_t clock_khz;
    uint32_t control; ///< SYST_CSR, ENABLE, TICKINT and CLKSOURCE
    uint32_t reload;
    uint32_t count;
    bool counted; ///< COUNTFLAG
} systick_t;

/// What the NVIC and the system control block hold; arrays of bits by exception number.
typedef struct {
    uint32_t pending[CORTEX_M_WORDS];
    uint32_t enabled[CORTEX_M_WORDS];
    uint32_t active[CORTEX_M_WORDS];
    uint32_t lines[CORTEX_M_WORDS];
    uint8_t priority[CORTEX_M_PRIORITIES];
    uint32_t grouping; ///< PRIGROUP: the bits of a priority above this one decide who interrupts whom
    int next;          ///< pending exception that outranks all active ones, 0: none; masks not looked at
    uint32_t vectors;  ///< VTOR
    uint32_t fpu;      ///< CPACR
    bool sleep_on_exit;
    systick_t systick;
} nvic_t;

/// Group priority; lower is more urgent.
int nvic_priority(const nvic_t *self, int exception);
/// Of what runs, masks not looked at.
int nvic_active_priority(const nvic_t *self);
void nvic_pend(nvic_t *self, int exception);
void nvic_begin(nvic_t *self, int exception);
void nvic_end(nvic_t *self, int exception);

typedef enum { STOPPED_ASLEEP, STOPPED_TO_INTERRUPT, STOPPED_OTHER } cortex_m_stop_t;

typedef struct {
    nvic_t nvic;
    uint32_t pc; ///< of the next instruction
    bool asleep;
    int depth;       ///< of handlers
    uint32_t parked; ///< EXC_RETURN of a handler behind which the core sleeps, the frame still stacked; or 0
    uint8_t running[CORTEX_M_EXCEPTIONS];
    cortex_m_stop_t stop; ///< why the code has stopped
    int interrupt;        ///< Unicorn's number of what it could not do, STOPPED_OTHER
} cortex_m_t;

extern const cpu_t cortex_m;

/// The level of an interrupt line: a rising one makes it pending, and one that is still up at the end of its
/// handler makes it pending again.
void cortex_m_line(emulator_t *e, int irq, bool up);

/// The system control space, 4096 bytes from 0xE000E000.
uint32_t cortex_m_read(emulator_t *e, uint32_t address, unsigned size);
void cortex_m_write(emulator_t *e, uint32_t address, unsigned size, uint32_t value);

/// Of SysTick: as machine_t.alarm_ns and alarm.
int64_t cortex_m_alarm_ns(emulator_t *e);
void cortex_m_alarm(emulator_t *e);

/// The core's clock, from now on.
void cortex_m_set_clock(emulator_t *e, uint32_t khz);

#endif
