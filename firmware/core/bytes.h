/// Views of bytes, the two clock readings, and little-endian load and store.
///
/// Every multi-byte integer on every wire of this robot is little-endian. Bytes are moved one by one, never
/// through a cast, so the code means the same on every target and compiler.
#ifndef SPINDECK_CORE_BYTES_H
#define SPINDECK_CORE_BYTES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

/// Bytes to read. A view: whoever made it owns the memory and says how long it stays valid.
typedef struct {
    const uint8_t *data;
    size_t size;
} bytes_t;

/// Room to write `size` bytes.
typedef struct {
    uint8_t *data;
    size_t size;
} bytes_mut_t;

/// One moment, read on one MCU's two clocks.
/// `up_us` is the uptime: monotonic, drifting with the crystal, unwrapped by the board. All scheduling uses
/// it. `stamp_us` is the clock that time-stamps: it may be reset, wrapped, divided by 84 or 85, or coarse.
/// Nothing is ever scheduled by it, so that a reset of it never disturbs a deadline.
typedef struct {
    uint64_t up_us;
    uint64_t stamp_us;
} instant_t;

/// What a deadline is when an app waits for nothing.
#define NEVER_US UINT64_MAX

static inline uint16_t load16_le(const uint8_t in[2]) {
    return (uint16_t)(in[0] | (uint16_t)(in[1] << 8));
}

static inline uint32_t load32_le(const uint8_t in[4]) {
    return (uint32_t)in[0] | ((uint32_t)in[1] << 8) | ((uint32_t)in[2] << 16) | ((uint32_t)in[3] << 24);
}

static inline uint64_t load64_le(const uint8_t in[8]) {
    return (uint64_t)load32_le(in) | ((uint64_t)load32_le(in + 4) << 32);
}

static inline void store16_le(uint8_t out[2], uint16_t value) {
    out[0] = (uint8_t)value;
    out[1] = (uint8_t)(value >> 8);
}

static inline void store32_le(uint8_t out[4], uint32_t value) {
    for (int i = 0; i < 4; i++) {
        out[i] = (uint8_t)(value >> (8 * i));
    }
}

static inline void store64_le(uint8_t out[8], uint64_t value) {
    store32_le(out, (uint32_t)value);
    store32_le(out + 4, (uint32_t)(value >> 32));
}

/// Floats are IEEE 754 on every part of the robot: their four bytes travel, whatever they mean.
static inline float load_float_le(const uint8_t in[4]) {
    const uint32_t bits = load32_le(in);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline void store_float_le(uint8_t out[4], float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    store32_le(out, bits);
}

#endif
