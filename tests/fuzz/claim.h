/// What a fuzz target states about the code: a claim that does not hold ends the run and is printed.
#ifndef SPINDECK_FUZZ_CLAIM_H
#define SPINDECK_FUZZ_CLAIM_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { POISON = 0xA5 };

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

#define CLAIM(condition) claim((condition), #condition, __FILE__, __LINE__)

static inline void claim(bool holds, const char *text, const char *file, int line) {
    if (!holds) {
        fprintf(stderr, "%s:%d: not so: %s\n", file, line, text);
        abort();
    }
}

/// Is every byte of the `size` at `memory` still POISON?
static inline bool untouched(const void *memory, size_t size) {
    for (size_t i = 0; i < size; i++) {
        if (((const uint8_t *)memory)[i] != POISON) {
            return false;
        }
    }
    return true;
}

#endif
