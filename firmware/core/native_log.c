#include "native_log.h"

#include "checks.h"
#include "image.h"

enum { SEALED_BYTES = NATIVE_LOG_BYTES - NATIVE_CHECK_BYTES };

void native_log_encode(const native_log_t *log, uint8_t out[52]) {
    out[0] = NATIVE_MAGIC;
    out[1] = NATIVE_LOG;
    out[2] = log->state;
    out[3] = log->epoch;
    store64_le(out + 4, log->stm32_us);
    store32_le(out + 12, log->files);
    store32_le(out + 16, log->session);
    store32_le(out + 20, log->requested);
    store32_le(out + 24, log->accepted);
    store32_le(out + 28, log->dropped);
    store32_le(out + 32, log->stall_us);
    store32_le(out + 36, log->syncs);
    store32_le(out + 40, log->errors);
    store32_le(out + 44, log->card_errors);
    store32_le(out + SEALED_BYTES, crc32_zlib(0, (bytes_t){out, SEALED_BYTES}));
}

int native_log_decode(bytes_t in, native_log_t *log) {
    if ((in.size > 0 && in.data[0] != NATIVE_MAGIC) || (in.size > 1 && in.data[1] != NATIVE_LOG)) {
        return ERR_START;
    }
    if (in.size < NATIVE_LOG_BYTES) {
        return ERR_SHORT;
    }
    if (load32_le(in.data + SEALED_BYTES) != crc32_zlib(0, (bytes_t){in.data, SEALED_BYTES})) {
        return ERR_CHECK;
    }
    if (in.data[2] >= LOG_STATES) {
        return ERR_VALUE;
    }
    *log = (native_log_t){
        .state = in.data[2],
        .epoch = in.data[3],
        .stm32_us = load64_le(in.data + 4),
        .files = load32_le(in.data + 12),
        .session = load32_le(in.data + 16),
        .requested = load32_le(in.data + 20),
        .accepted = load32_le(in.data + 24),
        .dropped = load32_le(in.data + 28),
        .stall_us = load32_le(in.data + 32),
        .syncs = load32_le(in.data + 36),
        .errors = load32_le(in.data + 40),
        .card_errors = load32_le(in.data + 44),
    };
    return NATIVE_LOG_BYTES;
}
