#include "parts.h"

#include <string.h>

bool esp32_packet_store(esp32_packet_t *self, const cpx_packet_t *packet) {
    self->size = (uint16_t)cpx_link_encode(packet, (bytes_mut_t){self->bytes, sizeof self->bytes});
    return self->size > 0;
}

cpx_packet_t esp32_packet_view(const esp32_packet_t *self) {
    cpx_packet_t packet;
    (void)cpx_link_decode((bytes_t){self->bytes, self->size}, &packet); // our own encoding
    return packet;
}

bool esp32_queue_push(esp32_queue_t *queue, const cpx_packet_t *packet) {
    if (queue->fill == queue->capacity ||
        !esp32_packet_store(&queue->slots[(queue->head + queue->fill) % queue->capacity], packet)) {
        return false;
    }
    queue->fill++;
    return true;
}

const esp32_packet_t *esp32_queue_first(const esp32_queue_t *queue) {
    return queue->fill > 0 ? &queue->slots[queue->head] : NULL;
}

void esp32_queue_pop(esp32_queue_t *queue) {
    queue->head = (uint8_t)((queue->head + 1) % queue->capacity);
    queue->fill--;
}

size_t esp32_ring_free(const esp32_t *self) {
    return ESP32_IMAGE_BYTES - self->image_fill;
}

static void ring_write(esp32_t *self, const uint8_t *in, size_t size) {
    const size_t at = (self->image_head + self->image_fill) % ESP32_IMAGE_BYTES;
    const size_t first = size < ESP32_IMAGE_BYTES - at ? size : ESP32_IMAGE_BYTES - at;
    memcpy(self->image + at, in, first);
    memcpy(self->image, in + first, size - first);
    self->image_fill += (uint32_t)size;
}

void esp32_ring_push(esp32_t *self, const cpx_packet_t *packet) {
    uint8_t header[CPX_LINK_HEADER_BYTES];
    cpx_link_header(&packet->route, packet->data.size, header);
    ring_write(self, header, sizeof header);
    ring_write(self, packet->data.data, packet->data.size);
}

void esp32_ring_push_bytes(esp32_t *self, bytes_t packet) {
    ring_write(self, packet.data, packet.size);
}

void esp32_ring_read(esp32_t *self, uint8_t *out, size_t size) {
    const size_t at = self->image_head;
    const size_t first = size < ESP32_IMAGE_BYTES - at ? size : ESP32_IMAGE_BYTES - at;
    memcpy(out, self->image + at, first);
    memcpy(out + first, self->image, size - first);
    self->image_head = (uint32_t)((at + size) % ESP32_IMAGE_BYTES);
    self->image_fill -= (uint32_t)size;
}

size_t esp32_ring_packet(const esp32_t *self) {
    const uint8_t length[2] = {
        self->image[self->image_head],
        self->image[(self->image_head + 1) % ESP32_IMAGE_BYTES],
    };
    return (self->config.bridge ? CPX_LINK_HEADER_BYTES : sizeof length) + load16_le(length);
}
