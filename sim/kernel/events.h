/// What happens next: a heap over a fixed number of sources, each with at most one time. Setting a source
/// again moves it, so nothing stale is ever kept and the heap is never larger than the number of sources.
#ifndef SPINDECK_SIM_EVENTS_H
#define SPINDECK_SIM_EVENTS_H

#include <stdbool.h>
#include <stdint.h>

typedef struct {
    int64_t time_ns;
    uint64_t sequence; ///< order of creation, for equal times
    uint32_t source;
} event_t;

typedef struct {
    event_t *heap;
    uint32_t *place; ///< by source: its place in the heap, from 1; 0: none
    uint32_t fill;
    uint32_t sources;
    uint64_t sequence;
} events_t;

/// False when out of memory; then nothing has changed.
bool events_grow(events_t *self, uint32_t sources);
void events_free(events_t *self);
void events_set(events_t *self, uint32_t source, int64_t time_ns);
void events_clear(events_t *self, uint32_t source);

static inline bool events_pending(const events_t *self, uint32_t source) {
    return self->place[source] != 0;
}

/// The earliest time, or INT64_MAX.
static inline int64_t events_next_ns(const events_t *self) {
    return self->fill == 0 ? INT64_MAX : self->heap[0].time_ns;
}

/// Removes the earliest event, of which there must be one, and returns its source.
uint32_t events_pop(events_t *self);

#endif
