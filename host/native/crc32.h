/// CRC-32 as zlib's, with the instructions that this processor has.
#ifndef SPINDECK_HOST_CRC32_H
#define SPINDECK_HOST_CRC32_H

#include "../../firmware/core/bytes.h"

/// Ways to compute it. Each gives the same result, or false where this processor or this build cannot.
enum {
    CRC32_TABLES = 0,          ///< crc32_zlib of the firmware, sixteen bytes a step: everywhere
    CRC32_CARRY_LESS = 1,      ///< x86-64 with PCLMULQDQ
    CRC32_CARRY_LESS_WIDE = 2, ///< x86-64 with AVX2 and VPCLMULQDQ, two products at once
    CRC32_INSTRUCTIONS = 3,    ///< aarch64 with the CRC extension
    CRC32_WAYS = 4,
};

/// The CRC of `in` behind bytes whose CRC is `crc` (0 at first), by the fastest way there is.
uint32_t crc32_host(uint32_t crc, bytes_t in);

/// The same by a way of the caller's choice. False, and `out` untouched: it is not to be had here.
bool crc32_by(uint8_t way, uint32_t crc, bytes_t in, uint32_t *out);

#endif
