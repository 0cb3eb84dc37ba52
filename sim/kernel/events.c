#include "events.h"

#include <stdlib.h>

bool events_grow(events_t *self, uint32_t sources) {
    event_t *heap = realloc(self->heap, sources * sizeof *heap);
    if (heap == NULL) {
        return false;
    }
    self->heap = heap;
    uint32_t *place = realloc(self->place, sources * sizeof *place);
    if (place == NULL) {
        return false;
    }
    self->place = place;
    for (; self->sources < sources; self->sources++) {
        place[self->sources] = 0;
    }
    return true;
}

void events_free(events_t *self) {
    free(self->heap);
    free(self->place);
}

static bool earlier(const event_t *a, const event_t *b) {
    return a->time_ns < b->time_ns || (a->time_ns == b->time_ns && a->sequence < b->sequence);
}

static void put(events_t *self, uint32_t at, const event_t *event) {
    self->heap[at] = *event;
    self->place[event->source] = at + 1;
}

// Places `event` where there is a hole at `at`.
static void settle(events_t *self, uint32_t at, event_t event) {
    while (at > 0 && earlier(&event, &self->heap[(at - 1) / 2])) {
        put(self, at, &self->heap[(at - 1) / 2]);
        at = (at - 1) / 2;
    }
    for (;;) {
        uint32_t child = 2 * at + 1;
        if (child + 1 < self->fill && earlier(&self->heap[child + 1], &self->heap[child])) {
            child++;
        }
        if (child >= self->fill || !earlier(&self->heap[child], &event)) {
            break;
        }
        put(self, at, &self->heap[child]);
        at = child;
    }
    put(self, at, &event);
}

void events_set(events_t *self, uint32_t source, int64_t time_ns) {
    uint32_t place = self->place[source];
    uint32_t at = place != 0 ? place - 1 : self->fill++;
    settle(self, at, (event_t){.time_ns = time_ns, .sequence = self->sequence++, .source = source});
}

void events_clear(events_t *self, uint32_t source) {
    uint32_t place = self->place[source];
    if (place == 0) {
        return;
    }
    self->place[source] = 0;
    self->fill--;
    if (place - 1 < self->fill) {
        settle(self, place - 1, self->heap[self->fill]);
    }
}

uint32_t events_pop(events_t *self) {
    uint32_t source = self->heap[0].source;
    events_clear(self, source);
    return source;
}
