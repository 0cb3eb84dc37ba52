/// A bounded ring of bytes. The caller owns its memory.
#ifndef SPINDECK_SIM_RING_H
#define SPINDECK_SIM_RING_H

#include <stddef.h>
#include <stdint.h>

typedef struct {
    uint8_t *data;
    size_t capacity, head, fill;
} ring_t;

static inline size_t ring_room(const ring_t *self) {
    return self->capacity - self->fill;
}

/// Both move as much as fits or is there, and return how much.
size_t ring_write(ring_t *self, const uint8_t *in, size_t size);
size_t ring_read(ring_t *self, uint8_t *out, size_t size);

#endif
