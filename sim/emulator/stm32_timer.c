#include "stm32.h"

/// RM0090, 18.4.
enum {
    CR1 = 0x00,
    DIER = 0x0C,
    SR = 0x10,
    EGR = 0x14,
    CNT = 0x24,
    PSC = 0x28,
    ARR = 0x2C,
    CR1_CEN = 1 << 0,
    CR1_URS = 1 << 2,
    CR1_OPM = 1 << 3,
    UPDATE = 1 << 0, ///< of DIER, SR and EGR
    PSC_MAX = 0xFFFF,
};

static const struct {
    const char *name;
    int irq;
    int clock; ///< bit of RCC_APB1ENR
    uint32_t count_max;
} TIMERS[STM32_TIMERS] = {[STM32_TIM2] = {"TIM2", 28, 0, UINT32_MAX},
                          [STM32_TIM3] = {"TIM3", 29, 1, 0xFFFF},
                          [STM32_TIM5] = {"TIM5", 50, 3, UINT32_MAX}};

static stm32_timer_t *timer_of(emulator_t *e, int index) {
    return &stm32_chip(e)->timers[index];
}

void stm32_timer_reset(emulator_t *e, int index) {
    stm32_timer_t *timer = timer_of(e, index);
    *timer = (stm32_timer_t){.reload = TIMERS[index].count_max, .count_max = TIMERS[index].count_max};
    ticks_start(&timer->ticks, e->now_ns);
}

static void set_line(emulator_t *e, int index) {
    const stm32_timer_t *timer = timer_of(e, index);
    cortex_m_line(e, TIMERS[index].irq, (timer->status & timer->interrupts & UPDATE) != 0);
}

/// Beyond its reload value it counts on to its end.
static uint64_t ticks_to_update(const stm32_timer_t *timer) {
    uint32_t last = timer->count <= timer->reload ? timer->reload : timer->count_max;
    return (uint64_t)(last - timer->count) + 1;
}

static void update(stm32_timer_t *timer) {
    timer->count = 0;
    timer->status |= UPDATE;
    timer->prescaler = timer->prescaler_next;
    if ((timer->control & CR1_OPM) != 0) {
        timer->control &= ~(uint32_t)CR1_CEN;
    }
}

/// All updates until now. With a prescaler that stays only the last is looked at.
static void settle(emulator_t *e, int index) {
    stm32_timer_t *timer = timer_of(e, index);
    uint32_t khz = stm32_chip(e)->clocks.apb1_timers_khz;
    while ((timer->control & CR1_CEN) != 0) {
        uint64_t to_update = ticks_to_update(timer);
        int64_t update_ns = ticks_when_ns(&timer->ticks, to_update, khz, timer->prescaler + 1);
        if (update_ns > e->now_ns) {
            timer->count += (uint32_t)ticks_take(&timer->ticks, e->now_ns, khz, timer->prescaler + 1);
            return;
        }
        bool steady = timer->prescaler == timer->prescaler_next && (timer->control & CR1_OPM) == 0;
        uint64_t ticks = ticks_take(&timer->ticks, steady ? e->now_ns : update_ns, khz, timer->prescaler + 1);
        update(timer);
        timer->count = (uint32_t)((ticks - to_update) % ((uint64_t)timer->reload + 1));
        set_line(e, index);
    }
    timer->ticks.since_ns = e->now_ns; // stopped, its prescaler holds where it is
}

void stm32_timers_settle(emulator_t *e) {
    for (int index = 0; index < STM32_TIMERS; index++) {
        settle(e, index);
    }
}

int64_t stm32_timers_alarm_ns(emulator_t *e) {
    uint32_t khz = stm32_chip(e)->clocks.apb1_timers_khz;
    int64_t first_ns = INT64_MAX;
    for (int index = 0; index < STM32_TIMERS; index++) {
        const stm32_timer_t *timer = timer_of(e, index);
        if ((timer->control & CR1_CEN) != 0 && (timer->interrupts & UPDATE) != 0 &&
            (timer->status & UPDATE) == 0) {
            int64_t ns = ticks_when_ns(&timer->ticks, ticks_to_update(timer), khz, timer->prescaler + 1);
            first_ns = ns < first_ns ? ns : first_ns;
        }
    }
    return first_ns;
}

uint32_t stm32_timer_read(emulator_t *e, int index, uint32_t offset) {
    if (!stm32_has_clock(e, TIMERS[index].name, TIMERS[index].clock)) {
        return 0;
    }
    settle(e, index);
    const stm32_timer_t *timer = timer_of(e, index);
    switch (offset) {
    case CR1:
        return timer->control;
    case DIER:
        return timer->interrupts;
    case SR:
        return timer->status;
    case CNT:
        return timer->count;
    case PSC:
        return timer->prescaler_next;
    case ARR:
        return timer->reload;
    default:
        return 0;
    }
}

static void generate_update(emulator_t *e, stm32_timer_t *timer) {
    bool flag = (timer->control & CR1_URS) == 0 || (timer->status & UPDATE) != 0;
    timer->count = 0;
    timer->prescaler = timer->prescaler_next;
    timer->status = (timer->status & ~(uint32_t)UPDATE) | (flag ? UPDATE : 0U);
    ticks_start(&timer->ticks, e->now_ns);
}

static bool write_register(emulator_t *e, stm32_timer_t *timer, uint32_t offset, uint32_t value) {
    switch (offset) {
    case CR1:
        timer->control = value;
        return (value & ~(uint32_t)(CR1_CEN | CR1_URS | CR1_OPM)) == 0;
    case DIER:
        timer->interrupts = value;
        return (value & ~(uint32_t)UPDATE) == 0;
    case SR:
        timer->status &= value;
        return true;
    case EGR:
        if ((value & UPDATE) != 0) {
            generate_update(e, timer);
        }
        return (value & ~(uint32_t)UPDATE) == 0;
    case CNT:
        timer->count = value & timer->count_max;
        return true;
    case PSC:
        timer->prescaler_next = value & PSC_MAX;
        return true;
    case ARR:
        timer->reload = value & timer->count_max;
        return timer->reload != 0;
    default:
        return value == 0;
    }
}

void stm32_timer_write(emulator_t *e, int index, uint32_t offset, uint32_t value) {
    if (!stm32_has_clock(e, TIMERS[index].name, TIMERS[index].clock)) {
        return;
    }
    settle(e, index);
    if (!write_register(e, timer_of(e, index), offset, value)) {
        emulator_fail(
            e, "%s: 0x%x was written to its register 0x%02x, which asks for something that is not modelled",
            TIMERS[index].name, value, offset);
    }
    stm32_chip(e)->alarm_ns = INT64_MIN;
    set_line(e, index);
}
