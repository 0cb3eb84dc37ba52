/// One log file as it is made: rows go in, the file's bytes come out in order, and in between is a bounded
/// ring. A row that does not fit is dropped whole, and counted.
///
/// There is always room for the status row of the next sync, and for the end of the file. A status row ends
/// a part of the file that can be verified without the rest; the last of them that has reached the card is
/// where the file can be cut back to, if what was written behind it has failed.
#ifndef SPINDECK_CORE_USD_LOG_H
#define SPINDECK_CORE_USD_LOG_H

#include "usd_file.h"

enum {
    USD_LOG_END_BYTES = 46, ///< USD_STATUS_BYTES + USD_FILE_CRC_BYTES: kept free in the ring
    USD_LOG_LIMIT_BYTES =
        88, ///< USD_STATUS_BYTES + USD_LOG_END_BYTES: kept free between the rows and the limit
};

/// A place in the file behind a status row.
typedef struct {
    uint32_t bytes; ///< of the file up to it
    uint32_t crc;   ///< of them
    uint32_t accepted;
} usd_mark_point_t;

/// `config`, and the memory of the ring, are the caller's and must live as long.
typedef struct {
    usd_counters_t counters; ///< stall_us, syncs and errors are the caller's to count
    uint32_t bytes;          ///< of the file, made so far
    uint32_t written;        ///< of them, those on the card
    uint32_t limit;          ///< most that the file may get; UINT32_MAX: as it comes
    bool full;               ///< a row was dropped for the limit's sake
    uint32_t fill_max;       ///< most that the ring has held
    // Private from here on.
    uint32_t ring_bytes;
    uint32_t head; ///< of the oldest byte
    uint32_t fill;
    uint32_t header_bytes;
    uint32_t crc;        ///< of all bytes so far
    uint32_t status_crc; ///< of those since the last status row
    usd_mark_point_t made;
    usd_mark_point_t safe; ///< of those that have been written
    uint8_t *ring;
    const usd_config_t *config;
} usd_log_t;

/// A new file: its header and its first status row. `ring` has config->ring_bytes. Of `counters`, requested
/// and dropped may begin with rows that were lost before the file could be opened.
void usd_log_begin(usd_log_t *self, const usd_config_t *config, uint8_t *ring, const usd_counters_t *counters,
                   uint64_t stamp_us);

/// A row of the block. False: it did not fit. Stamps are the caller's, in their order.
bool usd_log_row(usd_log_t *self, const usd_block_t *block, uint64_t stamp_us, const void *values);

/// Rows that were due and for which the caller came too late.
void usd_log_missed(usd_log_t *self, uint32_t rows);

/// A status row. The one before must have been written (usd_log_taken).
void usd_log_status(usd_log_t *self, uint64_t stamp_us);

/// The last status row and the CRC of the file, behind which nothing may come. Likewise.
void usd_log_end(usd_log_t *self, uint64_t stamp_us);

/// Copies the next bytes for the card, without taking them, and returns how many.
size_t usd_log_peek(const usd_log_t *self, bytes_mut_t out);

/// So many of them are on the card.
void usd_log_taken(usd_log_t *self, uint32_t bytes);

/// Where the file can be cut back to; 0: nowhere.
uint32_t usd_log_safe(const usd_log_t *self);

/// Cuts it back there: what was made since is gone, its rows are counted as dropped. The next call is
/// usd_log_end.
void usd_log_cut(usd_log_t *self);

#endif
