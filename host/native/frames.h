/// The inside of stream.h: what packets mean. stream.c finds them, frames.c puts images together.
#ifndef SPINDECK_HOST_FRAMES_H
#define SPINDECK_HOST_FRAMES_H

#include "stream.h"

/// The next free event. The caller has left room: stream.c stops before that runs out.
stream_event_t *stream_event(stream_t *self, uint8_t kind);

/// One packet whose header lies at `offset` in the stream. At most STREAM_EVENTS_PER_PACKET events. False: it
/// begins a frame and holds a piece of its body too; give it again once there is memory for that.
bool frames_packet(stream_t *self, const cpx_packet_t *packet, uint64_t offset);

/// Does this packet belong to NanoCockpit's image stream?
bool frames_is_buffer(const cpx_route_t *route);

/// Does this data begin an image buffer whose size is that of its picture?
bool frames_buffer_image(bytes_t data, nanocockpit_begin_t *begin, nanocockpit_metadata_t *metadata);

/// A packet from CPX over UART: native ones may come in pieces.
void frames_piece(stream_t *self, const cpx_packet_t *packet, uint64_t offset);

/// Gives up `open`, if there is one.
void frames_lose(stream_t *self, uint8_t cause);

enum { STREAM_EVENTS_PER_PACKET = 4 };

#endif
