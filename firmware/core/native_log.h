/// The native message about the log on the STM32's card: once a second to a host that has asked.
///
/// The counters are those of the log's own status rows, so that a host knows during the flight whether the
/// log is complete. As CPX_APP from CPX_STM32 to CPX_HOST, in one packet on every link. Layout:
/// docs/PROTOCOL.md.
#ifndef SPINDECK_CORE_NATIVE_LOG_H
#define SPINDECK_CORE_NATIVE_LOG_H

#include "bytes.h"

enum { NATIVE_LOG_BYTES = 52 };

/// native_log_t.state: what the logger does, or why it does nothing.
typedef enum {
    LOG_OFF = 0, ///< not told to
    LOG_STARTS = 1,
    LOG_ON = 2,
    LOG_CLOSES = 3,
    LOG_NO_CARD = 4, ///< from here on it is over until it is told to begin anew
    LOG_NO_CONFIG = 5,
    LOG_BAD_CONFIG = 6, ///< its findings say why
    LOG_NO_NAME = 7,    ///< all hundred are taken
    LOG_FULL = 8,
    LOG_FAILED = 9, ///< the card
    LOG_STATES = 10,
} log_state_t;

/// Counters are of the file under way, or of the last one, but for the last; all 0 before the first.
typedef struct {
    uint8_t state;     ///< log_state_t
    uint8_t epoch;     ///< of the STM32's stamp clock
    uint64_t stm32_us; ///< its stamp clock when this was made
    uint32_t files;    ///< begun since boot
    uint32_t session;  ///< of the file, as in its status rows
    uint32_t requested;
    uint32_t accepted;
    uint32_t dropped;
    uint32_t stall_us;
    uint32_t syncs;
    uint32_t errors;
    uint32_t card_errors; ///< since boot
} native_log_t;

/// Cannot fail.
void native_log_encode(const native_log_t *log, uint8_t out[52]);

/// As the other messages (image.h): the bytes used, or ERR_START, ERR_SHORT, ERR_CHECK, or ERR_VALUE for a
/// state that is none; the output is untouched on error.
int native_log_decode(bytes_t in, native_log_t *log);

#endif
