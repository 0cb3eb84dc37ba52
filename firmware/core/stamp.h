/// The native STM32 -> GAP8 time message: 17 bytes, 100 a second over UART1 at 115200 Bd (1.48 ms on the
/// wire).
///
/// D5 2A | u32 sequence | u64 STM32 stamp clock, us | u8 epoch | u16 CRC-16/CCITT-FALSE of bytes 2..14.
/// The clock is read at the instant when the first byte starts to leave. `epoch` counts resets of the stamp
/// clock since boot, so that no two epochs are ever mixed (docs/PROTOCOL.md, "Stamp message").
#ifndef SPINDECK_CORE_STAMP_H
#define SPINDECK_CORE_STAMP_H

#include "cpx.h"

enum {
    STAMP_BYTES = 17,
    STAMP_SYNC_0 = 0xD5,
    STAMP_SYNC_1 = 0x2A,
    STAMP_PERIOD_US = 10000,
};

typedef struct {
    uint32_t sequence; ///< +1 each message, wraps
    uint64_t stm32_us; ///< stamp clock when the message began to leave
    uint8_t epoch;
} stamp_t;

void stamp_encode(const stamp_t *stamp, uint8_t out[17]);

/// STAMP_BYTES, or ERR_SHORT, ERR_START, ERR_CHECK. `*stamp` is untouched on error.
int stamp_decode(bytes_t in, stamp_t *stamp);

#endif
