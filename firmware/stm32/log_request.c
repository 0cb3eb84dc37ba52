#include "log_parts.h"

enum { REQUEST_MIN = 64, NAME_DIGITS = 2 };

static const char CONFIG_NAME[] = "config.txt";

/// Is less than half a chunk left of what is allocated? Not before the header is on the card for certain: in
/// the new space an older log may lie, header and all, and would be taken for this one.
static bool wants_space(const stm32_log_t *self) {
    return self->log.counters.syncs > 0 && self->chunk > 0 && !self->ended &&
           (uint64_t)self->log.bytes + self->chunk / 2 > self->extent;
}

/// What to do with an open file for which nothing is under way.
static void choose(stm32_log_t *self, instant_t now) {
    if (!self->draining && (!self->open || self->log.full)) {
        self->open = false;
        self->status = LOG_CLOSES;
        usd_log_end(&self->log, now.stamp_us);
        self->ended = true;
        log_drain(self);
    } else if (!self->draining && now.up_us >= self->sync_next_us) {
        self->sync_next_us = next_on_grid(self->sync_next_us, log_sync_us(self), now.up_us);
        if (self->log.bytes > self->target) {
            usd_log_status(&self->log, now.stamp_us);
            log_drain(self);
        }
    }
    if (wants_space(self)) {
        self->step = STEP_EXTEND;
    } else if (self->draining && self->log.written == self->target) {
        self->step = self->ended ? STEP_TRUNCATE : STEP_SYNC;
    }
}

/// How much to write now: whole sectors, but for the last before a sync.
static uint32_t write_size(const stm32_log_t *self, size_t most) {
    const uint32_t waiting = (self->draining ? self->target : self->log.bytes) - self->log.written;
    const uint32_t max = most < STORAGE_WRITE_MAX ? (uint32_t)most : STORAGE_WRITE_MAX;
    if (self->draining && waiting <= max) {
        return waiting;
    }
    const uint32_t end = self->log.written + (waiting < max ? waiting : max);
    const uint32_t sector = end - end % STORAGE_SECTOR_BYTES;
    return sector > self->log.written ? sector - self->log.written : 0;
}

static size_t seek(uint8_t *argument, uint32_t position) {
    store32_le(argument, position);
    return sizeof position;
}

static size_t file_name(const stm32_log_t *self, uint8_t *out) {
    const size_t size = strlen(self->config.name);
    memcpy(out, self->config.name, size);
    out[size] = (uint8_t)('0' + self->number / 10);
    out[size + 1] = (uint8_t)('0' + self->number % 10);
    return size + NAME_DIGITS;
}

/// Writes the operation's argument and returns its size.
static size_t argument(stm32_log_t *self, bytes_mut_t out) {
    switch (self->step) {
    case STEP_OPEN:
        memcpy(out.data, CONFIG_NAME, sizeof CONFIG_NAME - 1);
        return sizeof CONFIG_NAME - 1;
    case STEP_READ:
        store16_le(out.data, STORAGE_READ_MAX);
        return 2;
    case STEP_CREATE:
        return file_name(self, out.data);
    case STEP_EXTEND:
        return seek(out.data, self->extent + self->chunk);
    case STEP_RETURN:
        return seek(out.data, self->log.written);
    case STEP_REWIND:
        return seek(out.data, usd_log_safe(&self->log));
    case STEP_WRITE:
        self->size = (uint16_t)write_size(self, out.size);
        return usd_log_peek(&self->log, (bytes_mut_t){out.data, self->size});
    default:
        return 0;
    }
}

static uint8_t operation(uint8_t step) {
    static const uint8_t OPERATIONS[] = {
        [STEP_NONE] = 0,
        [STEP_OPEN] = STORAGE_OPEN,
        [STEP_READ] = STORAGE_READ,
        [STEP_READ_END] = STORAGE_CLOSE,
        [STEP_CREATE] = STORAGE_CREATE,
        [STEP_EXTEND] = STORAGE_SEEK,
        [STEP_RETURN] = STORAGE_SEEK,
        [STEP_WRITE] = STORAGE_WRITE,
        [STEP_SYNC] = STORAGE_SYNC,
        [STEP_REWIND] = STORAGE_SEEK,
        [STEP_TRUNCATE] = STORAGE_TRUNCATE,
        [STEP_CLOSE] = STORAGE_CLOSE,
    };
    return OPERATIONS[step];
}

size_t stm32_log_request(stm32_log_t *self, bytes_mut_t out, instant_t now) {
    if (self->asked != 0 || self->step == STEP_NONE || out.size < REQUEST_MIN) {
        return 0;
    }
    if (self->step == STEP_WRITE) {
        choose(self, now);
    }
    const size_t size = argument(self, (bytes_mut_t){out.data + 1, out.size - 1});
    if (self->step == STEP_WRITE && size == 0) {
        return 0;
    }
    self->asked = operation(self->step);
    self->asked_us = now.up_us;
    out.data[0] = self->asked;
    return 1 + size;
}
