#include "stream.h"

#include "belief.h"
#include "frames.h"

#include <string.h>

enum { HEADER_BYTES = CPX_LINK_HEADER_BYTES };

typedef enum { GO, MORE, STOP } step_t;

void stream_init(stream_t *self, uint8_t framing) {
    memset(self, 0, sizeof *self);
    self->framing = framing;
    cpx_uart_init(&self->uart, 0);
    uart1_rx_init(&self->stamps, UART1_ALL);
    self->rule = STREAM_CPX;
}

void stream_set_rule(stream_t *self, uint8_t rule) {
    self->rule = rule;
    self->rule_set = true;
}

stream_event_t *stream_event(stream_t *self, uint8_t kind) {
    stream_event_t *event = &self->events[self->event_count++];
    *event = (stream_event_t){.kind = kind};
    return event;
}

static void begin_call(stream_t *self) {
    self->event_count = 0;
    self->data_fill = 0;
}

/// False when the caller must act before another packet is looked at.
static bool may_go_on(stream_t *self) {
    if (self->in_frame && self->body == NULL) {
        if (self->event_count < STREAM_EVENTS) {
            stream_event(self, STREAM_BODY_NEEDED)->size = self->open.size;
        }
        return false;
    }
    return self->event_count + STREAM_EVENTS_PER_PACKET < STREAM_EVENTS &&
           self->data_fill + NANOCOCKPIT_DATA_MAX <= STREAM_DATA_BYTES;
}

/// Does a stream start here, by a rule that is allowed? Then the rule is the one that it follows.
static belief_t starts(stream_t *self, const uint8_t *in, size_t size, bool ended) {
    if (self->rule == STREAM_NANOCOCKPIT || !self->rule_set) {
        const belief_t verdict = belief_buffer_starts(in, size);
        if (verdict == BELIEF_YES) {
            self->rule = STREAM_NANOCOCKPIT;
        }
        if (verdict == BELIEF_YES || (verdict == BELIEF_UNKNOWN && !ended)) {
            return verdict;
        }
    }
    if (self->rule == STREAM_NANOCOCKPIT && self->rule_set) {
        return BELIEF_NO;
    }
    const belief_t verdict = belief_cpx_starts(in, size);
    if (verdict == BELIEF_YES) {
        self->rule = STREAM_CPX;
    }
    return verdict;
}

static void report_garbage(stream_t *self, uint64_t from, uint64_t to) {
    if (from == to) {
        return;
    }
    stream_event_t *event = stream_event(self, STREAM_GARBAGE);
    event->offset = from;
    event->size = (uint32_t)(to - from);
    self->garbage_bytes += event->size;
}

static void begin_hunt(stream_t *self, uint8_t cause) {
    self->hunting = true;
    self->doubtful = false;
    self->hunt_from = self->base + self->last;
    self->garbage_from = self->base + self->at;
    self->at = self->last + 1;
    self->last = self->at;
    if (self->in_frame && self->open.dialect != DIALECT_NATIVE) {
        frames_lose(self, cause);
    }
}

static step_t hunt(stream_t *self, bytes_t in, bool ended) {
    while (self->at < in.size) {
        const belief_t verdict = starts(self, in.data + self->at, in.size - self->at, ended);
        if (verdict == BELIEF_UNKNOWN && !ended) {
            return MORE;
        }
        const uint64_t here = self->base + self->at;
        if (verdict == BELIEF_YES) {
            // Inside the packet before: then it was that one which was wrong.
            report_garbage(self, here < self->garbage_from ? self->hunt_from : self->garbage_from, here);
            self->hunting = false;
            return GO;
        }
        self->at++;
        self->last = self->at;
        if (here + 1 >= self->garbage_from + STREAM_GARBAGE_MAX) {
            report_garbage(self, self->garbage_from, here + 1);
            self->garbage_from = here + 1;
            return GO;
        }
    }
    return MORE;
}

/// Before the rule is set, a packet of NanoCockpit's may stand where one of CPX is due.
static belief_t changes_rule(const stream_t *self, const uint8_t *here, size_t left) {
    return self->rule == STREAM_CPX && !self->rule_set && !self->begin_waits
               ? belief_buffer_starts(here, left)
               : BELIEF_NO;
}

/// Judges what lies at self->at.
static step_t step_tcp(stream_t *self, bytes_t in, bool ended) {
    if (!may_go_on(self)) {
        return STOP;
    }
    if (self->hunting) {
        return hunt(self, in, ended);
    }
    const uint8_t *here = in.data + self->at;
    const size_t left = in.size - self->at;
    cpx_route_t route;
    cpx_route_t behind;
    if (left == 0 || (left < HEADER_BYTES && !ended)) {
        return MORE;
    }
    if (left < HEADER_BYTES) {
        begin_hunt(self, LOST_DISCONNECTED);
        return GO;
    }
    const belief_t changes = changes_rule(self, here, left);
    if (changes == BELIEF_UNKNOWN && !ended) {
        return MORE;
    }
    if (changes == BELIEF_YES) {
        self->rule = STREAM_NANOCOCKPIT;
    }
    const bool believed = belief_plausible(self->rule, here, &route);
    const bool is_usual = belief_usual(self->rule, &route);
    const size_t size = belief_packet_bytes(self->rule, here);
    if (believed && !ended && left < size + (is_usual ? 0 : HEADER_BYTES)) {
        return MORE;
    }
    if (!believed || left < size ||
        (!is_usual && left >= size + HEADER_BYTES && !belief_plausible(self->rule, here + size, &behind))) {
        begin_hunt(self, ended && believed ? LOST_DISCONNECTED : LOST_GARBAGE);
        return GO;
    }
    const cpx_packet_t packet = {route, {here + HEADER_BYTES, size - HEADER_BYTES}};
    if (is_usual && !frames_packet(self, &packet, self->base + self->at)) {
        return GO;
    }
    self->last = self->at;
    self->at += size;
    if (self->doubtful) {
        begin_hunt(self, LOST_GARBAGE);
    } else if (route.version != CPX_VERSION) {
        self->bad_version++;
    } else if (!is_usual) {
        self->unknown_function++;
    }
    return GO;
}

/// Appends to the window what fits of `in`.
static void fill_window(stream_t *self, bytes_t in) {
    const size_t room = STREAM_WINDOW_BYTES - self->window_fill;
    const size_t taken = in.size < room ? in.size : room;
    if (taken > 0) {
        memcpy(self->window + self->window_fill, in.data, taken);
        self->window_fill += taken;
    }
}

/// Everything before `last` is done with. The rest of `in`, which is short, waits in the window.
static void keep_rest(stream_t *self, bytes_t in) {
    self->window_fill = in.size - self->last;
    memmove(self->window, in.data + self->last, self->window_fill);
    self->base += self->last;
    self->at -= self->last;
    self->last = 0;
    self->window_old = self->window_fill;
}

static bool push_tcp(stream_t *self, bytes_t in) {
    if (!self->resuming) {
        self->in_window = self->window_fill > 0;
        if (self->in_window) {
            fill_window(self, in);
        }
    }
    for (;;) {
        if (self->in_window && self->last >= self->window_old) {
            // All that still matters is in the caller's bytes too.
            self->in_window = false;
            self->last -= self->window_old;
            self->at -= self->window_old;
            self->base += self->window_old;
        }
        const bytes_t view = self->in_window ? (bytes_t){self->window, self->window_fill} : in;
        const step_t step = step_tcp(self, view, false);
        if (step == STOP) {
            return true;
        }
        if (step == MORE) {
            keep_rest(self, view);
            return false;
        }
    }
}

/// `total` counts the garbage that ended at `end`. On a noisy line it is reported in lumps.
static void report_line_garbage(stream_t *self, uint32_t total, uint64_t end, bool now) {
    const uint32_t bytes = total - self->line_garbage;
    if (bytes > 0 && (now || bytes >= STREAM_GARBAGE_MAX)) {
        self->line_garbage = total;
        report_garbage(self, end - bytes, end);
    }
}

static bool push_uart(stream_t *self, bytes_t in, uint64_t now_us) {
    for (; self->at < in.size; self->at++) {
        if (!may_go_on(self)) {
            return true;
        }
        cpx_packet_t packet;
        const bool found = cpx_uart_receive(&self->uart, in.data[self->at], now_us, &packet);
        const uint64_t start = self->base + self->at + 1 - self->uart.rx_fill;
        report_line_garbage(self, self->uart.garbage_bytes, start, found);
        if (found) {
            frames_piece(self, &packet, start);
            cpx_uart_accept(&self->uart);
        }
    }
    self->base += in.size;
    self->at = 0;
    return false;
}

/// The next message in what has been put in. False: none.
static bool hear(stream_t *self) {
    uart1_message_t message = {0};
    const bool found = uart1_rx_take(&self->stamps, &message);
    const uint64_t start = self->base + self->at - self->stamps.fill - (found ? message.size : 0);
    report_line_garbage(self, self->stamps.garbage_bytes, start, found);
    const bool state = message.kind != UART1_NANOCOCKPIT || message.size == NANOCOCKPIT_STATE_BYTES;
    if (found && state && message.kind != UART1_ECHO) {
        stream_event(self, STREAM_STAMP)->message = message;
    }
    return found;
}

static bool push_stamps(stream_t *self, bytes_t in) {
    for (;;) {
        if (!may_go_on(self)) {
            return true;
        }
        if (hear(self)) {
            continue;
        }
        if (self->at == in.size) {
            break;
        }
        uart1_rx_put(&self->stamps, in.data[self->at++]);
    }
    self->base += in.size;
    self->at = 0;
    return false;
}

bool stream_push(stream_t *self, const uint8_t *in, size_t size, uint64_t now_us) {
    const bytes_t bytes = {in, size};
    begin_call(self);
    if (size == 0) {
        return false;
    }
    if (!self->resuming) {
        self->bytes += size;
    }
    self->resuming = self->framing == STREAM_TCP        ? push_tcp(self, bytes)
                     : self->framing == STREAM_CPX_UART ? push_uart(self, bytes, now_us)
                                                        : push_stamps(self, bytes);
    return self->resuming;
}

bool stream_finish(stream_t *self) {
    const bytes_t left = {self->window, self->window_fill};
    begin_call(self);
    step_t step = GO;
    while (step == GO) {
        step = step_tcp(self, left, true);
    }
    if (step == STOP) {
        return true;
    }
    const uint64_t end = self->base + left.size;
    const uint64_t from = self->hunting ? self->garbage_from : self->base + self->at;
    report_garbage(self, from, end);
    if (self->framing == STREAM_CPX_UART) {
        const uint32_t waiting = (uint32_t)(self->uart.rx_fill - self->uart.rx_taken);
        report_line_garbage(self, self->uart.garbage_bytes + waiting, end, true);
    } else if (self->framing == STREAM_STAMPS) {
        report_line_garbage(self, self->stamps.garbage_bytes + self->stamps.fill, end, true);
    }
    frames_lose(self, LOST_DISCONNECTED);
    self->window_fill = 0;
    return false;
}

size_t stream_transmit(stream_t *self, uint8_t *out, size_t size, uint64_t now_us) {
    size_t fill = 0;
    while (fill < size && cpx_uart_transmit(&self->uart, out + fill, now_us) > 0) {
        fill++;
    }
    return fill;
}
