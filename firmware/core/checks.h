/// The three checksums of the robot's wires. Pure; cost is linear in `in.size`; none can fail.
/// Their tables take 16.5 KiB of constant data: 512 bytes for CRC-16, 16 KiB for CRC-32 (sixteen bytes a
/// step).
#ifndef SPINDECK_CORE_CHECKS_H
#define SPINDECK_CORE_CHECKS_H

#include "bytes.h"

/// XOR of all bytes: the check byte of CPX over UART (docs/PROTOCOL.md, "CPX over UART").
uint8_t xor8(bytes_t in);

/// CRC-16/CCITT-FALSE: polynomial 0x1021, start 0xFFFF, not reflected. "123456789" gives 0x29B1.
uint16_t crc16_ccitt_false(bytes_t in);

/// CRC-32 as zlib's: reflected 0xEDB88320, start and final XOR 0xFFFFFFFF. "123456789" gives 0xCBF43926.
/// `crc` is 0 at first, or the result so far: crc32_zlib(crc32_zlib(0, a), b) is the CRC of a then b.
uint32_t crc32_zlib(uint32_t crc, bytes_t in);

#endif
