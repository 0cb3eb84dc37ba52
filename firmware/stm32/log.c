#include "log_parts.h"

#include "../core/checks.h"

_Static_assert(USD_CONFIG_RING_MIN ==
                   STORAGE_SECTOR_BYTES - 1 + USD_ROW_BYTES_MAX + USD_STATUS_BYTES + USD_LOG_END_BYTES,
               "the least ring holds what waits for a sector, and a row");

void stm32_log_init(stm32_log_t *self, const stm32_log_config_t *config, const usd_table_t *table,
                    uint8_t *ring) {
    memset(self, 0, sizeof *self);
    self->settings = *config;
    self->ring = ring;
    self->status = LOG_STARTS;
    self->step = STEP_OPEN;
    usd_config_init(&self->config, table);
}

void log_over(stm32_log_t *self, log_state_t why) {
    self->status = why;
    self->step = STEP_NONE;
    self->open = false;
    self->next = false;
}

void stm32_log_set(stm32_log_t *self, bool on) {
    self->wanted = on;
    if (log_has_file(self)) {
        self->open = self->open && on;
        self->next = self->next && on;
        return; // closed, or begun again, when the present request has been answered
    }
    if (self->step != STEP_NONE) {
        return;
    }
    self->status = on ? LOG_STARTS : LOG_OFF;
    if (on) {
        self->step = self->usable ? STEP_CREATE : STEP_OPEN;
        self->number = self->number == STM32_LOG_NAMES ? 0 : self->number;
        self->failures = 0;
        self->lost = 0;
    }
}

static uint32_t session(const stm32_log_t *self, uint64_t now_us) {
    uint8_t bytes[20];
    store32_le(bytes, self->settings.seed);
    store32_le(bytes + 4, self->settings.boot);
    store32_le(bytes + 8, self->files);
    store64_le(bytes + 12, now_us);
    const uint32_t made = crc32_zlib(0, (bytes_t){bytes, sizeof bytes});
    return made == 0 ? 1 : made;
}

/// All that has been made goes to the card.
void log_drain(stm32_log_t *self) {
    self->draining = true;
    self->target = self->log.bytes;
}

void log_begin_file(stm32_log_t *self, instant_t now) {
    self->files++;
    const usd_counters_t counters = {
        .requested = self->lost,
        .dropped = self->lost,
        .errors = self->carried_errors,
        .session = session(self, now.up_us),
    };
    usd_log_begin(&self->log, &self->config, self->ring, &counters, now.stamp_us);
    if (!self->next) { // else the rows kept their grid while there was no file
        self->row_next_us = self->config.period_us > 0 ? now.up_us : NEVER_US;
    }
    self->lost = 0;
    self->carried_errors = 0;
    self->cut_rows = 0;
    self->sync_next_us = now.up_us + log_sync_us(self);
    self->extent = 0;
    self->chunk = STM32_LOG_CHUNK_BYTES;
    self->tries = 0;
    self->open = self->wanted;
    self->ended = false;
    self->rescuing = false;
    self->next = false;
    self->status = LOG_ON;
    self->step = STEP_WRITE;
    log_drain(self);
}

bool stm32_log_due(const stm32_log_t *self, uint64_t now_us) {
    return stm32_log_runs(self) && now_us >= self->row_next_us;
}

static const usd_block_t *block_of(const stm32_log_t *self, uint16_t event) {
    for (uint8_t i = 0; stm32_log_runs(self) && i < self->config.block_count; i++) {
        if (self->config.blocks[i].event == event) {
            return &self->config.blocks[i];
        }
    }
    return NULL;
}

bool stm32_log_wants(const stm32_log_t *self, uint16_t event) {
    return block_of(self, event) != NULL;
}

static void count_missed(stm32_log_t *self, uint32_t rows) {
    if (self->open) {
        usd_log_missed(&self->log, rows);
    } else {
        self->lost += rows;
    }
}

void stm32_log_row(stm32_log_t *self, uint16_t event, instant_t now, const void *values) {
    const usd_block_t *block = block_of(self, event);
    if (block == NULL) {
        return;
    }
    if (event == USD_CONFIG_FIXED) {
        count_missed(self, (uint32_t)((now.up_us - self->row_next_us) / self->config.period_us));
        self->row_next_us = next_on_grid(self->row_next_us, self->config.period_us, now.up_us);
    }
    if (self->open) {
        usd_log_row(&self->log, block, now.stamp_us, values);
    } else {
        self->lost++;
    }
}

uint64_t stm32_log_deadline(const stm32_log_t *self) {
    uint64_t deadline_us = stm32_log_runs(self) ? self->row_next_us : NEVER_US;
    if (self->step == STEP_WRITE && self->asked == 0 && !self->draining && self->sync_next_us < deadline_us) {
        deadline_us = self->sync_next_us;
    }
    return deadline_us;
}
