#include "parts.h"

void esp32_images_asked(esp32_t *self, bytes_t in) {
    native_stream_t stream;
    self->requests = self->requests || in.data[0] == NATIVE_MAGIC;
    // Back to stock: the frame under way stays native, and the host understands it.
    if (native_stream_decode(in, &stream) > 0 && stream.dialect != 0) {
        self->frame_data_max = stream.data_max == 0 ? CPX_DATA_MAX : stream.data_max;
    }
}

void esp32_images_reset(esp32_t *self) {
    while (self->image_fill > 0) {
        const size_t left = self->image_packet_left > 0 ? self->image_packet_left : esp32_ring_packet(self);
        self->image_head = (uint32_t)((self->image_head + left) % ESP32_IMAGE_BYTES);
        self->image_fill -= (uint32_t)left;
        self->image_packet_left = 0;
        self->packets_unsent++;
    }
    self->images = IMAGES_LOST;
    self->frame_data_max = 0;
    self->requests = false;
}

static size_t ring_bytes(const cpx_packet_t *packet) {
    return CPX_LINK_HEADER_BYTES + packet->data.size;
}

static void put(esp32_t *self, const cpx_packet_t *packet) {
    esp32_ring_push(self, packet);
    self->packets_forwarded++;
}

/// Room for another frame. What a slow line cannot carry is dropped, not delivered seconds later.
static size_t frame_room(const esp32_t *self) {
    const bool slow = self->config.host_on_uart != 0 && self->image_fill > 0;
    const size_t most = slow ? ESP32_UART_IMAGE_BYTES : ESP32_IMAGE_BYTES;
    return self->image_fill < most ? most - self->image_fill : 0;
}

/// The first packet of a frame: its whole body fits the ring, or none of it is taken.
static void start(esp32_t *self, const cpx_packet_t *packet, uint32_t body_bytes, size_t body_ring_bytes,
                  size_t spare_bytes) {
    if (self->images == IMAGES_TAKING) {
        self->frames_cut++;
    }
    self->frame_left = body_bytes;
    self->frame_ring_left = (uint32_t)body_ring_bytes;
    if (frame_room(self) < ring_bytes(packet) + body_ring_bytes + spare_bytes) {
        self->images = IMAGES_DROPPING;
        self->frames_dropped++;
        return;
    }
    self->images = IMAGES_TAKING;
    put(self, packet);
}

static void start_stock(esp32_t *self, const cpx_packet_t *packet, const image_stock_t *header) {
    // A JPEG's file header and footer have packets of their own.
    const size_t packets =
        (header->size + CPX_DATA_MAX - 1) / CPX_DATA_MAX + (header->type == IMAGE_JPEG ? 2 : 0);
    self->frame_native = false;
    start(self, packet, header->size, header->size + packets * CPX_LINK_HEADER_BYTES, 0);
}

static void start_native(esp32_t *self, const cpx_packet_t *packet, const native_frame_t *header) {
    const size_t piece = (size_t)self->frame_data_max - NATIVE_DATA_HEAD_BYTES;
    const size_t packets = (header->body_bytes + piece - 1) / piece;
    const size_t heads = packets * (CPX_LINK_HEADER_BYTES + NATIVE_DATA_HEAD_BYTES);
    self->frame_native = true;
    start(self, packet, header->body_bytes, header->body_bytes + heads, ESP32_PAIRS_BYTES);
}

/// The frame under way cannot be completed: it gets no more packets.
static void give_up(esp32_t *self) {
    if (self->images == IMAGES_TAKING) {
        self->frames_cut++;
    }
    self->images = IMAGES_LOST;
}

/// The GAP8 has not heard that the host which wanted native frames has gone.
static void hold_back(esp32_t *self) {
    give_up(self);
    self->frames_unasked++;
    self->packets_unsent++;
    esp32_tell_new_client(self);
}

static void take_body(esp32_t *self, const cpx_packet_t *packet, size_t body_bytes) {
    const size_t size = ring_bytes(packet);
    const bool fits = self->images == IMAGES_DROPPING || esp32_ring_free(self) >= size;
    if (body_bytes > self->frame_left || !fits) {
        give_up(self);
        return;
    }
    self->frame_left -= (uint32_t)body_bytes;
    if (self->images == IMAGES_TAKING) {
        put(self, packet);
        self->frame_ring_left -= (uint32_t)(size < self->frame_ring_left ? size : self->frame_ring_left);
        self->frames_forwarded += self->frame_left == 0;
    }
    if (self->frame_left == 0) {
        self->images = IMAGES_BETWEEN;
    }
}

/// Pairs go on even if their frame does not, but never in the place of its body.
static void take_pairs(esp32_t *self, const cpx_packet_t *packet) {
    const size_t kept = self->images == IMAGES_TAKING ? self->frame_ring_left : 0;
    if (esp32_ring_free(self) >= ring_bytes(packet) + kept) {
        put(self, packet);
    } else {
        self->packets_dropped++;
    }
}

/// Of a native frame, even if it is damaged.
static bool is_native(bytes_t in) {
    return in.size >= 2 && in.data[0] == NATIVE_MAGIC && in.data[1] >= NATIVE_FRAME &&
           in.data[1] <= NATIVE_PAIRS;
}

/// Packets whose first bytes say what they are.
static bool take_native(esp32_t *self, const cpx_packet_t *packet, bool in_frame) {
    const bytes_t in = packet->data;
    uint16_t frame_low;
    uint32_t offset;
    bytes_t body;
    if (in.size >= NATIVE_PAIRS_HEAD_BYTES && in.data[0] == NATIVE_MAGIC && in.data[1] == NATIVE_PAIRS) {
        take_pairs(self, packet);
        return true;
    }
    if (native_data_decode(in, &frame_low, &offset, &body) < 0) {
        return false;
    }
    if (in_frame) {
        take_body(self, packet, body.size);
    } else {
        self->packets_unsent++;
    }
    return true;
}

bool esp32_images_take(esp32_t *self, const cpx_packet_t *packet) {
    const bytes_t in = packet->data;
    const bool in_frame = self->images == IMAGES_TAKING || self->images == IMAGES_DROPPING;
    const bool in_stock = in_frame && !self->frame_native;
    // Stock bodies are bare bytes: what ends the frame exactly is body, whatever it looks like.
    if (in_stock && in.size == self->frame_left) {
        take_body(self, packet, in.size);
        return true;
    }
    image_stock_t stock;
    if (image_stock_decode(in, &stock) > 0) {
        start_stock(self, packet, &stock);
        return true;
    }
    paper_header_t paper;
    if (paper_header_decode(in, &paper) > 0) {
        start_stock(self, packet, &paper.image);
        return true;
    }
    native_frame_t native;
    const bool framed = in.size == NATIVE_FRAME_BYTES || in.size == NATIVE_FRAME_CLOCK_BYTES ||
                        in.size == NATIVE_FRAME_SHORT_BYTES;
    if ((framed || !in_stock) && native_frame_decode(in, &native) > 0) {
        if (self->frame_data_max == 0) {
            hold_back(self);
        } else {
            start_native(self, packet, &native);
        }
        return true;
    }
    native_reply_t reply;
    if (in.size == NATIVE_REPLY_BYTES && native_reply_decode(in, &reply) > 0) {
        self->packets_unsent += !self->requests;
        return !self->requests;
    }
    if (in_stock) {
        take_body(self, packet, in.size);
        return true;
    }
    if (self->frame_data_max > 0 && take_native(self, packet, in_frame)) {
        return true;
    }
    if (self->images == IMAGES_LOST || (self->frame_data_max == 0 && is_native(in))) {
        self->packets_unsent++;
        return true;
    }
    return false;
}
