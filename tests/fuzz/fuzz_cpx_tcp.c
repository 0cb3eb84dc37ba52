/// Packets out of a TCP stream do not depend on how it is cut, and each byte is in a packet, skipped, or
/// waiting.
#include "claim.h"

#include "firmware/core/checks.h"
#include "firmware/core/cpx_link.h"

typedef struct {
    cpx_tcp_rx_t rx;
    size_t packet_bytes;
    uint32_t crc;
} reader_t;

static void take(reader_t *self, bytes_t in) {
    cpx_packet_t packet;
    while (cpx_tcp_rx(&self->rx, &in, &packet)) {
        CLAIM(cpx_route_ok(&packet.route) && packet.data.size <= CPX_DATA_MAX);
        self->packet_bytes += CPX_LINK_HEADER_BYTES + packet.data.size;
        self->crc = crc32_zlib(self->crc ^ packet.route.function, packet.data);
    }
    CLAIM(in.size == 0);
    CLAIM(self->rx.rx_fill < CPX_LINK_FRAME_MAX);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    reader_t whole = {0};
    reader_t bytewise = {0};
    cpx_tcp_rx_init(&whole.rx);
    cpx_tcp_rx_init(&bytewise.rx);
    take(&whole, (bytes_t){data, size});
    for (size_t i = 0; i < size; i++) {
        take(&bytewise, (bytes_t){data + i, 1});
    }
    CLAIM(whole.packet_bytes + whole.rx.skipped_bytes + whole.rx.rx_fill == size);
    CLAIM(whole.rx.packets_in == bytewise.rx.packets_in && whole.crc == bytewise.crc);
    CLAIM(whole.rx.skipped_bytes == bytewise.rx.skipped_bytes && whole.rx.rx_fill == bytewise.rx.rx_fill);
    return 0;
}
