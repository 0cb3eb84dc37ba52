#include "stamp.h"

#include "checks.h"

enum { SYNC_BYTES = 2, CHECK_AT = 15 };

static bytes_t checked(const uint8_t *message) {
    return (bytes_t){message + SYNC_BYTES, CHECK_AT - SYNC_BYTES};
}

void stamp_encode(const stamp_t *stamp, uint8_t out[17]) {
    out[0] = STAMP_SYNC_0;
    out[1] = STAMP_SYNC_1;
    store32_le(out + 2, stamp->sequence);
    store64_le(out + 6, stamp->stm32_us);
    out[14] = stamp->epoch;
    store16_le(out + CHECK_AT, crc16_ccitt_false(checked(out)));
}

int stamp_decode(bytes_t in, stamp_t *stamp) {
    if ((in.size > 0 && in.data[0] != STAMP_SYNC_0) || (in.size > 1 && in.data[1] != STAMP_SYNC_1)) {
        return ERR_START;
    }
    if (in.size < STAMP_BYTES) {
        return ERR_SHORT;
    }
    if (load16_le(in.data + CHECK_AT) != crc16_ccitt_false(checked(in.data))) {
        return ERR_CHECK;
    }
    *stamp = (stamp_t){
        .sequence = load32_le(in.data + 2),
        .stm32_us = load64_le(in.data + 6),
        .epoch = in.data[14],
    };
    return STAMP_BYTES;
}
