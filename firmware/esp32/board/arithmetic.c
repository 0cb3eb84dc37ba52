/// What the compiler calls for a division of 32 bits: the ESP8266, which it is made for, has these in its
/// ROM, and the ESP32 has none at that place.

#include <stdint.h>

uint32_t __udivsi3(uint32_t dividend, uint32_t divisor);
uint32_t __umodsi3(uint32_t dividend, uint32_t divisor);
int32_t __divsi3(int32_t dividend, int32_t divisor);
int32_t __modsi3(int32_t dividend, int32_t divisor);

typedef struct {
    uint32_t quotient;
    uint32_t rest;
} division_t;

/// By 0: the quotient is all ones, the rest the dividend.
static division_t divide(uint32_t dividend, uint32_t divisor) {
    division_t result = {0};
    for (int bit = 31; bit >= 0; bit--) {
        const uint32_t carry = result.rest >> 31;
        result.rest = result.rest << 1 | (dividend >> bit & 1);
        if (carry != 0 || result.rest >= divisor) {
            result.rest -= divisor;
            result.quotient |= (uint32_t)1 << bit;
        }
    }
    return result;
}

static uint32_t magnitude(int32_t value) {
    return value < 0 ? 0 - (uint32_t)value : (uint32_t)value;
}

uint32_t __udivsi3(uint32_t dividend, uint32_t divisor) {
    return divide(dividend, divisor).quotient;
}

uint32_t __umodsi3(uint32_t dividend, uint32_t divisor) {
    return divide(dividend, divisor).rest;
}

int32_t __divsi3(int32_t dividend, int32_t divisor) {
    const uint32_t quotient = divide(magnitude(dividend), magnitude(divisor)).quotient;
    return (int32_t)((dividend < 0) != (divisor < 0) ? 0 - quotient : quotient);
}

int32_t __modsi3(int32_t dividend, int32_t divisor) {
    const uint32_t rest = divide(magnitude(dividend), magnitude(divisor)).rest;
    return (int32_t)(dividend < 0 ? 0 - rest : rest);
}
