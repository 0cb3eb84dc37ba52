#include "cpx_link.h"

#include <string.h>

enum { LENGTH_BYTES = 2, SPI_WORD = 4 };

void cpx_link_header(const cpx_route_t *route, size_t data_size, uint8_t out[4]) {
    const size_t size = data_size > CPX_DATA_MAX ? CPX_DATA_MAX : data_size;
    store16_le(out, (uint16_t)(CPX_ROUTE_BYTES + size));
    cpx_route_encode(route, out + LENGTH_BYTES);
}

size_t cpx_link_encode(const cpx_packet_t *packet, bytes_mut_t out) {
    const bytes_t data = packet->data;
    if (data.size > CPX_DATA_MAX || out.size < CPX_LINK_HEADER_BYTES + data.size) {
        return 0;
    }
    cpx_link_header(&packet->route, data.size, out.data);
    if (data.size > 0) {
        memcpy(out.data + CPX_LINK_HEADER_BYTES, data.data, data.size);
    }
    return CPX_LINK_HEADER_BYTES + data.size;
}

int cpx_link_decode(bytes_t in, cpx_packet_t *packet) {
    if (in.size < LENGTH_BYTES) {
        return ERR_SHORT;
    }
    const uint16_t length = load16_le(in.data);
    if (length == 1 || length > CPX_MTU) {
        return ERR_LENGTH;
    }
    if (in.size < CPX_LINK_HEADER_BYTES || in.size < (size_t)LENGTH_BYTES + length) {
        return ERR_SHORT;
    }
    *packet = (cpx_packet_t){.data = {in.data + CPX_LINK_HEADER_BYTES, 0}};
    if (length == 0) {
        return CPX_LINK_HEADER_BYTES;
    }
    cpx_route_decode(in.data + LENGTH_BYTES, &packet->route);
    packet->data.size = (size_t)length - CPX_ROUTE_BYTES;
    return LENGTH_BYTES + length;
}

size_t cpx_spi_window_bytes(size_t master_size, size_t slave_size) {
    const size_t longest = master_size > slave_size ? master_size : slave_size;
    const size_t shortest = CPX_LINK_HEADER_BYTES + SPI_WORD;
    return longest <= shortest ? shortest : (longest + SPI_WORD - 1) / SPI_WORD * SPI_WORD;
}

void cpx_tcp_rx_init(cpx_tcp_rx_t *self) {
    *self = (cpx_tcp_rx_t){0};
}

static bool plausible(const uint8_t header[CPX_LINK_HEADER_BYTES]) {
    const uint16_t length = load16_le(header);
    cpx_route_t route;
    cpx_route_decode(header + LENGTH_BYTES, &route);
    return length >= CPX_ROUTE_BYTES && length <= CPX_MTU && cpx_route_ok(&route);
}

static size_t wanted(const cpx_tcp_rx_t *self) {
    return self->rx_fill < CPX_LINK_HEADER_BYTES ? CPX_LINK_HEADER_BYTES
                                                 : (size_t)LENGTH_BYTES + load16_le(self->rx);
}

static void drop(cpx_tcp_rx_t *self, size_t count) {
    self->rx_fill = (uint16_t)(self->rx_fill - count);
    memmove(self->rx, self->rx + count, self->rx_fill);
}

/// Skips to the first plausible header. True when its whole packet is there.
static bool find_packet(cpx_tcp_rx_t *self) {
    while (self->rx_fill >= CPX_LINK_HEADER_BYTES && !plausible(self->rx)) {
        drop(self, 1);
        self->skipped_bytes++;
    }
    return self->rx_fill >= CPX_LINK_HEADER_BYTES && self->rx_fill >= wanted(self);
}

bool cpx_tcp_rx(cpx_tcp_rx_t *self, bytes_t *in, cpx_packet_t *packet) {
    drop(self, self->rx_taken);
    self->rx_taken = 0;
    while (!find_packet(self)) {
        if (in->size == 0) {
            return false;
        }
        const size_t missing = wanted(self) - self->rx_fill;
        const size_t taken = missing < in->size ? missing : in->size;
        memcpy(self->rx + self->rx_fill, in->data, taken);
        self->rx_fill = (uint16_t)(self->rx_fill + taken);
        in->data += taken;
        in->size -= taken;
    }
    self->rx_taken = (uint16_t)cpx_link_decode((bytes_t){self->rx, self->rx_fill}, packet);
    self->packets_in++;
    return true;
}

bool cpx_tcp_rx_waits(const cpx_tcp_rx_t *self) {
    return self->rx_fill > self->rx_taken;
}

void cpx_tcp_rx_give_up(cpx_tcp_rx_t *self) {
    if (cpx_tcp_rx_waits(self)) {
        drop(self, (size_t)self->rx_taken + 1);
        self->rx_taken = 0;
        self->skipped_bytes++;
    }
}

void cpx_tcp_rx_clear(cpx_tcp_rx_t *self) {
    self->rx_fill = self->rx_taken = 0;
}
