/// The inside of stream.h: what bytes of a TCP connection, which bear no magic and no check, are believed to
/// be. `rule`: STREAM_CPX or STREAM_NANOCOCKPIT. `header`: CPX_LINK_HEADER_BYTES.
#ifndef SPINDECK_HOST_BELIEF_H
#define SPINDECK_HOST_BELIEF_H

#include "stream.h"

typedef enum { BELIEF_NO, BELIEF_YES, BELIEF_UNKNOWN /* more bytes may tell */ } belief_t;

/// Of a packet with its header, as that says.
size_t belief_packet_bytes(uint8_t rule, const uint8_t *header);

/// May this be a header? Fills `route` whatever it is.
bool belief_plausible(uint8_t rule, const uint8_t *header, cpx_route_t *route);

/// Is it one that needs no other behind it, while packets are in step?
bool belief_usual(uint8_t rule, const cpx_route_t *route);

/// Does a run of packets start here?
belief_t belief_cpx_starts(const uint8_t *in, size_t size);

/// Does one of NanoCockpit's image buffers start here?
belief_t belief_buffer_starts(const uint8_t *in, size_t size);

#endif
