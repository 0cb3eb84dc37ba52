/// The fuzzer's bytes, taken from the front as choices and as data.
#ifndef SPINDECK_FUZZ_INPUT_H
#define SPINDECK_FUZZ_INPUT_H

#include "firmware/core/bytes.h"

static inline bytes_t take(bytes_t *input, size_t most) {
    const bytes_t taken = {input->data, most < input->size ? most : input->size};
    input->data += taken.size;
    input->size -= taken.size;
    return taken;
}

/// 0 when there are no more bytes.
static inline uint8_t take_byte(bytes_t *input) {
    const bytes_t taken = take(input, 1);
    return taken.size > 0 ? taken.data[0] : 0;
}

/// A waiting time in microseconds, from none to some seconds: 4 bits of exponent, 4 of mantissa.
static inline uint64_t take_us(bytes_t *input) {
    const uint8_t choice = take_byte(input);
    return (uint64_t)(choice & 15U) << (choice >> 4) << 4;
}

#endif
