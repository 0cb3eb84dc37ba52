#include <stdint.h>
#include <string.h>

// Without this, a compiler may see that a loop is memcpy, and call it: from within memcpy.
#define NOT_A_CALL() __asm volatile("")

/// Whole words where both ends allow it: a frame is most of what is copied.
typedef uint32_t __attribute__((may_alias)) word_t;

static size_t words(uintptr_t ends, size_t size) {
    return ends % sizeof(word_t) == 0 ? size / sizeof(word_t) : 0;
}

void *memcpy(void *restrict to, const void *restrict from, size_t size) {
    uint8_t *out = to;
    const uint8_t *in = from;
    size_t i = 0;
    for (const size_t end = words((uintptr_t)to | (uintptr_t)from, size); i < end; i++) {
        ((word_t *)to)[i] = ((const word_t *)from)[i];
        NOT_A_CALL();
    }
    for (i *= sizeof(word_t); i < size; i++) {
        out[i] = in[i];
        NOT_A_CALL();
    }
    return to;
}

void *memmove(void *to, const void *from, size_t size) {
    uint8_t *out = to;
    const uint8_t *in = from;
    if ((uintptr_t)to <= (uintptr_t)from) {
        size_t i = 0;
        for (const size_t end = words((uintptr_t)to | (uintptr_t)from, size); i < end; i++) {
            ((word_t *)to)[i] = ((const word_t *)from)[i];
            NOT_A_CALL();
        }
        for (i *= sizeof(word_t); i < size; i++) {
            out[i] = in[i];
            NOT_A_CALL();
        }
    } else {
        for (size_t i = size; i > 0; i--) {
            out[i - 1] = in[i - 1];
            NOT_A_CALL();
        }
    }
    return to;
}

void *memset(void *to, int value, size_t size) {
    uint8_t *out = to;
    const word_t word = (uint8_t)value * 0x01010101U;
    size_t i = 0;
    for (const size_t end = words((uintptr_t)to, size); i < end; i++) {
        ((word_t *)to)[i] = word;
        NOT_A_CALL();
    }
    for (i *= sizeof(word_t); i < size; i++) {
        out[i] = (uint8_t)value;
        NOT_A_CALL();
    }
    return to;
}

int memcmp(const void *a, const void *b, size_t size) {
    const uint8_t *left = a;
    const uint8_t *right = b;
    for (size_t i = 0; i < size; i++) {
        if (left[i] != right[i]) {
            return left[i] - right[i];
        }
    }
    return 0;
}

void *memchr(const void *in, int value, size_t size) {
    const uint8_t *bytes = in;
    for (size_t i = 0; i < size; i++) {
        if (bytes[i] == (uint8_t)value) {
            return (void *)(uintptr_t)&bytes[i];
        }
    }
    return NULL;
}

size_t strlen(const char *text) {
    size_t size = 0;
    while (text[size] != 0) {
        size++;
        NOT_A_CALL();
    }
    return size;
}
