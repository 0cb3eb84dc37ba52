#include "parts.h"

#include "../core/checks.h"

#include <string.h>

/// Bytes of the buffer from `offset` on, which is in the metadata or behind it.
static void copy(const uint8_t metadata[148], bytes_t pixels, size_t offset, uint8_t *out, size_t size) {
    if (offset < NANOCOCKPIT_METADATA_BYTES) {
        const size_t first = NANOCOCKPIT_METADATA_BYTES - offset;
        const size_t head = first < size ? first : size;
        memcpy(out, metadata + offset, head);
        out += head;
        size -= head;
        offset += head;
    }
    memcpy(out, pixels.data + (offset - NANOCOCKPIT_METADATA_BYTES), size);
}

size_t gap8_buffers_packet(gap8_t *self, const gap8_slot_t *slot, bool begin, bytes_mut_t out) {
    const cpx_route_t route = {
        .destination = CPX_HOST, .source = CPX_GAP8, .function = CPX_STREAMER, .last_packet = true};
    const uint32_t whole = NANOCOCKPIT_METADATA_BYTES + slot->header.body_bytes;
    uint8_t metadata[NANOCOCKPIT_METADATA_BYTES];
    nanocockpit_metadata_encode(&slot->metadata, metadata);
    uint8_t *data = out.data + CPX_LINK_HEADER_BYTES;
    size_t head = NANOCOCKPIT_MORE_BYTES;
    if (begin) {
        nanocockpit_begin_t start = {NANOCOCKPIT_IMAGE, whole, 0};
        if (self->config.nanocockpit_check) {
            const bytes_t before = {metadata, sizeof metadata};
            start.check = nanocockpit_check(crc32_zlib(0, before), slot->body);
        }
        nanocockpit_begin_encode(&start, data);
        head = NANOCOCKPIT_BEGIN_BYTES;
    } else {
        nanocockpit_more_encode(data);
    }
    const size_t left = whole - self->send_offset;
    const size_t room = NANOCOCKPIT_DATA_MAX - head;
    const size_t size = left < room ? left : room;
    const size_t padded = (size + NANOCOCKPIT_PADDING_MAX) / 4 * 4;
    copy(metadata, slot->body, self->send_offset, data + head, size);
    memset(data + head + size, 0, padded - size);
    nanocockpit_link_header(&route, head + padded, out.data);
    self->send_offset += (uint32_t)size;
    return CPX_LINK_HEADER_BYTES + head + padded;
}

bool gap8_buffers_receive(gap8_t *self, const cpx_packet_t *packet, uint64_t stamp_us) {
    nanocockpit_begin_t begin;
    nanocockpit_reply_t reply;
    const int head = nanocockpit_begin_decode(packet->data, &begin);
    if (!cpx_route_ok(&packet->route) || packet->route.destination != CPX_GAP8 ||
        packet->route.function != CPX_STREAMER || head < 0) {
        return false;
    }
    const bytes_t buffer = {packet->data.data + head, packet->data.size - (size_t)head};
    const bool whole = begin.size == buffer.size && nanocockpit_reply_decode(buffer, &reply) > 0;
    if (!whole || (begin.check != 0 && begin.check != nanocockpit_check(0, buffer))) {
        return false;
    }
    self->reply_last = reply;
    self->reply_gap8_us = (uint32_t)stamp_us;
    return true;
}
