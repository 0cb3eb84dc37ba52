#include "world.h"

#include <stdlib.h>

static wire_t wire_of(int direction) {
    return direction == TO_HOST ? WIRE_TCP_TO_HOST : WIRE_TCP_TO_ESP32;
}

bool tcp_init(robot_t *r) {
    for (int direction = 0; direction < 2; direction++) {
        tcp_pipe_t *pipe = &r->pipes[direction];
        pipe->capacity = direction == TO_ESP32
                             ? (uint32_t)TCP_TO_ESP32_SEGMENTS
                             : r->config.tcp_window_bytes / TCP_SEGMENT_BYTES + TCP_SPARE_SEGMENTS;
        pipe->segments = calloc(pipe->capacity, sizeof *pipe->segments);
        if (pipe->segments == NULL) {
            return false;
        }
        r->memory += pipe->capacity * sizeof *pipe->segments;
    }
    return true;
}

static segment_t *segment_at(tcp_pipe_t *pipe, uint32_t place) {
    uint32_t at = pipe->head + place;
    return &pipe->segments[at < pipe->capacity ? at : at - pipe->capacity];
}

// A sliver of a window is not worth a segment: the sender waits for room for a whole one (RFC 1122, 4.2.3.4).
static bool window_open(const robot_t *r) {
    size_t under_way = r->pipes[TO_HOST].under_way;
    return under_way + TCP_SEGMENT_BYTES <= r->config.tcp_window_bytes &&
           under_way + TCP_SEGMENT_BYTES <= ring_room(&r->host_in);
}

static size_t take(robot_t *r, int direction, segment_t *segment) {
    if (direction == TO_ESP32) {
        return ring_read(&r->host_out, segment->bytes, TCP_SEGMENT_BYTES);
    }
    bytes_mut_t out = {segment->bytes, TCP_SEGMENT_BYTES};
    return window_open(r) ? node_transmit(r, MCU_ESP32, ESP32_PORT_TCP, out) : 0;
}

void tcp_poll(robot_t *r, int direction) {
    tcp_pipe_t *pipe = &r->pipes[direction];
    if (!r->connected || pipe->on_link || pipe->fill == pipe->capacity) {
        return;
    }
    wire_t wire = wire_of(direction);
    carrier_t *carrier = &r->carriers[wire];
    int64_t free_ns = carrier_free_ns(carrier, r->now_ns);
    if (free_ns > r->now_ns) {
        robot_at(r, (uint32_t)(SOURCE_TCP_LINK + direction), free_ns);
        return;
    }
    segment_t *segment = segment_at(pipe, pipe->fill);
    size_t size = take(r, direction, segment);
    if (size == 0) {
        return;
    }
    segment->size = (uint16_t)size;
    segment->taken = 0;
    segment->arrival_ns = INT64_MAX;
    pipe->fill++;
    pipe->under_way += (uint32_t)size;
    pipe->on_link = true;
    carrier->counts.units++;
    carrier->counts.bytes += size;
    robot_at(r, (uint32_t)(SOURCE_TCP_LINK + direction),
             r->now_ns + wire_time_ns(size, r->config.tcp_byte_ps));
    if (r->trace->mode != TRACE_OFF) {
        int64_t local_ns = direction == TO_HOST ? node_local_ns(r, &r->nodes[MCU_ESP32]) : r->now_ns;
        trace_begin(&r->traces[wire], &(trace_run_t){.local_start_ns = local_ns,
                                                     .true_start_ns = r->now_ns,
                                                     .byte_ps = r->config.tcp_byte_ps,
                                                     .robot = (int16_t)r->index,
                                                     .wire = (uint8_t)wire});
        trace_bytes(r->trace, &r->traces[wire], (bytes_t){segment->bytes, size});
        trace_end(r->trace, &r->traces[wire]);
    }
}

static int64_t arrival_ns(robot_t *r, int direction) {
    carrier_t *carrier = &r->carriers[wire_of(direction)];
    if (!carrier->faulty) {
        return r->now_ns;
    }
    int64_t sent_ns = r->now_ns;
    for (int tries = 1; tries < TCP_TRIES_MAX && carrier_loses(carrier, sent_ns); tries++) {
        sent_ns += r->config.tcp_rto_ns;
    }
    return sent_ns + carrier_delay_ns(carrier);
}

static void pop(tcp_pipe_t *pipe) {
    pipe->under_way -= segment_at(pipe, 0)->size;
    pipe->fill--;
    pipe->head =
        pipe->fill != 0 && pipe->head + 1 < pipe->capacity ? pipe->head + 1 : 0; // 0 stays in the cache
}

static bool arrived(const robot_t *r, tcp_pipe_t *pipe) {
    return pipe->fill != 0 && segment_at(pipe, 0)->arrival_ns <= r->now_ns;
}

static void await_head(robot_t *r, int direction) {
    tcp_pipe_t *pipe = &r->pipes[direction];
    if (pipe->fill != 0 && segment_at(pipe, 0)->arrival_ns != INT64_MAX) {
        robot_at(r, (uint32_t)(SOURCE_TCP_HEAD + direction), segment_at(pipe, 0)->arrival_ns);
    }
}

void tcp_offer(robot_t *r) {
    tcp_pipe_t *pipe = &r->pipes[TO_ESP32];
    while (arrived(r, pipe)) {
        segment_t *segment = segment_at(pipe, 0);
        bytes_t rest = {segment->bytes + segment->taken, (size_t)(segment->size - segment->taken)};
        int taken = rest.size == 0 ? 0 : node_receive(r, MCU_ESP32, ESP32_PORT_TCP, rest);
        segment->taken = (uint16_t)(segment->taken + (taken > 0 ? taken : 0));
        if (segment->taken < segment->size) {
            return;
        }
        pop(pipe);
        tcp_poll(r, TO_ESP32);
        if (!arrived(r, pipe)) {
            await_head(r, TO_ESP32);
        }
    }
}

void tcp_head_due(robot_t *r, int direction) {
    if (direction == TO_HOST) {
        tcp_pipe_t *pipe = &r->pipes[TO_HOST];
        while (arrived(r, pipe)) {
            segment_t *segment = segment_at(pipe, 0);
            ring_write(&r->host_in, segment->bytes, segment->size); // fits: window_open kept the room
            pop(pipe);
        }
        await_head(r, TO_HOST);
    }
    node_poll(r, MCU_ESP32); // offers to the ESP32 what came for it, or uses the window that has opened
}

void tcp_link_due(robot_t *r, int direction) {
    tcp_pipe_t *pipe = &r->pipes[direction];
    if (pipe->on_link) {
        pipe->on_link = false;
        segment_t *segment = segment_at(pipe, pipe->fill - 1);
        int64_t arrives_ns = arrival_ns(r, direction);
        pipe->last_ns = arrives_ns > pipe->last_ns ? arrives_ns : pipe->last_ns;
        segment->arrival_ns = pipe->last_ns;
        size_t left = carrier_damage(&r->carriers[wire_of(direction)], segment->bytes, segment->size);
        pipe->under_way -= (uint32_t)(segment->size - left);
        segment->size = (uint16_t)left;
        if (pipe->fill == 1) {
            await_head(r, direction);
        }
    }
    if (arrived(r, pipe)) {
        robot_not(r, (uint32_t)(SOURCE_TCP_HEAD + direction));
        tcp_head_due(r, direction);
    } else if (direction == TO_HOST) {
        node_poll(r, MCU_ESP32);
    }
    if (direction == TO_ESP32) {
        tcp_poll(r, TO_ESP32);
    }
}

void tcp_cut(robot_t *r) {
    for (int direction = 0; direction < 2; direction++) {
        tcp_pipe_t *pipe = &r->pipes[direction];
        pipe->head = pipe->fill = pipe->under_way = 0;
        pipe->on_link = false;
        pipe->last_ns = 0;
        robot_not(r, (uint32_t)(SOURCE_TCP_LINK + direction));
        robot_not(r, (uint32_t)(SOURCE_TCP_HEAD + direction));
    }
    r->host_out.head = r->host_out.fill = 0;
}
