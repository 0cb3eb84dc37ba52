#include "parts.h"

#include <string.h>

/// A packet for UART2, or the next piece of one that is too long for it: `left` bytes of it are not sent yet.
/// UART2's buffer is free, so this cannot fail.
static void send_piece(esp32_t *self, cpx_route_t route, bytes_t piece, size_t left) {
    route.last_packet = route.last_packet && piece.size == left;
    const cpx_packet_t packet = {.route = route, .data = piece};
    (void)cpx_uart_send(&self->uart2, &packet);
}

static size_t piece_of(size_t left) {
    return left < CPX_DATA_UART_MAX ? left : CPX_DATA_UART_MAX;
}

static void load_queued(esp32_t *self) {
    const cpx_packet_t packet = esp32_packet_view(esp32_queue_first(&self->to_uart));
    const size_t left = packet.data.size - self->uart_split;
    const bytes_t piece = {packet.data.data + self->uart_split, piece_of(left)};
    send_piece(self, packet.route, piece, left);
    self->uart_split = (uint16_t)(self->uart_split + piece.size);
    if (piece.size == left) {
        self->uart_split = 0;
        esp32_queue_pop(&self->to_uart);
    }
}

static void load_image(esp32_t *self) {
    if (self->image_packet_left == 0) {
        uint8_t header[CPX_LINK_HEADER_BYTES];
        esp32_ring_read(self, header, sizeof header);
        self->image_packet_left = (uint32_t)load16_le(header) - CPX_ROUTE_BYTES;
        memcpy(self->image_route, header + sizeof header - CPX_ROUTE_BYTES, CPX_ROUTE_BYTES);
    }
    uint8_t data[CPX_DATA_UART_MAX];
    cpx_route_t route;
    cpx_route_decode(self->image_route, &route);
    const bytes_t piece = {data, piece_of(self->image_packet_left)};
    esp32_ring_read(self, data, piece.size);
    send_piece(self, route, piece, self->image_packet_left);
    self->image_packet_left -= (uint32_t)piece.size;
}

/// Queued packets overtake images, but never inside a packet.
static bool queue_goes_first(const esp32_t *self, const esp32_queue_t *queue) {
    return self->image_packet_left == 0 && queue->fill > 0;
}

bool esp32_output_loads(const esp32_t *self) {
    const bool images = self->config.host_on_uart && self->image_fill > 0;
    return self->uart2.tx_size == 0 && (self->to_uart.fill > 0 || images);
}

size_t esp32_output_uart(esp32_t *self, bytes_mut_t out, uint64_t now_us) {
    if (esp32_output_loads(self)) {
        if (!self->config.host_on_uart || queue_goes_first(self, &self->to_uart)) {
            load_queued(self);
        } else {
            load_image(self);
        }
    }
    return cpx_uart_transmit(&self->uart2, out.data, now_us);
}

size_t esp32_output_spi(esp32_t *self, bytes_mut_t out) {
    const esp32_packet_t *first = esp32_queue_first(&self->to_spi);
    if (out.size < CPX_LINK_FRAME_MAX) {
        return 0;
    }
    if (first == NULL) {
        memset(out.data, 0, CPX_LINK_HEADER_BYTES);
        return CPX_LINK_HEADER_BYTES;
    }
    const size_t size = first->size;
    memcpy(out.data, first->bytes, size);
    esp32_queue_pop(&self->to_spi);
    return size;
}

static size_t give_queued(esp32_t *self, bytes_mut_t out) {
    const esp32_packet_t *first = esp32_queue_first(&self->to_tcp);
    const size_t left = (size_t)first->size - self->packet_sent;
    const size_t size = left < out.size ? left : out.size;
    memcpy(out.data, first->bytes + self->packet_sent, size);
    self->packet_sent = (uint16_t)(self->packet_sent + size);
    if (size == left) {
        self->packet_sent = 0;
        esp32_queue_pop(&self->to_tcp);
    }
    return size;
}

static size_t give_image(esp32_t *self, bytes_mut_t out) {
    if (self->image_packet_left == 0) {
        self->image_packet_left = (uint32_t)esp32_ring_packet(self);
    }
    const size_t size = self->image_packet_left < out.size ? self->image_packet_left : out.size;
    esp32_ring_read(self, out.data, size);
    self->image_packet_left -= (uint32_t)size;
    return size;
}

size_t esp32_output_tcp(esp32_t *self, bytes_mut_t out) {
    size_t size = 0;
    if (self->config.host_on_uart) {
        return 0;
    }
    while (size < out.size && (self->to_tcp.fill > 0 || self->image_fill > 0)) {
        const bytes_mut_t rest = {out.data + size, out.size - size};
        size += queue_goes_first(self, &self->to_tcp) ? give_queued(self, rest) : give_image(self, rest);
    }
    return size;
}

size_t esp32_output_network(esp32_t *self, bytes_mut_t out) {
    if (self->network_reset_waits) {
        self->network_reset_waits = false;
        out.data[0] = NETWORK_RESET_GAP8;
        return 1;
    }
    const size_t start_size = (size_t)4 + self->ssid_size + self->key_size;
    if (!self->network_start_waits || out.size < start_size) {
        return 0;
    }
    self->network_start_waits = false;
    uint8_t *key = out.data + 3 + self->ssid_size;
    out.data[0] = NETWORK_START;
    out.data[1] = self->mode;
    out.data[2] = self->ssid_size;
    memcpy(out.data + 3, self->ssid, self->ssid_size);
    key[0] = self->key_size;
    memcpy(key + 1, self->key, self->key_size);
    return start_size;
}
