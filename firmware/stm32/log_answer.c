#include "log_parts.h"

static void failed(stm32_log_t *self) {
    self->errors++;
    if (log_has_file(self)) {
        self->log.counters.errors++;
    }
}

static log_state_t reason(int32_t result) {
    return result == STORAGE_NO_CARD ? LOG_NO_CARD : result == STORAGE_FULL ? LOG_FULL : LOG_FAILED;
}

/// The file cannot go on: an end behind the last status row that is on the card, and then the next file.
static void rescue(stm32_log_t *self, bool next) {
    self->next = next && self->wanted && self->failures < STM32_LOG_TRIES;
    self->failures++;
    self->tries = 0;
    self->open = false;
    const bool empty = usd_log_safe(&self->log) == 0;
    if (self->rescuing || empty) {
        self->lost += empty ? self->log.counters.requested : self->cut_rows;
        self->carried_errors = self->log.counters.errors;
        self->step = STEP_CLOSE;
    } else {
        self->step = STEP_REWIND;
    }
    self->rescuing = true;
}

static void opened(stm32_log_t *self, int32_t result) {
    if (result >= 0) {
        usd_config_init(&self->config, self->config.table);
        self->step = STEP_READ;
        return;
    }
    self->errors += result == STORAGE_DISK;
    log_over(self, result == STORAGE_NO_FILE ? LOG_NO_CONFIG : reason(result));
}

static void read_some(stm32_log_t *self, int32_t result, bytes_t data) {
    if (result > 0 && (uint32_t)result == data.size) {
        usd_config_put(&self->config, data);
        return;
    }
    self->usable = result == 0 && usd_config_end(&self->config) == 0;
    self->wanted = self->wanted || (self->usable && self->config.on_startup);
    self->status = result == 0 ? LOG_BAD_CONFIG : LOG_FAILED;
    self->errors += result != 0;
    self->step = STEP_READ_END;
}

static void read_ended(stm32_log_t *self) {
    if (!self->usable) {
        log_over(self, self->status);
    } else if (!self->wanted) {
        log_over(self, LOG_OFF);
    } else {
        self->status = LOG_STARTS;
        self->step = STEP_CREATE;
    }
}

static void created(stm32_log_t *self, int32_t result, instant_t now) {
    if (result >= 0) {
        log_begin_file(self, now);
    } else if (result != STORAGE_EXISTS) {
        self->errors++;
        log_over(self, reason(result));
    } else if (++self->number == STM32_LOG_NAMES) {
        log_over(self, LOG_NO_NAME);
    }
}

/// There is no more than what is allocated.
static void limit(stm32_log_t *self) {
    self->chunk = 0;
    self->log.limit = self->extent;
}

/// A whole chunk at a time; when that fails, halves, quarters and so on of what is left of the card.
static void extended(stm32_log_t *self, int32_t result) {
    const bool whole = self->chunk == STM32_LOG_CHUNK_BYTES;
    self->step = STEP_RETURN;
    if (result < 0 && result != STORAGE_FULL) {
        failed(self);
        self->chunk = 0; // without, then
        return;
    }
    if (result >= 0) {
        self->extent += self->chunk;
        if (whole && self->extent <= UINT32_MAX - self->chunk) {
            return;
        }
    } else if (whole) {
        failed(self);
    }
    self->chunk /= 2;
    if (self->chunk < STM32_LOG_CHUNK_MIN || self->extent > UINT32_MAX - self->chunk) {
        limit(self);
    } else {
        self->step = STEP_EXTEND;
    }
}

/// Has it failed for the last time? Else it is tried again.
static bool gives_up(stm32_log_t *self) {
    failed(self);
    self->tries++;
    return self->tries == STM32_LOG_TRIES;
}

static void returned(stm32_log_t *self, int32_t result) {
    if (result >= 0) {
        self->step = STEP_WRITE;
    } else if (gives_up(self)) {
        rescue(self, true);
    }
}

static void wrote(stm32_log_t *self, int32_t result) {
    if (result == self->size) {
        usd_log_taken(&self->log, self->size);
        self->tries = 0;
        return;
    }
    if (result >= 0 || result == STORAGE_FULL) {
        failed(self);
        rescue(self, false);
        self->status = LOG_FULL;
        return;
    }
    self->step = STEP_RETURN;
    if (gives_up(self)) {
        rescue(self, true);
    }
}

static void synced(stm32_log_t *self, int32_t result) {
    self->draining = false;
    self->step = STEP_WRITE;
    if (result < 0) {
        failed(self);
        return;
    }
    self->log.counters.syncs++;
    self->failures = 0;
}

static void rewound(stm32_log_t *self, int32_t result, instant_t now) {
    if (result < 0 && !gives_up(self)) {
        return;
    }
    const uint32_t dropped = self->log.counters.dropped;
    usd_log_cut(&self->log);
    self->cut_rows = self->log.counters.dropped - dropped;
    if (result < 0) {
        rescue(self, self->next);
        return;
    }
    usd_log_end(&self->log, now.stamp_us);
    self->ended = true;
    log_drain(self);
    self->step = STEP_WRITE;
}

static void closed(stm32_log_t *self, int32_t result) {
    if (result < 0) {
        failed(self);
    }
    const bool full = self->log.full || self->status == LOG_FULL;
    if (full || !self->wanted || (self->rescuing && !self->next)) {
        log_over(self, full ? LOG_FULL : self->rescuing ? LOG_FAILED : LOG_OFF);
        return;
    }
    self->number++;
    self->status = LOG_STARTS;
    self->step = STEP_CREATE;
    if (self->number == STM32_LOG_NAMES) {
        log_over(self, LOG_NO_NAME);
    }
}

static void go_on(stm32_log_t *self, int32_t result, bytes_t data, instant_t now) {
    switch (self->step) {
    case STEP_OPEN:
        opened(self, result);
        break;
    case STEP_READ:
        read_some(self, result, data);
        break;
    case STEP_READ_END:
        read_ended(self);
        break;
    case STEP_CREATE:
        created(self, result, now);
        break;
    case STEP_EXTEND:
        extended(self, result);
        break;
    case STEP_RETURN:
        returned(self, result);
        break;
    case STEP_WRITE:
        wrote(self, result);
        break;
    case STEP_SYNC:
        synced(self, result);
        break;
    case STEP_REWIND:
        rewound(self, result, now);
        break;
    case STEP_TRUNCATE:
        if (result < 0) {
            failed(self);
        }
        self->step = STEP_CLOSE;
        break;
    default:
        closed(self, result);
    }
}

bool stm32_log_answer(stm32_log_t *self, bytes_t in, instant_t now) {
    if (self->asked == 0 || in.size < STORAGE_HEAD_BYTES || in.data[0] != self->asked) {
        return false;
    }
    const int32_t result = (int32_t)load32_le(in.data + 1);
    const uint64_t took_us = now.up_us - self->asked_us;
    self->asked = 0;
    if (log_has_file(self)) {
        uint32_t *stall_us = &self->log.counters.stall_us;
        *stall_us = took_us > *stall_us ? (uint32_t)(took_us < UINT32_MAX ? took_us : UINT32_MAX) : *stall_us;
    }
    if (result == STORAGE_NO_CARD) {
        if (log_has_file(self)) {
            failed(self);
        }
        log_over(self, LOG_NO_CARD);
        return true;
    }
    const bytes_t data = {in.data + STORAGE_HEAD_BYTES, in.size - STORAGE_HEAD_BYTES};
    go_on(self, result, data, now);
    return true;
}
