/// A packet that decodes encodes to the same bytes; a refusal leaves the packet alone.
#include "claim.h"

#include "firmware/core/cpx_link.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    cpx_packet_t packet;
    memset(&packet, POISON, sizeof packet);
    const int used = cpx_link_decode((bytes_t){data, size}, &packet);
    if (used < 0) {
        CLAIM(untouched(&packet, sizeof packet));
        return 0;
    }
    CLAIM(used >= CPX_LINK_HEADER_BYTES && (size_t)used <= size);
    CLAIM(packet.data.size == (size_t)used - CPX_LINK_HEADER_BYTES);
    if (load16_le(data) > 0) {
        uint8_t out[CPX_LINK_FRAME_MAX];
        CLAIM(cpx_link_encode(&packet, (bytes_mut_t){out, sizeof out}) == (size_t)used);
        CLAIM(memcmp(out, data, (size_t)used) == 0);
    }
    const size_t window = cpx_spi_window_bytes((size_t)used, CPX_LINK_HEADER_BYTES);
    CLAIM(window >= (size_t)used && window % 4 == 0 && window <= CPX_LINK_FRAME_MAX);
    return 0;
}
