/// What the logger's parts share, private to them: log.c has the rows and the times, log_request.c what is
/// asked of the card next, log_answer.c what its answers mean.
#ifndef SPINDECK_STM32_LOG_PARTS_H
#define SPINDECK_STM32_LOG_PARTS_H

#include "grid.h"
#include "log.h"

/// The request that comes next.
enum {
    STEP_NONE = 0,
    STEP_OPEN = 1, ///< config.txt
    STEP_READ = 2,
    STEP_READ_END = 3,
    STEP_CREATE = 4,
    STEP_EXTEND = 5,
    STEP_RETURN = 6, ///< to where the next write goes
    STEP_WRITE = 7,  ///< when there is something
    STEP_SYNC = 8,
    STEP_REWIND = 9,
    STEP_TRUNCATE = 10,
    STEP_CLOSE = 11,
};

/// A file is being written.
static inline bool log_has_file(const stm32_log_t *self) {
    return self->step >= STEP_EXTEND;
}

static inline uint32_t log_sync_us(const stm32_log_t *self) {
    return self->settings.sync_us == 0 ? STM32_LOG_SYNC_US : self->settings.sync_us;
}

// log.c
/// Nothing more until it is told to begin anew.
void log_over(stm32_log_t *self, log_state_t why);
/// All that has been made goes to the card.
void log_drain(stm32_log_t *self);
void log_begin_file(stm32_log_t *self, instant_t now);

#endif
