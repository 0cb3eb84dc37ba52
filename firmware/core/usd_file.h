/// The bytes of a log file of the µSD card: format version 2 of the Crazyflie's firmware, and in it one more
/// type of row, log.status, by which the file says how complete it is. Layout: docs/PROTOCOL.md, "µSD log".
///
/// A file is a header, rows, and the CRC-32 of everything before it. Everything is little-endian and packed.
#ifndef SPINDECK_CORE_USD_FILE_H
#define SPINDECK_CORE_USD_FILE_H

#include "usd_config.h"

enum {
    USD_FILE_MAGIC = 0xBC,
    USD_FILE_VERSION = 2,
    USD_ROW_HEAD_BYTES = 10, ///< u16 id, u64 time
    USD_ROW_BYTES_MAX = 154, ///< USD_ROW_HEAD_BYTES + 4 * (USD_CONFIG_VARIABLES_MAX + USD_CONFIG_PAYLOAD_MAX)
    USD_STATUS_BYTES = 42,
    USD_STATUS_CRC_AT = 38,
    USD_FILE_CRC_BYTES = 4,
};

/// Of one file, since it was opened.
typedef struct {
    uint32_t requested; ///< rows but for status rows: accepted + dropped
    uint32_t accepted;
    uint32_t dropped;  ///< for want of room between them and the card
    uint32_t stall_us; ///< the longest time that a storage operation has taken
    uint32_t syncs;    ///< completed
    uint32_t errors;   ///< storage operations that failed
    uint32_t session;  ///< random, not 0: tells this file's rows from those of an older one
} usd_counters_t;

/// Writes the bytes of the header from its byte `from` on, as many as there are and fit, and returns how
/// many.
size_t usd_header_encode(const usd_config_t *config, uint32_t from, bytes_mut_t out);

/// Of rows of this block.
size_t usd_row_bytes(const usd_table_t *table, const usd_block_t *block);

/// Writes a row and returns usd_row_bytes. `values` is what the table's offsets count from; unused bytes of
/// `out` stay as they are.
size_t usd_row_encode(const usd_table_t *table, const usd_block_t *block, uint64_t stamp_us,
                      const void *values, uint8_t out[154]);

/// Writes a status row. `crc` is the CRC-32 of all bytes since the status row before, or since the start of
/// the file; the row's own bytes, but for its CRC, are added to it here.
void usd_status_encode(const usd_table_t *table, const usd_counters_t *counters, uint64_t stamp_us,
                       uint32_t crc, uint8_t out[42]);

#endif
