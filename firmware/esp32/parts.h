/// The parts of the ESP32's app, private to it: queues.c keeps packets, images.c decides about frames,
/// local.c is what the ESP32 itself answers and says, output.c hands out what waits, app.c receives, routes
/// and keeps time. bridge.c is NanoCockpit's, in the place of all of them but the image ring.
#ifndef SPINDECK_ESP32_PARTS_H
#define SPINDECK_ESP32_PARTS_H

#include "app.h"

/// Copies one packet; false and nothing when it is full (or the data exceeds CPX_DATA_MAX).
bool esp32_queue_push(esp32_queue_t *queue, const cpx_packet_t *packet);
/// The first packet, NULL when there is none. Valid until it is popped.
const esp32_packet_t *esp32_queue_first(const esp32_queue_t *queue);
void esp32_queue_pop(esp32_queue_t *queue);

bool esp32_packet_store(esp32_packet_t *self, const cpx_packet_t *packet);
/// A view of a stored packet.
cpx_packet_t esp32_packet_view(const esp32_packet_t *self);

/// The image ring: bytes of whole packets, in order.
size_t esp32_ring_free(const esp32_t *self);
/// There must be room for CPX_LINK_HEADER_BYTES and the data.
void esp32_ring_push(esp32_t *self, const cpx_packet_t *packet);
/// A packet as it goes on TCP.
void esp32_ring_push_bytes(esp32_t *self, bytes_t packet);
/// There must be `size` bytes.
void esp32_ring_read(esp32_t *self, uint8_t *out, size_t size);
/// The size of the packet at the head, which must not have been begun.
size_t esp32_ring_packet(const esp32_t *self);

/// A packet of function APP from the GAP8 to the host: true when it belongs to the image stream, and has been
/// put into the ring or dropped; false when it is to be routed as any other.
bool esp32_images_take(esp32_t *self, const cpx_packet_t *packet);
/// Data of a packet of function APP from the host to the GAP8.
void esp32_images_asked(esp32_t *self, bytes_t in);
/// For another host: forgets the frame under way and what was asked for, and empties the ring.
void esp32_images_reset(esp32_t *self);

void esp32_bridge_init(esp32_t *self);
void esp32_bridge_receive_spi(esp32_t *self, bytes_t in);
/// Stops behind a whole packet until SPI has taken it.
size_t esp32_bridge_receive_tcp(esp32_t *self, bytes_t in);
size_t esp32_bridge_output_spi(esp32_t *self, bytes_mut_t out);

/// The queue of the link to `target`, or NULL when there is none.
esp32_queue_t *esp32_queue_to(esp32_t *self, uint8_t target);

/// A packet for the ESP32. False when the answer finds no room: then nothing has been done.
bool esp32_local(esp32_t *self, const cpx_packet_t *packet, uint64_t now_us);
/// A packet is on its way: what the host asks the GAP8 or the STM32 for, it may get.
void esp32_asked(esp32_t *self, const cpx_packet_t *packet);
/// Data of a packet of function APP from the STM32 to the host: true, and counted, for a message about the
/// log that was meant for the host before this one.
bool esp32_reports_unasked(esp32_t *self, bytes_t in);
/// To the GAP8, then to the STM32: whether a host is connected.
void esp32_tell_client(esp32_t *self);
/// Likewise, but only to whom nothing else waits to be told.
void esp32_repeat_client(esp32_t *self);
/// To the GAP8, which has missed that the host before this one went: gone, and here. Likewise.
void esp32_tell_new_client(esp32_t *self);
/// To the GAP8 and the STM32: our address as a station.
void esp32_tell_address(esp32_t *self, const uint8_t address[4]);
void esp32_tell_boot(esp32_t *self);
void esp32_send_status(esp32_t *self, uint64_t now_us);

/// esp32_transmit, port by port.
size_t esp32_output_uart(esp32_t *self, bytes_mut_t out, uint64_t now_us);
size_t esp32_output_spi(esp32_t *self, bytes_mut_t out);
size_t esp32_output_tcp(esp32_t *self, bytes_mut_t out);
size_t esp32_output_network(esp32_t *self, bytes_mut_t out);
/// UART2's buffer is free and something waits for it.
bool esp32_output_loads(const esp32_t *self);

#endif
