#include "parts.h"

#include "../core/checks.h"

#include <string.h>

enum {
    JPEG_MARKER = 0xFF,
    JPEG_SOI = 0xD8,
    JPEG_SOS = 0xDA,
    JPEG_EOI = 0xD9,
    JPEG_FOOTER_BYTES = 2,
    JPEG_SEGMENTS_MAX = 64, ///< before the picture's data; a file with more is sent in one part
};

/// Bytes up to the end of the SOS segment, or 0 if the file does not begin as a JPEG does.
static size_t jpeg_file_header_bytes(bytes_t body) {
    if (body.size < 2 || body.data[0] != JPEG_MARKER || body.data[1] != JPEG_SOI) {
        return 0;
    }
    size_t at = 2;
    for (int i = 0; i < JPEG_SEGMENTS_MAX && at + 4 <= body.size && body.data[at] == JPEG_MARKER; i++) {
        const size_t end = at + 2 + ((size_t)body.data[at + 2] << 8 | body.data[at + 3]);
        if (body.data[at + 1] == JPEG_SOS) {
            return end <= body.size ? end : 0;
        }
        at = end;
    }
    return 0;
}

/// Where the part of a stock frame ends that begins at `offset`: a JPEG goes as file header, data and footer.
static size_t part_end(const gap8_slot_t *slot, size_t offset) {
    const bytes_t body = slot->body;
    if (slot->header.encoding == IMAGE_RAW) {
        return body.size;
    }
    const size_t data_start = jpeg_file_header_bytes(body);
    if (offset < data_start) {
        return data_start;
    }
    const size_t data_end = body.size - (body.size < JPEG_FOOTER_BYTES ? body.size : JPEG_FOOTER_BYTES);
    const uint8_t *footer = body.data + data_end;
    const bool has_footer = data_start > 0 && footer[0] == JPEG_MARKER && footer[1] == JPEG_EOI;
    return has_footer && offset < data_end ? data_end : body.size;
}

static void begin(gap8_t *self) {
    self->sending = (int8_t)self->order[0];
    self->order_fill--;
    memmove(self->order, self->order + 1, self->order_fill);
    gap8_slot_t *slot = &self->slots[self->sending];
    slot->state = SLOT_SENDING;
    self->send_native = self->stream.dialect != 0;
    self->send_data_max = self->stream.data_max == 0 ? CPX_DATA_MAX : self->stream.data_max;
    self->send_pairs_left = self->pairs_fill;
    self->send_header_done = false;
    self->send_offset = 0;
    self->send_part_end = 0;
    if (self->config.firmware == GAP8_NANOCOCKPIT) {
        slot->metadata.state = self->state_last;
        slot->metadata.state_gap8_us = (uint32_t)self->stamp_last_gap8_us;
        slot->metadata.reply_frame_gap8_us = self->reply_last.frame_gap8_us;
        slot->metadata.reply_gap8_us = self->reply_gap8_us;
    }
    if (!self->send_native) {
        return;
    }
    native_frame_t *header = &slot->header;
    header->body_crc32 = crc32_zlib(0, slot->body);
    header->stamps_received = self->stamp_rx.received;
    header->stamps_missed = self->stamps_missed;
    header->stamps_bad = self->stamp_rx.bad_check + self->stamp_rx.garbage_bytes;
    header->pairs_lost = self->pairs_lost;
    header->captures_failed = self->captures_failed;
    header->captures_late = self->captures_late;
    header->frames_unsent = self->frames_unsent;
    header->spi_errors = self->spi_errors;
    header->packets_dropped = self->packets_dropped;
}

static void end(gap8_t *self, uint32_t *counter) {
    self->slots[self->sending].state = SLOT_FREE;
    self->sending = -1;
    (*counter)++;
}

/// Stock's, or the paper's.
static size_t stock_header(const gap8_t *self, const gap8_slot_t *slot, uint8_t *data) {
    if (self->config.firmware == GAP8_PAPER) {
        paper_header_encode(&slot->paper, data);
        return PAPER_HEADER_BYTES;
    }
    const native_frame_t *header = &slot->header;
    const image_stock_t stock = {header->width, header->height, header->depth, header->encoding,
                                 header->body_bytes};
    image_stock_encode(&stock, data);
    return IMAGE_STOCK_BYTES;
}

static size_t stock_body(gap8_t *self, const gap8_slot_t *slot, uint8_t *data) {
    if (self->send_offset == self->send_part_end) {
        self->send_part_end = (uint32_t)part_end(slot, self->send_offset);
    }
    const uint32_t left = self->send_part_end - self->send_offset;
    const uint32_t piece = left < CPX_DATA_MAX ? left : CPX_DATA_MAX;
    memcpy(data, slot->body.data + self->send_offset, piece);
    self->send_offset += piece;
    return piece;
}

static size_t native_pairs(gap8_t *self, uint8_t *data) {
    native_pair_t pairs[NATIVE_PAIRS_MAX];
    const size_t around = NATIVE_PAIRS_HEAD_BYTES + NATIVE_CHECK_BYTES;
    const size_t fits = ((size_t)self->send_data_max - around) / NATIVE_PAIR_BYTES;
    size_t count = self->send_pairs_left;
    count = count < fits ? count : fits;
    count = count < NATIVE_PAIRS_MAX ? count : NATIVE_PAIRS_MAX;
    for (size_t i = 0; i < count; i++) {
        pairs[i] = self->pairs[(self->pairs_head + i) % GAP8_PAIRS_MAX];
    }
    self->pairs_head = (uint16_t)((self->pairs_head + count) % GAP8_PAIRS_MAX);
    self->pairs_fill = (uint16_t)(self->pairs_fill - count);
    self->send_pairs_left = (uint16_t)(self->send_pairs_left - count);
    return native_pairs_encode(pairs, count, self->pairs_lost, (bytes_mut_t){data, self->send_data_max});
}

static size_t native_body(gap8_t *self, const gap8_slot_t *slot, uint8_t *data) {
    const uint32_t left = slot->header.body_bytes - self->send_offset;
    const uint32_t most = (uint32_t)self->send_data_max - NATIVE_DATA_HEAD_BYTES;
    const uint32_t piece = left < most ? left : most;
    native_data_encode_head(slot->header.frame, self->send_offset, data);
    memcpy(data + NATIVE_DATA_HEAD_BYTES, slot->body.data + self->send_offset, piece);
    self->send_offset += piece;
    return NATIVE_DATA_HEAD_BYTES + piece;
}

static bool holds_back(const gap8_t *self) {
    const bool in_burst = self->burst_left > 0 || self->capturing >= 0;
    return self->order_fill == 0 || (gap8_takes_turns(self) && in_burst);
}

/// The next packet of function APP.
static size_t app_packet(gap8_t *self, const gap8_slot_t *slot, bool first, bytes_mut_t out) {
    cpx_route_t route = {
        .destination = CPX_HOST, .source = CPX_GAP8, .function = CPX_APP, .last_packet = true};
    uint8_t *data = out.data + CPX_LINK_HEADER_BYTES;
    size_t size;
    if (first && self->send_native) {
        native_frame_encode(&slot->header, data);
        size = NATIVE_FRAME_BYTES;
    } else if (first) {
        size = stock_header(self, slot, data);
        route.reserved = self->config.firmware == GAP8_NATIVE;
    } else if (!self->send_native) {
        size = stock_body(self, slot, data);
    } else if (self->send_pairs_left > 0) {
        size = native_pairs(self, data);
    } else {
        size = native_body(self, slot, data);
    }
    cpx_link_header(&route, size, out.data);
    return CPX_LINK_HEADER_BYTES + size;
}

size_t gap8_frames_packet(gap8_t *self, bytes_mut_t out) {
    if (self->sending < 0) {
        if (holds_back(self)) {
            return 0;
        }
        begin(self);
    }
    const gap8_slot_t *slot = &self->slots[self->sending];
    const bool first = !self->send_header_done;
    const bool nanocockpit = self->config.firmware == GAP8_NANOCOCKPIT;
    self->send_header_done = true;
    const size_t size =
        nanocockpit ? gap8_buffers_packet(self, slot, first, out) : app_packet(self, slot, first, out);
    const uint32_t before = nanocockpit ? NANOCOCKPIT_METADATA_BYTES : 0;
    if (self->send_offset == before + slot->header.body_bytes) {
        end(self, &self->frames_sent);
    }
    return size;
}

void gap8_frames_drop(gap8_t *self) {
    if (self->sending >= 0) {
        end(self, &self->frames_unsent);
    }
    for (; self->order_fill > 0; self->order_fill--) {
        self->slots[self->order[self->order_fill - 1]].state = SLOT_FREE;
        self->frames_unsent++;
    }
}
