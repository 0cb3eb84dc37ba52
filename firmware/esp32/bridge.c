#include "parts.h"

#include <string.h>

static const uint8_t NETWORK_NAME[] = "crazyflie";

void esp32_bridge_init(esp32_t *self) {
    self->ssid_size = sizeof NETWORK_NAME - 1;
    memcpy(self->ssid, NETWORK_NAME, self->ssid_size);
    self->mode = 1;
    self->network_started = true;
    self->network_start_waits = true;
}

/// A buffer's bytes in the ring, packets and padding included.
static size_t ring_bytes(uint32_t size) {
    const size_t first = NANOCOCKPIT_DATA_MAX - NANOCOCKPIT_BEGIN_BYTES;
    const size_t more = NANOCOCKPIT_DATA_MAX - NANOCOCKPIT_MORE_BYTES;
    const size_t packets = size <= first ? 0 : (size - first + more - 1) / more;
    return size + NANOCOCKPIT_PADDING_MAX + CPX_LINK_HEADER_BYTES + NANOCOCKPIT_BEGIN_BYTES +
           packets * (CPX_LINK_HEADER_BYTES + NANOCOCKPIT_MORE_BYTES);
}

/// A buffer begins: all of it fits the ring, or none of it is taken.
static void start(esp32_t *self, uint32_t size) {
    if (self->images == IMAGES_TAKING) {
        self->frames_cut++;
    }
    self->frame_left = size;
    self->frame_ring_left = size < ESP32_IMAGE_BYTES ? (uint32_t)ring_bytes(size) : ESP32_IMAGE_BYTES + 1;
    self->images = esp32_ring_free(self) < self->frame_ring_left ? IMAGES_DROPPING : IMAGES_TAKING;
    self->frames_dropped += self->images == IMAGES_DROPPING;
}

static void put(esp32_t *self, bytes_t packet) {
    const uint32_t size = (uint32_t)packet.size;
    esp32_ring_push_bytes(self, packet);
    self->packets_forwarded++;
    self->frame_ring_left -= size < self->frame_ring_left ? size : self->frame_ring_left;
}

/// Bytes of the buffer under way, and the packet that holds them.
static void take(esp32_t *self, bytes_t packet, size_t size) {
    self->frame_left -= size < self->frame_left ? (uint32_t)size : self->frame_left;
    if (self->images == IMAGES_TAKING && esp32_ring_free(self) < packet.size) {
        self->frames_cut++; // it was longer than it had said
        self->images = IMAGES_LOST;
    } else if (self->images == IMAGES_TAKING) {
        put(self, packet);
        self->frames_forwarded += self->frame_left == 0;
    } else {
        self->packets_unsent++;
    }
    if (self->frame_left == 0) {
        self->images = IMAGES_BETWEEN;
    }
}

static bool is_buffer(const cpx_route_t *route) {
    return route->source == CPX_GAP8 && route->destination == CPX_HOST && route->function == CPX_STREAMER;
}

/// Any other packet, but never in the place of the buffer under way.
static void pass(esp32_t *self, bytes_t packet) {
    const size_t kept = self->images == IMAGES_TAKING ? self->frame_ring_left : 0;
    if (esp32_ring_free(self) < packet.size + kept) {
        self->packets_dropped++;
        return;
    }
    esp32_ring_push_bytes(self, packet);
    self->packets_forwarded++;
}

void esp32_bridge_receive_spi(esp32_t *self, bytes_t in) {
    cpx_packet_t packet;
    nanocockpit_begin_t begin;
    const int used = nanocockpit_link_decode(in, &packet);
    if (used < 0) {
        self->spi_errors++;
        return;
    }
    if (packet.data.size == 0) {
        return;
    }
    if (!self->client) {
        self->images = IMAGES_LOST;
        self->packets_unsent++;
        return;
    }
    const bytes_t whole = {in.data, (size_t)used};
    const bool buffer = is_buffer(&packet.route);
    if (buffer && nanocockpit_begin_decode(packet.data, &begin) > 0) {
        start(self, begin.size);
        take(self, whole, packet.data.size - NANOCOCKPIT_BEGIN_BYTES);
    } else if (buffer && nanocockpit_more_decode(packet.data) > 0) {
        const bool in_frame = self->images == IMAGES_TAKING || self->images == IMAGES_DROPPING;
        if (in_frame) {
            take(self, whole, packet.data.size - NANOCOCKPIT_MORE_BYTES);
        } else {
            self->packets_unsent++;
        }
    } else {
        pass(self, whole);
    }
}

/// Is the packet whole? What cannot be one costs a byte, and the search goes on behind it. One without data
/// would be idle on SPI.
static bool bridged_whole(esp32_t *self) {
    cpx_packet_t packet;
    while (self->bridged_fill >= CPX_LINK_HEADER_BYTES) {
        const int used = nanocockpit_link_decode((bytes_t){self->bridged, self->bridged_fill}, &packet);
        cpx_route_t route;
        cpx_route_decode(self->bridged + 2, &route);
        if (used != ERR_LENGTH && load16_le(self->bridged) > 0 && cpx_route_ok(&route)) {
            return used > 0;
        }
        self->bridged_fill--;
        memmove(self->bridged, self->bridged + 1, self->bridged_fill);
        self->tcp_rx.skipped_bytes++;
    }
    return false;
}

size_t esp32_bridge_receive_tcp(esp32_t *self, bytes_t in) {
    size_t taken = 0;
    while (taken < in.size && !bridged_whole(self)) {
        const size_t wanted =
            self->bridged_fill < CPX_LINK_HEADER_BYTES
                ? CPX_LINK_HEADER_BYTES - (size_t)self->bridged_fill
                : CPX_LINK_HEADER_BYTES + (size_t)load16_le(self->bridged) - self->bridged_fill;
        const size_t left = in.size - taken;
        const size_t size = wanted < left ? wanted : left;
        memcpy(self->bridged + self->bridged_fill, in.data + taken, size);
        self->bridged_fill = (uint16_t)(self->bridged_fill + size);
        taken += size;
    }
    return taken;
}

size_t esp32_bridge_output_spi(esp32_t *self, bytes_mut_t out) {
    if (out.size < NANOCOCKPIT_FRAME_MAX) {
        return 0;
    }
    if (!bridged_whole(self)) {
        memset(out.data, 0, CPX_LINK_HEADER_BYTES);
        return CPX_LINK_HEADER_BYTES;
    }
    const size_t size = self->bridged_fill;
    memcpy(out.data, self->bridged, size);
    self->bridged_fill = 0;
    self->tcp_rx.packets_in++;
    self->packets_forwarded++;
    return size;
}
