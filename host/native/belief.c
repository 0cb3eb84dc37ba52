#include "belief.h"

#include "frames.h"

enum {
    LENGTH_BYTES = 2,
    HEADER_BYTES = CPX_LINK_HEADER_BYTES,
    CHAIN = 3,
    NATIVE_START_BYTES = 6,
    BUFFER_START_BYTES = HEADER_BYTES + NANOCOCKPIT_BEGIN_BYTES + NANOCOCKPIT_METADATA_BYTES,
};

size_t belief_packet_bytes(uint8_t rule, const uint8_t *header) {
    return (rule == STREAM_CPX ? LENGTH_BYTES : HEADER_BYTES) + (size_t)load16_le(header);
}

static bool addressed(uint8_t target) {
    return target >= CPX_STM32 && target <= CPX_GAP8;
}

bool belief_plausible(uint8_t rule, const uint8_t *header, cpx_route_t *route) {
    const uint16_t length = load16_le(header);
    const bool fits = rule == STREAM_CPX ? length >= CPX_ROUTE_BYTES && length <= CPX_MTU
                                         : length >= 1 && length <= NANOCOCKPIT_DATA_MAX;
    cpx_route_decode(header + LENGTH_BYTES, route);
    return fits && addressed(route->source) && addressed(route->destination);
}

static bool known_function(uint8_t rule, uint8_t function) {
    return (function >= CPX_SYSTEM && function <= CPX_APP) || function == CPX_TEST ||
           function == CPX_BOOTLOADER || (rule == STREAM_NANOCOCKPIT && function == CPX_STREAMER);
}

bool belief_usual(uint8_t rule, const cpx_route_t *route) {
    return route->version == CPX_VERSION && known_function(rule, route->function);
}

static bool from_camera(const cpx_route_t *route) {
    return route->source == CPX_GAP8 && route->function == CPX_APP;
}

/// Is this packet so particular that it needs no others behind it?
static bool unmistakable(const uint8_t *in, size_t size, const cpx_route_t *route) {
    image_stock_t stock;
    paper_header_t paper;
    const bytes_t data = {in + HEADER_BYTES, belief_packet_bytes(STREAM_CPX, in) - HEADER_BYTES};
    if (!from_camera(route) || size < NATIVE_START_BYTES || data.size < 2) {
        return false;
    }
    if (data.data[0] == NATIVE_MAGIC) {
        return data.data[1] >= NATIVE_FRAME && data.data[1] <= NATIVE_REPLY;
    }
    return size >= HEADER_BYTES + data.size &&
           (image_stock_decode(data, &stock) > 0 || paper_header_decode(data, &paper) > 0);
}

belief_t belief_cpx_starts(const uint8_t *in, size_t size) {
    size_t at = 0;
    for (int i = 0; i < CHAIN; i++) {
        cpx_route_t route;
        if (size < at + HEADER_BYTES) {
            return BELIEF_UNKNOWN;
        }
        if (!belief_plausible(STREAM_CPX, in + at, &route) || !belief_usual(STREAM_CPX, &route)) {
            return BELIEF_NO;
        }
        if (i == 0 && unmistakable(in, size, &route)) {
            return BELIEF_YES;
        }
        at += belief_packet_bytes(STREAM_CPX, in + at);
    }
    return BELIEF_YES;
}

belief_t belief_buffer_starts(const uint8_t *in, size_t size) {
    static const uint8_t start[] = {NANOCOCKPIT_BEGIN, NANOCOCKPIT_IMAGE};
    nanocockpit_begin_t begin;
    nanocockpit_metadata_t metadata;
    cpx_route_t route;
    if (size < HEADER_BYTES) {
        return BELIEF_UNKNOWN;
    }
    const size_t packet = belief_packet_bytes(STREAM_NANOCOCKPIT, in);
    if (!belief_plausible(STREAM_NANOCOCKPIT, in, &route) || !belief_usual(STREAM_NANOCOCKPIT, &route) ||
        !frames_is_buffer(&route) || packet < BUFFER_START_BYTES) {
        return BELIEF_NO;
    }
    for (size_t i = 0; i < sizeof start && HEADER_BYTES + i < size; i++) {
        if (in[HEADER_BYTES + i] != start[i]) {
            return BELIEF_NO;
        }
    }
    if (size < BUFFER_START_BYTES) {
        return BELIEF_UNKNOWN;
    }
    const bytes_t data = {in + HEADER_BYTES, BUFFER_START_BYTES - HEADER_BYTES};
    return frames_buffer_image(data, &begin, &metadata) ? BELIEF_YES : BELIEF_NO;
}
