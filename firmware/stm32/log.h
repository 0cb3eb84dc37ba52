/// The logger: which requests to the card make a file out of rows, and what is done when one fails.
///
/// At boot config.txt is read. Logging begins then if it says so, or when it is told to. A file is the name
/// of config.txt and the first free number, 00 to 99. Rows wait in the ring, and go to the card in whole
/// sectors as soon as there is one. Every sync_us a status row is made, all up to it is written, and the card
/// is asked to sync. As soon as the header is synced space is allocated ahead, so a sync changes no FAT, and
/// a full card is known while there is still room for a proper end; closing gives back what was not used.
///
/// A write that fails is tried again. If it fails for good, the file is cut back to its last status row that
/// is on the card and ended there, and the log goes on in the next file, which begins with what was lost.
#ifndef SPINDECK_STM32_LOG_H
#define SPINDECK_STM32_LOG_H

#include "../core/native_log.h"
#include "../core/usd_log.h"
#include "storage.h"

enum {
    STM32_LOG_RING_BYTES = 65535, ///< USD_CONFIG_RING_MAX
    STM32_LOG_SYNC_US = 250000,
    STM32_LOG_CHUNK_BYTES = 1 << 20, ///< allocated at a time
    STM32_LOG_CHUNK_MIN = 4096,      ///< with less on the card it is full
    STM32_LOG_NAMES = 100,
    STM32_LOG_TRIES = 3, ///< of a write; and of files, when one after the other fails
};

typedef struct {
    uint32_t sync_us; ///< 0 means STM32_LOG_SYNC_US
    uint32_t seed;    ///< of the sessions: random, or at least different in each robot
    uint32_t boot;    ///< likewise: counts the boots
} stm32_log_config_t;

typedef struct {
    uint32_t status;     ///< log_state_t
    uint32_t files;      ///< created since boot
    uint32_t errors;     ///< storage operations that failed since boot
    uint32_t lost;       ///< rows while there was no file; the next one begins with them
    usd_log_t log;       ///< the present file, or the last
    usd_config_t config; ///< config.txt
    // Private from here on.
    stm32_log_config_t settings;
    uint64_t row_next_us;  ///< uptime, as all here
    uint64_t sync_next_us; ///< if not `draining`
    uint64_t asked_us;
    uint32_t extent; ///< of the file, allocated
    uint32_t chunk;  ///< to be allocated next; 0: no more
    uint32_t target; ///< of `draining`
    uint32_t cut_rows;
    uint32_t carried_errors;
    uint16_t size; ///< of the write under way
    uint8_t step;
    uint8_t asked; ///< the operation under way; 0: none
    uint8_t number;
    uint8_t tries;
    uint8_t failures; ///< files that failed without a sync
    bool usable;      ///< config
    bool wanted;
    bool open;     ///< takes rows
    bool draining; ///< up to `target`, then sync or close
    bool ended;
    bool rescuing;
    bool next; ///< go on in the next file
    uint8_t *ring;
} stm32_log_t;

/// `table` and the STM32_LOG_RING_BYTES of `ring` must live as long.
void stm32_log_init(stm32_log_t *self, const stm32_log_config_t *config, const usd_table_t *table,
                    uint8_t *ring);

/// Begin, or close: both take their time.
void stm32_log_set(stm32_log_t *self, bool on);

/// Are there rows to be made, or to be counted?
static inline bool stm32_log_runs(const stm32_log_t *self) {
    return self->open || self->next;
}

/// Is a row of the fixed frequency due? Then stm32_log_row with USD_CONFIG_FIXED comes next.
bool stm32_log_due(const stm32_log_t *self, uint64_t now_us);

/// Are rows of this event wanted now?
bool stm32_log_wants(const stm32_log_t *self, uint16_t event);

/// A row of this event, if it is wanted.
void stm32_log_row(stm32_log_t *self, uint16_t event, instant_t now, const void *values);

/// The next request, or 0. `out` should have STORAGE_REQUEST_MAX bytes; with less, writes are shorter.
size_t stm32_log_request(stm32_log_t *self, bytes_mut_t out, instant_t now);

/// False: it answers nothing that was asked.
bool stm32_log_answer(stm32_log_t *self, bytes_t in, instant_t now);

uint64_t stm32_log_deadline(const stm32_log_t *self);

#endif
