/// CPX over SPI (GAP8 <-> ESP32) and over TCP (ESP32 <-> host): the same layout on both.
///
/// u16 length of route and data, route, data. No magic, no check, no sequence: on SPI a length of 0 means
/// "nothing to say", on TCP the smallest length is 2. Sources and the handshake around it: docs/PROTOCOL.md.
#ifndef SPINDECK_CORE_CPX_LINK_H
#define SPINDECK_CORE_CPX_LINK_H

#include "cpx.h"

enum {
    CPX_LINK_HEADER_BYTES = 4, ///< length and route
    CPX_LINK_FRAME_MAX = 1024, ///< length field and CPX_MTU
};

/// Writes the four header bytes for `data_size` bytes of data (at most CPX_DATA_MAX; more is our own mistake
/// and is clamped).
void cpx_link_header(const cpx_route_t *route, size_t data_size, uint8_t out[4]);

/// Writes header and data; returns the size, or 0 when the data exceeds CPX_DATA_MAX or `out` is too small.
size_t cpx_link_encode(const cpx_packet_t *packet, bytes_mut_t out);

/// Decodes the packet at the start of `in`. Returns the bytes it takes: 4 for an idle SPI header (length 0,
/// then packet->data is empty and the route all zero), else 4 and more. ERR_SHORT, or ERR_LENGTH for 1 and
/// for more than CPX_MTU. The route is not judged: that is cpx_route_ok. `packet->data` points into `in`.
int cpx_link_decode(bytes_t in, cpx_packet_t *packet);

/// Bytes clocked in one SPI chip-select window when the two sides have `master_size` and `slave_size` bytes
/// of header, route and data (4 = idle). Part one is 4 bytes; part two is what remains, rounded up to a
/// multiple of 4 and never below 4.
size_t cpx_spi_window_bytes(size_t master_size, size_t slave_size);

/// Packets out of a TCP stream, for the small messages that a host sends. The caller owns it.
typedef struct {
    uint8_t rx[CPX_LINK_FRAME_MAX];
    uint16_t rx_fill;
    uint16_t rx_taken; ///< bytes at the front of rx that are the packet handed out last
    uint32_t packets_in;
    uint32_t skipped_bytes; ///< thrown away to find the next plausible header
} cpx_tcp_rx_t;

void cpx_tcp_rx_init(cpx_tcp_rx_t *self);

/// Takes bytes from the front of *in (which it advances) until one packet is complete; true with `packet`,
/// which views self->rx until the next call; false when *in is used up. A header with an impossible length,
/// or whose route is not cpx_route_ok, is skipped by one byte, and counted.
bool cpx_tcp_rx(cpx_tcp_rx_t *self, bytes_t *in, cpx_packet_t *packet);

/// A packet has begun and is not complete.
bool cpx_tcp_rx_waits(const cpx_tcp_rx_t *self);

/// What has come of it is no packet: its first byte is skipped, and what follows is judged again, by
/// cpx_tcp_rx with whatever comes, or with nothing.
void cpx_tcp_rx_give_up(cpx_tcp_rx_t *self);

/// All that has come is forgotten, not the counters.
void cpx_tcp_rx_clear(cpx_tcp_rx_t *self);

#endif
