#include "ring.h"

#include <string.h>

size_t ring_write(ring_t *self, const uint8_t *in, size_t size) {
    size = size < ring_room(self) ? size : ring_room(self);
    size_t at = self->head + self->fill;
    at -= at >= self->capacity ? self->capacity : 0;
    size_t first = size < self->capacity - at ? size : self->capacity - at;
    if (size != 0) {
        memcpy(self->data + at, in, first);
        memcpy(self->data, in + first, size - first);
    }
    self->fill += size;
    return size;
}

size_t ring_read(ring_t *self, uint8_t *out, size_t size) {
    size = size < self->fill ? size : self->fill;
    size_t first = size < self->capacity - self->head ? size : self->capacity - self->head;
    if (size != 0) {
        memcpy(out, self->data + self->head, first);
        memcpy(out + first, self->data, size - first);
    }
    self->head += size;
    self->head -= self->head >= self->capacity ? self->capacity : 0;
    self->fill -= size;
    self->head = self->fill == 0 ? 0 : self->head; // stays in the cache
    return size;
}
