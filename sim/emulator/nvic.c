#include "cortex_m.h"

/// Addresses (B3.2 to B3.4), their fields, and what the STM32F405 implements.
enum {
    SYSTICK_CSR = 0xE000E010U,
    SYSTICK_RVR = 0xE000E014U,
    SYSTICK_CVR = 0xE000E018U,
    SYSTICK_ENABLE = 1,
    SYSTICK_INTERRUPT = 2,
    SYSTICK_CORE_CLOCK = 4, ///< else an eighth of it
    SYSTICK_COUNTED = 1 << 16,
    SYSTICK_MAX = 0xFFFFFF,
    NVIC_SET_ENABLED = 0xE000E100U,
    NVIC_CLEAR_ENABLED = 0xE000E180U,
    NVIC_SET_PENDING = 0xE000E200U,
    NVIC_CLEAR_PENDING = 0xE000E280U,
    NVIC_ACTIVE = 0xE000E300U,
    NVIC_PRIORITIES = 0xE000E400U,
    NVIC_TRIGGER = 0xE000EF00U,
    BIT_REGISTERS = 3, ///< of 32 interrupts each
    CPUID = 0xE000ED00U,
    CPUID_VALUE = 0x410FC241, ///< r0p1, as in RM0090
    ICSR = 0xE000ED04U,
    ICSR_CLEAR_SYSTICK = 1 << 25,
    ICSR_SET_SYSTICK = 1 << 26,
    ICSR_CLEAR_PENDSV = 1 << 27,
    ICSR_SET_PENDSV = 1 << 28,
    VTOR = 0xE000ED08U,
    AIRCR = 0xE000ED0CU,
    AIRCR_KEY = 0x05FA,
    AIRCR_KEY_READ = 0xFA05,
    AIRCR_RESET = 4,
    SCR = 0xE000ED10U,
    SCR_SLEEPONEXIT = 2,
    CCR = 0xE000ED14U,
    CCR_ALIGNED_STACK = 0x200,
    SYSTEM_PRIORITIES = 0xE000ED18U, ///< of exceptions 4 to 15
    SYSTEM_PRIORITY_FIRST = 4,
    CPACR = 0xE000ED88U,
    FPCCR = 0xE000EF34U,
    PRIORITY_BITS = 0xF0,
};
static const uint32_t ICSR_SET_NMI = 1U << 31;
static const uint32_t FPCCR_AUTOMATIC = 0xC0000000U;

static nvic_t *nvic_of(emulator_t *e) {
    return &((cortex_m_t *)e->cpu_state)->nvic;
}

static bool get(const uint32_t *bits, int at) {
    return (bits[at / 32] >> (at % 32) & 1) != 0;
}

static void put(uint32_t *bits, int at, bool on) {
    uint32_t bit = 1U << (at % 32);
    bits[at / 32] = on ? bits[at / 32] | bit : bits[at / 32] & ~bit;
}

static int full_priority(const nvic_t *self, int exception) {
    return exception == EXCEPTION_NMI          ? -2
           : exception == EXCEPTION_HARD_FAULT ? -1
                                               : self->priority[exception];
}

int nvic_priority(const nvic_t *self, int exception) {
    int full = full_priority(self, exception);
    return full < 0 ? full : full & (int)(0xFFFFFFFEU << self->grouping);
}

int nvic_active_priority(const nvic_t *self) {
    int lowest = CORTEX_M_IDLE;
    for (int word = 0; word < CORTEX_M_WORDS; word++) {
        for (uint32_t bits = self->active[word]; bits != 0; bits &= bits - 1) {
            int priority = nvic_priority(self, word * 32 + __builtin_ctz(bits));
            lowest = priority < lowest ? priority : lowest;
        }
    }
    return lowest;
}

// Of equal priorities the lowest number goes first.
static void update(nvic_t *self) {
    int next = 0;
    for (int word = 0; word < CORTEX_M_WORDS; word++) {
        for (uint32_t bits = self->pending[word] & self->enabled[word]; bits != 0; bits &= bits - 1) {
            int exception = word * 32 + __builtin_ctz(bits);
            if (next == 0 || full_priority(self, exception) < full_priority(self, next)) {
                next = exception;
            }
        }
    }
    self->next = next != 0 && nvic_priority(self, next) < nvic_active_priority(self) ? next : 0;
}

void nvic_pend(nvic_t *self, int exception) {
    put(self->pending, exception, true);
    update(self);
}

void nvic_begin(nvic_t *self, int exception) {
    put(self->pending, exception, false);
    put(self->active, exception, true);
    update(self);
}

void nvic_end(nvic_t *self, int exception) {
    put(self->active, exception, false);
    if (get(self->lines, exception)) {
        put(self->pending, exception, true);
    }
    update(self);
}

void cortex_m_line(emulator_t *e, int irq, bool up) {
    nvic_t *nvic = nvic_of(e);
    int exception = CORTEX_M_FIRST_IRQ + irq;
    bool was_up = get(nvic->lines, exception);
    put(nvic->lines, exception, up);
    if (up && !was_up) {
        nvic_pend(nvic, exception);
    }
}

// SysTick counts down to 0 and is reloaded by the tick after.
static uint32_t systick_divider(const systick_t *self) {
    return (self->control & SYSTICK_CORE_CLOCK) != 0 ? 1 : 8;
}

static uint64_t systick_ticks_to_zero(const systick_t *self) {
    return self->count != 0 ? self->count : (uint64_t)self->reload + 1;
}

static void systick_settle(emulator_t *e) {
    systick_t *self = &nvic_of(e)->systick;
    if ((self->control & SYSTICK_ENABLE) == 0) {
        ticks_start(&self->ticks, e->now_ns);
        return;
    }
    uint64_t ticks = ticks_take(&self->ticks, e->now_ns, self->clock_khz, systick_divider(self));
    uint64_t to_zero = systick_ticks_to_zero(self);
    if (ticks == 0 || (self->reload == 0 && self->count == 0)) { // without a reload value it stands still
        return;
    }
    if (ticks < to_zero) {
        self->count = (uint32_t)(to_zero - ticks);
        return;
    }
    uint64_t period = (uint64_t)self->reload + 1;
    uint64_t after = (ticks - to_zero) % period;
    self->count = after == 0 ? 0 : (uint32_t)(period - after);
    self->counted = true;
    if ((self->control & SYSTICK_INTERRUPT) != 0) {
        nvic_pend(nvic_of(e), EXCEPTION_SYSTICK);
    }
}

int64_t cortex_m_alarm_ns(emulator_t *e) {
    const systick_t *self = &nvic_of(e)->systick;
    const uint32_t needed = SYSTICK_ENABLE | SYSTICK_INTERRUPT;
    if ((self->control & needed) != needed || (self->reload == 0 && self->count == 0)) {
        return INT64_MAX;
    }
    return ticks_when_ns(&self->ticks, systick_ticks_to_zero(self), self->clock_khz, systick_divider(self));
}

void cortex_m_alarm(emulator_t *e) {
    systick_settle(e);
}

void cortex_m_set_clock(emulator_t *e, uint32_t khz) {
    systick_settle(e);
    nvic_of(e)->systick.clock_khz = khz;
}

static uint32_t systick_control(emulator_t *e) {
    systick_t *self = &nvic_of(e)->systick;
    uint32_t value = self->control | (self->counted ? SYSTICK_COUNTED : 0U);
    self->counted = false;
    return value;
}

/// Interrupts 32 * index and on, as bits of a register.
static uint32_t irq_bits(const uint32_t *bits, uint32_t index) {
    uint64_t both = bits[index] | (uint64_t)(index + 1 < CORTEX_M_WORDS ? bits[index + 1] : 0) << 32;
    return (uint32_t)(both >> CORTEX_M_FIRST_IRQ);
}

static void set_irq_bits(nvic_t *self, uint32_t *bits, uint32_t index, uint32_t value, bool on) {
    for (; value != 0; value &= value - 1) {
        int irq = (int)index * 32 + __builtin_ctz(value);
        if (irq < CORTEX_M_IRQS) {
            put(bits, CORTEX_M_FIRST_IRQ + irq, on);
        }
    }
    update(self);
}

static bool in(uint32_t address, uint32_t first, uint32_t bytes) {
    return address - first < bytes;
}

static uint8_t *priorities(nvic_t *self, uint32_t address, unsigned size) {
    uint32_t last = address + size - 1;
    if (in(last, NVIC_PRIORITIES, CORTEX_M_PRIORITIES - CORTEX_M_FIRST_IRQ) && address >= NVIC_PRIORITIES) {
        return &self->priority[CORTEX_M_FIRST_IRQ + address - NVIC_PRIORITIES];
    }
    return in(last, SYSTEM_PRIORITIES, CORTEX_M_FIRST_IRQ - SYSTEM_PRIORITY_FIRST) &&
                   address >= SYSTEM_PRIORITIES
               ? &self->priority[SYSTEM_PRIORITY_FIRST + address - SYSTEM_PRIORITIES]
               : NULL;
}

static uint32_t control_state(const nvic_t *self) {
    uint32_t active = 0;
    for (int word = CORTEX_M_WORDS - 1; word >= 0; word--) {
        active = self->active[word] != 0 ? (uint32_t)(word * 32 + __builtin_ctz(self->active[word])) : active;
    }
    return active | (uint32_t)self->next << 12 |
           (get(self->pending, EXCEPTION_SYSTICK) ? ICSR_SET_SYSTICK : 0U) |
           (get(self->pending, EXCEPTION_PENDSV) ? ICSR_SET_PENDSV : 0U);
}

uint32_t cortex_m_read(emulator_t *e, uint32_t address, unsigned size) {
    nvic_t *self = nvic_of(e);
    const uint8_t *priority = priorities(self, address, size);
    if (priority != NULL) {
        uint32_t value = 0;
        for (unsigned i = 0; i < size; i++) {
            value |= (uint32_t)priority[i] << (8 * i);
        }
        return value;
    }
    const struct {
        uint32_t address;
        const uint32_t *bits;
    } groups[] = {{NVIC_SET_ENABLED, self->enabled},
                  {NVIC_CLEAR_ENABLED, self->enabled},
                  {NVIC_SET_PENDING, self->pending},
                  {NVIC_CLEAR_PENDING, self->pending},
                  {NVIC_ACTIVE, self->active}};
    for (size_t i = 0; i < sizeof groups / sizeof groups[0]; i++) {
        if (in(address, groups[i].address, BIT_REGISTERS * 4)) {
            return irq_bits(groups[i].bits, (address - groups[i].address) / 4);
        }
    }
    systick_settle(e);
    switch (address) {
    case SYSTICK_CSR:
        return systick_control(e);
    case SYSTICK_RVR:
        return self->systick.reload;
    case SYSTICK_CVR:
        return self->systick.count;
    case CPUID:
        return CPUID_VALUE;
    case ICSR:
        return control_state(self);
    case VTOR:
        return self->vectors;
    case AIRCR:
        return (uint32_t)AIRCR_KEY_READ << 16 | self->grouping << 8;
    case SCR:
        return self->sleep_on_exit ? SCR_SLEEPONEXIT : 0;
    case CCR:
        return CCR_ALIGNED_STACK;
    case CPACR:
        return self->fpu;
    case FPCCR:
        return FPCCR_AUTOMATIC;
    default:
        emulator_fail(e, "read of 0x%08x, a system control register that is not modelled", address);
        return 0;
    }
}

static void write_control_state(nvic_t *self, uint32_t value) {
    const struct {
        uint32_t bit;
        int exception;
        bool on;
    } actions[] = {{ICSR_SET_NMI, EXCEPTION_NMI, true},
                   {ICSR_SET_PENDSV, EXCEPTION_PENDSV, true},
                   {ICSR_CLEAR_PENDSV, EXCEPTION_PENDSV, false},
                   {ICSR_SET_SYSTICK, EXCEPTION_SYSTICK, true},
                   {ICSR_CLEAR_SYSTICK, EXCEPTION_SYSTICK, false}};
    for (size_t i = 0; i < sizeof actions / sizeof actions[0]; i++) {
        if ((value & actions[i].bit) != 0) {
            put(self->pending, actions[i].exception, actions[i].on);
        }
    }
    update(self);
}

static void write_reset(emulator_t *e, uint32_t value) {
    nvic_t *self = nvic_of(e);
    if (value >> 16 != AIRCR_KEY) {
        return; // as the hardware does
    }
    if ((value & AIRCR_RESET) != 0) {
        emulator_fail(e, "the code has asked for a reset");
    }
    self->grouping = value >> 8 & 7;
    update(self);
}

static void write_systick(emulator_t *e, uint32_t address, uint32_t value) {
    systick_t *self = &nvic_of(e)->systick;
    systick_settle(e);
    if (address == SYSTICK_CSR) {
        self->control = value & (SYSTICK_ENABLE | SYSTICK_INTERRUPT | SYSTICK_CORE_CLOCK);
    } else if (address == SYSTICK_RVR) {
        self->reload = value & SYSTICK_MAX;
    } else {
        self->count = 0;
        self->counted = false;
    }
}

static bool write_bits(nvic_t *self, uint32_t address, uint32_t value) {
    const struct {
        uint32_t address;
        uint32_t *bits;
        bool on;
    } groups[] = {{NVIC_SET_ENABLED, self->enabled, true},
                  {NVIC_CLEAR_ENABLED, self->enabled, false},
                  {NVIC_SET_PENDING, self->pending, true},
                  {NVIC_CLEAR_PENDING, self->pending, false}};
    for (size_t i = 0; i < sizeof groups / sizeof groups[0]; i++) {
        if (in(address, groups[i].address, BIT_REGISTERS * 4)) {
            set_irq_bits(self, groups[i].bits, (address - groups[i].address) / 4, value, groups[i].on);
            return true;
        }
    }
    return false;
}

void cortex_m_write(emulator_t *e, uint32_t address, unsigned size, uint32_t value) {
    nvic_t *self = nvic_of(e);
    uint8_t *priority = priorities(self, address, size);
    if (priority != NULL) {
        for (unsigned i = 0; i < size; i++) {
            priority[i] = (uint8_t)(value >> (8 * i) & PRIORITY_BITS);
        }
        update(self);
        return;
    }
    if (write_bits(self, address, value)) {
        return;
    }
    // Bits that would change how the core behaves are not modelled, and may only be left as they are.
    bool modelled = true;
    switch (address) {
    case SYSTICK_CSR:
    case SYSTICK_RVR:
    case SYSTICK_CVR:
        write_systick(e, address, value);
        break;
    case ICSR:
        write_control_state(self, value);
        break;
    case VTOR:
        self->vectors = value;
        break;
    case AIRCR:
        write_reset(e, value);
        break;
    case SCR:
        self->sleep_on_exit = (value & SCR_SLEEPONEXIT) != 0;
        modelled = (value & ~(uint32_t)SCR_SLEEPONEXIT) == 0;
        break;
    case CCR:
        modelled = value == CCR_ALIGNED_STACK;
        break;
    case CPACR:
        self->fpu = value;
        break;
    case FPCCR:
        modelled = (value & FPCCR_AUTOMATIC) == FPCCR_AUTOMATIC;
        break;
    case NVIC_TRIGGER:
        set_irq_bits(self, self->pending, value / 32, 1U << (value % 32), true);
        break;
    default:
        modelled = false;
        break;
    }
    if (!modelled) {
        emulator_fail(e, "write of 0x%08x to 0x%08x, which is not modelled", value, address);
    }
}
