#include "trace.h"

#include <stdlib.h>
#include <string.h>

static const uint64_t FNV_BASIS = 0xCBF29CE484222325u;
static const uint64_t FNV_PRIME = 0x100000001B3u;

void trace_free(trace_t *self) {
    free(self->runs);
    free(self->data);
    *self = (trace_t){0};
}

void trace_start(trace_t *self, int mode) {
    trace_free(self);
    self->mode = mode;
}

void trace_wire_start(trace_wire_t *wire) {
    free(wire->bytes);
    *wire = (trace_wire_t){.hash = FNV_BASIS};
}

static void *grown(void *memory, size_t *capacity, size_t needed, size_t item) {
    if (needed <= *capacity) {
        return memory;
    }
    size_t larger = needed < 128 ? 256 : 2 * needed;
    void *moved = realloc(memory, larger * item);
    if (moved != NULL) {
        *capacity = larger;
    }
    return moved;
}

static uint64_t hashed(uint64_t hash, bytes_t bytes) {
    for (size_t i = 0; i < bytes.size; i++) {
        hash = (hash ^ bytes.data[i]) * FNV_PRIME;
    }
    return hash;
}

void trace_begin(trace_wire_t *wire, const trace_run_t *run) {
    wire->open = true;
    wire->run = *run;
}

void trace_bytes(trace_t *self, trace_wire_t *wire, bytes_t bytes) {
    if (!wire->open) {
        return; // the run began before the trace did
    }
    wire->hash = hashed(wire->hash, bytes);
    if (self->mode == TRACE_FULL) {
        uint8_t *kept = grown(wire->bytes, &wire->capacity, wire->run.length + bytes.size, 1);
        if (kept == NULL) {
            self->failed = true;
            return;
        }
        wire->bytes = kept;
        memcpy(wire->bytes + wire->run.length, bytes.data, bytes.size);
    }
    wire->run.length += (uint32_t)bytes.size;
}

void trace_end(trace_t *self, trace_wire_t *wire) {
    if (!wire->open) {
        return;
    }
    wire->open = false;
    if (wire->run.length == 0) {
        return; // cut in its first byte
    }
    uint8_t record[32];
    store64_le(record, (uint64_t)wire->run.local_start_ns);
    store64_le(record + 8, (uint64_t)wire->run.true_start_ns);
    store64_le(record + 16, (uint64_t)wire->run.byte_ps);
    store64_le(record + 24, wire->run.length);
    wire->hash = hashed(wire->hash, (bytes_t){record, sizeof record});
    if (self->mode != TRACE_FULL || self->failed) {
        return;
    }
    trace_run_t *runs = grown(self->runs, &self->run_capacity, self->run_count + 1, sizeof *runs);
    self->runs = runs != NULL ? runs : self->runs;
    uint8_t *data = grown(self->data, &self->capacity, self->size + wire->run.length, 1);
    self->data = data != NULL ? data : self->data;
    if (runs == NULL || data == NULL) {
        self->failed = true;
        return;
    }
    wire->run.offset = self->size;
    memcpy(data + self->size, wire->bytes, wire->run.length);
    self->size += wire->run.length;
    runs[self->run_count++] = wire->run;
}
