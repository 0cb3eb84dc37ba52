#include "gap8.h"

enum {
    CFG = 0x00, ///< of the low counter; four bytes on, as with all below, of the high one
    VALUE = 0x08,
    COMPARE = 0x10,
    START = 0x18,
    RESET = 0x20,
};

enum {
    ENABLE = 1 << 0,
    CLEAR = 1 << 1,
    EVENT = 1 << 2,
    INPUT_EVENT = 1 << 3,
    COMPARE_CLEARS = 1 << 4,
    ONE_SHOT = 1 << 5,
    PRESCALER = 1 << 6,
    REF_CLOCK = 1 << 7,
};

static const uint32_t MODE_64_BIT = 0x80000000;
static const uint64_t ROUND = 0x100000000;

enum {
    REF_HZ = 32768,
    SECOND_NS = 1000000000,
};

static uint64_t divider(const gap8_timer_t *timer) {
    return (timer->cfg & PRESCALER) != 0 ? (timer->cfg >> 8 & 0xFF) + 1 : 1;
}

/// Counts in `ns`, rounded down; and the first nanosecond at which there are that many.
static uint64_t counts(const gap8_timer_t *timer, uint64_t ns) {
    if ((timer->cfg & REF_CLOCK) != 0) {
        return (ns / SECOND_NS * REF_HZ + ns % SECOND_NS * REF_HZ / SECOND_NS) / divider(timer);
    }
    return ns * GAP8_FC_MHZ / (1000 * divider(timer));
}

static uint64_t counts_ns(const gap8_timer_t *timer, uint64_t count) {
    const uint64_t edges = count * divider(timer);
    if ((timer->cfg & REF_CLOCK) != 0) {
        return edges / REF_HZ * SECOND_NS + (edges % REF_HZ * SECOND_NS + REF_HZ - 1) / REF_HZ;
    }
    return (edges * 1000 + GAP8_FC_MHZ - 1) / GAP8_FC_MHZ;
}

static uint64_t elapsed(const emulator_t *e, const gap8_timer_t *timer) {
    return (timer->cfg & ENABLE) != 0 ? counts(timer, (uint64_t)(e->now_ns - timer->start_ns)) : 0;
}

/// A counter that is already equal comes round first.
static void plan(const emulator_t *e, gap8_timer_t *timer) {
    timer->match_ns = INT64_MAX;
    if ((timer->cfg & (ENABLE | EVENT)) == (ENABLE | EVENT)) {
        const uint64_t passed = elapsed(e, timer);
        const uint32_t to_go = timer->compare - (timer->value + (uint32_t)passed);
        timer->match_ns = timer->start_ns + (int64_t)counts_ns(timer, passed + (to_go != 0 ? to_go : ROUND));
    }
}

static void set(const emulator_t *e, gap8_timer_t *timer, uint32_t value) {
    timer->value = value;
    timer->start_ns = e->now_ns;
}

int64_t gap8_timer_ns(const gap8_machine_t *m) {
    const int64_t low_ns = m->timers[0].match_ns;
    const int64_t high_ns = m->timers[1].match_ns;
    return low_ns < high_ns ? low_ns : high_ns;
}

void gap8_timer_due(emulator_t *e) {
    for (int i = 0; i < 2; i++) {
        gap8_timer_t *timer = &gap8_of(e)->timers[i];
        if (timer->match_ns <= e->now_ns) {
            plan(e, timer);
            gap8_raise(e, GAP8_LINE_TIMER + i);
        }
    }
}

bool gap8_timer_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    const gap8_timer_t *timer = &gap8_of(e)->timers[offset / 4 % 2];
    switch (offset & ~7U) {
    case CFG:
        *value = timer->cfg;
        return true;
    case VALUE:
        *value = timer->value + (uint32_t)elapsed(e, timer);
        return true;
    case COMPARE:
        *value = timer->compare;
        return true;
    default:
        return false;
    }
}

bool gap8_timer_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_timer_t *timer = &gap8_of(e)->timers[offset / 4 % 2];
    const uint32_t now = timer->value + (uint32_t)elapsed(e, timer);
    switch (offset & ~7U) {
    case CFG:
        if ((value & (INPUT_EVENT | COMPARE_CLEARS | ONE_SHOT | MODE_64_BIT)) != 0) {
            emulator_fail(e, "its code sets up a timer with 0x%x, which is not modelled", value);
            return true;
        }
        set(e, timer, (value & CLEAR) != 0 ? 0 : now);
        timer->cfg = value & ~(uint32_t)CLEAR;
        break;
    case VALUE:
        set(e, timer, value);
        break;
    case COMPARE:
        timer->compare = value;
        break;
    case START:
        set(e, timer, now);
        timer->cfg |= ENABLE;
        break;
    case RESET:
        set(e, timer, 0);
        break;
    default:
        return false;
    }
    plan(e, timer);
    return true;
}
