#include "frames.h"

#include "../../firmware/core/checks.h"
#include "../../firmware/core/native_log.h"

#include <string.h>

/// Pieces of it say where they belong.
static bool is_native_frame(const stream_t *self) {
    return self->open.dialect == DIALECT_NATIVE;
}

static void open_frame(stream_t *self, const stream_frame_t *frame) {
    frames_lose(self, is_native_frame(self) ? LOST_MISSING_DATA : LOST_CUT_SHORT);
    self->open = *frame;
    self->body = NULL;
    self->place = 0;
    self->in_frame = true;
    self->has_hole = false;
    self->strays = false;
    self->has_stray_frame = false;
}

static void close_frame(stream_t *self) {
    self->open.headless = self->headless_frames;
    self->closed = self->open;
    self->body = NULL;
    self->in_frame = false;
}

static void finish_frame(stream_t *self) {
    close_frame(self);
    stream_event(self, STREAM_FRAME);
}

void frames_lose(stream_t *self, uint8_t cause) {
    if (!self->in_frame) {
        return;
    }
    if (self->body != NULL) {
        memset(self->body + self->place, 0, self->open.size - self->place);
    }
    self->strays = !is_native_frame(self);
    close_frame(self);
    stream_event(self, STREAM_LOST)->cause = cause;
}

static void report_data(stream_t *self, uint8_t kind, const cpx_packet_t *packet, uint64_t offset) {
    stream_event_t *event = stream_event(self, kind);
    event->route = packet->route;
    event->offset = offset;
    event->size = (uint32_t)packet->data.size;
    event->data_at = self->data_fill;
    if (packet->data.size > 0) {
        memcpy(self->data + self->data_fill, packet->data.data, packet->data.size);
        self->data_fill += event->size;
    }
}

static stream_frame_t stock_frame(const image_stock_t *header) {
    return (stream_frame_t){
        .dialect = DIALECT_STOCK,
        .width = header->width,
        .height = header->height,
        .depth = header->depth,
        .type = header->type,
        .size = header->size,
    };
}

static void stock_header(stream_t *self, const image_stock_t *header, bool announces) {
    const stream_frame_t frame = stock_frame(header);
    open_frame(self, &frame);
    if (announces && !self->announced) {
        stream_event(self, STREAM_ANNOUNCED);
    }
    self->announced = announces;
}

static void paper_header(stream_t *self, const paper_header_t *header) {
    stream_frame_t frame = stock_frame(&header->image);
    frame.dialect = DIALECT_PAPER;
    frame.paper = *header;
    open_frame(self, &frame);
    self->announced = false;
}

static void overrun(stream_t *self) {
    frames_lose(self, LOST_OVERRUN);
    self->doubtful = true;
}

static void stock_body(stream_t *self, bytes_t data) {
    if (data.size > self->open.size - self->place) {
        overrun(self);
        return;
    }
    memcpy(self->body + self->place, data.data, data.size);
    self->place += (uint32_t)data.size;
    self->open.received = self->place;
    if (self->place == self->open.size) {
        finish_frame(self);
    }
}

static void native_header(stream_t *self, const native_frame_t *header) {
    if (self->in_frame && is_native_frame(self) && self->open.header.frame == header->frame) {
        self->stray_packets++; // it came twice
        return;
    }
    const stream_frame_t frame = {
        .dialect = DIALECT_NATIVE,
        .width = header->width,
        .height = header->height,
        .depth = header->depth,
        .type = header->encoding,
        .size = header->body_bytes,
        .header = *header,
    };
    open_frame(self, &frame);
    self->announced = false;
}

/// A piece of a frame whose header has not come, or of one that is closed already.
static void stray_data(stream_t *self, uint16_t frame_low) {
    const bool of_last = is_native_frame(self) && frame_low == (uint16_t)self->open.header.frame;
    self->stray_packets++;
    if (!of_last && !(self->has_stray_frame && frame_low == self->stray_frame_low)) {
        self->headless_frames++;
        self->has_stray_frame = true;
        self->stray_frame_low = frame_low;
    }
}

static void native_data(stream_t *self, uint16_t frame_low, uint32_t offset, bytes_t data) {
    stream_frame_t *open = &self->open;
    const bool ours = self->in_frame && is_native_frame(self) && frame_low == (uint16_t)open->header.frame;
    if (!ours) {
        stray_data(self, frame_low);
        return;
    }
    if (offset < self->place) {
        self->stray_packets++;
        return;
    }
    if (offset > open->size || data.size > open->size - offset) {
        overrun(self);
        return;
    }
    self->has_hole |= offset > self->place;
    memset(self->body + self->place, 0, offset - self->place);
    memcpy(self->body + offset, data.data, data.size);
    open->received += (uint32_t)data.size;
    self->place = offset + (uint32_t)data.size;
    if (self->place < open->size) {
        return;
    }
    if (self->has_hole) {
        frames_lose(self, LOST_MISSING_DATA);
    } else {
        finish_frame(self);
    }
}

/// A native message that is not part of an image.
static void native_message(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    native_pair_t pairs[NATIVE_PAIRS_MAX];
    native_status_t status;
    native_reply_t reply;
    native_log_t log;
    size_t count;
    uint32_t lost;
    const uint8_t kind = packet->data.data[1];
    const int result = kind == NATIVE_PAIRS    ? native_pairs_decode(packet->data, pairs, &count, &lost)
                       : kind == NATIVE_STATUS ? native_status_decode(packet->data, &status)
                       : kind == NATIVE_REPLY  ? native_reply_decode(packet->data, &reply)
                       : kind == NATIVE_LOG    ? native_log_decode(packet->data, &log)
                                               : ERR_START;
    self->bad_messages += result < 0 ? 1 : 0;
    report_data(self, result < 0 ? STREAM_PACKET : STREAM_NATIVE, packet, offset);
}

static void native_packet(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    native_frame_t header;
    uint16_t frame_low;
    uint32_t place;
    bytes_t body;
    if (native_data_decode(packet->data, &frame_low, &place, &body) > 0) {
        native_data(self, frame_low, place, body);
    } else if (native_frame_decode(packet->data, &header) > 0) {
        native_header(self, &header);
    } else {
        native_message(self, packet, offset);
    }
}

/// While a stock body is under way, nothing but its size says which packets belong to it. A packet that would
/// be its last piece is that; one that is exactly a frame header, of any dialect, or a reply, is not of the
/// body.
static bool is_stock_body(const stream_t *self, bytes_t data) {
    image_stock_t stock;
    paper_header_t paper;
    native_frame_t native;
    native_reply_t reply;
    if (!self->in_frame || is_native_frame(self)) {
        return false;
    }
    if (data.size == self->open.size - self->place) {
        return true;
    }
    const bool is_other = data.size == IMAGE_STOCK_BYTES    ? image_stock_decode(data, &stock) > 0
                          : data.size == PAPER_HEADER_BYTES ? paper_header_decode(data, &paper) > 0
                          : data.size == NATIVE_FRAME_BYTES || data.size == NATIVE_FRAME_CLOCK_BYTES ||
                                  data.size == NATIVE_FRAME_SHORT_BYTES
                              ? native_frame_decode(data, &native) > 0
                          : data.size == NATIVE_REPLY_BYTES ? native_reply_decode(data, &reply) > 0
                                                            : false;
    return !is_other;
}

static bool is_image_route(const cpx_route_t *route) {
    return route->source == CPX_GAP8 && route->destination == CPX_HOST && route->function == CPX_APP;
}

static bool is_native(bytes_t data) {
    return data.size >= 2 && data.data[0] == NATIVE_MAGIC;
}

bool frames_is_buffer(const cpx_route_t *route) {
    return route->source == CPX_GAP8 && route->destination == CPX_HOST && route->function == CPX_STREAMER;
}

bool frames_buffer_image(bytes_t data, nanocockpit_begin_t *begin, nanocockpit_metadata_t *metadata) {
    const int head = nanocockpit_begin_decode(data, begin);
    if (head < 0 || begin->type != NANOCOCKPIT_IMAGE ||
        nanocockpit_metadata_decode((bytes_t){data.data + head, data.size - (size_t)head}, metadata) < 0) {
        return false;
    }
    const uint64_t pixels = (uint64_t)metadata->width * metadata->height * metadata->depth;
    return pixels <= IMAGE_BODY_MAX && begin->size == NANOCOCKPIT_METADATA_BYTES + pixels;
}

/// The next bytes of the buffer, and maybe what its sender has padded its last packet with.
static void buffer_data(stream_t *self, bytes_t data) {
    const uint32_t left = self->open.size - self->place;
    if (data.size > left + NANOCOCKPIT_PADDING_MAX) {
        overrun(self);
        return;
    }
    const uint32_t size = data.size < left ? (uint32_t)data.size : left;
    memcpy(self->body + self->place, data.data, size);
    self->place += size;
    self->open.received = self->place;
    if (self->place == self->open.size) {
        finish_frame(self);
    }
}

/// The packet that has begun the frame, again: now there is memory for the pixels in it.
static bool buffer_begun(stream_t *self, const cpx_packet_t *packet) {
    const size_t head = NANOCOCKPIT_BEGIN_BYTES + NANOCOCKPIT_METADATA_BYTES;
    self->begin_waits = false;
    buffer_data(self, (bytes_t){packet->data.data + head, packet->data.size - head});
    return true;
}

static bool buffer_packet(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    const bytes_t data = packet->data;
    const int more = nanocockpit_more_decode(data);
    stream_frame_t frame = {.dialect = DIALECT_NANOCOCKPIT};
    nanocockpit_begin_t begin;
    if (more > 0 && self->in_frame) {
        buffer_data(self, (bytes_t){data.data + more, data.size - (size_t)more});
    } else if (more > 0) {
        self->stray_packets++;
    } else if (frames_buffer_image(data, &begin, &frame.nanocockpit)) {
        frame.width = frame.nanocockpit.width;
        frame.height = frame.nanocockpit.height;
        frame.depth = frame.nanocockpit.depth;
        frame.size = begin.size - NANOCOCKPIT_METADATA_BYTES;
        frame.check = begin.check;
        frame.check_so_far =
            crc32_zlib(0, (bytes_t){data.data + NANOCOCKPIT_BEGIN_BYTES, NANOCOCKPIT_METADATA_BYTES});
        open_frame(self, &frame);
        self->begin_waits = true;
        return false;
    } else {
        self->bad_messages++;
        report_data(self, STREAM_PACKET, packet, offset);
    }
    return true;
}

/// Of function APP: the image stream, but for NanoCockpit's.
static void app_packet(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    const bytes_t data = packet->data;
    image_stock_t stock;
    paper_header_t paper;
    if (!is_image_route(&packet->route)) {
        if (is_native(data)) {
            native_message(self, packet, offset);
        } else {
            report_data(self, STREAM_PACKET, packet, offset);
        }
    } else if (is_stock_body(self, data)) {
        stock_body(self, data);
    } else if (image_stock_decode(data, &stock) > 0) {
        stock_header(self, &stock, packet->route.reserved);
    } else if (paper_header_decode(data, &paper) > 0) {
        paper_header(self, &paper);
    } else if (is_native(data)) {
        native_packet(self, packet, offset);
    } else if (self->strays) {
        self->stray_packets++;
    } else {
        report_data(self, STREAM_PACKET, packet, offset);
    }
}

bool frames_packet(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    if (self->begin_waits) {
        return buffer_begun(self, packet);
    }
    self->packets[packet->route.function % STREAM_FUNCTIONS]++;
    if (packet->data.size == 0) {
        return true;
    }
    if (packet->route.function == CPX_APP) {
        app_packet(self, packet, offset);
    } else if (self->rule == STREAM_NANOCOCKPIT && frames_is_buffer(&packet->route)) {
        return buffer_packet(self, packet, offset);
    } else {
        report_data(self, STREAM_PACKET, packet, offset);
    }
    return true;
}

static uint32_t line_faults(const cpx_uart_t *uart) {
    return uart->bad_check + uart->bad_length + uart->garbage_bytes + uart->gaps;
}

void frames_piece(stream_t *self, const cpx_packet_t *packet, uint64_t offset) {
    const bytes_t data = packet->data;
    const bool more = data.size == CPX_DATA_UART_MAX && !packet->route.last_packet;
    const bool in_stock = self->in_frame && !is_native_frame(self);
    if (!is_image_route(&packet->route) || in_stock) {
        (void)frames_packet(self, packet, offset); // never NanoCockpit's
        return;
    }
    if (self->joined_fill > 0 && (self->joined_damage != line_faults(&self->uart) ||
                                  data.size > sizeof self->joined - self->joined_fill)) {
        // A piece in between was lost. Whether this one starts a packet, its first bytes must say.
        self->joined_fill = 0;
        self->stray_packets++;
    }
    if (self->joined_fill == 0 && !(more && is_native(data))) {
        (void)frames_packet(self, packet, offset);
        return;
    }
    if (self->joined_fill == 0) {
        self->joined_damage = line_faults(&self->uart);
    }
    memcpy(self->joined + self->joined_fill, data.data, data.size);
    self->joined_fill = (uint16_t)(self->joined_fill + data.size);
    if (!more) {
        const cpx_packet_t whole = {packet->route, {self->joined, self->joined_fill}};
        self->joined_fill = 0;
        (void)frames_packet(self, &whole, offset);
    }
}
