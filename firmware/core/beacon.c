#include "beacon.h"

void beacon_encode(const beacon_t *beacon, uint8_t out[14]) {
    out[0] = BEACON_CRTP;
    out[1] = BEACON_KIND;
    store32_le(out + 2, beacon->sequence);
    store64_le(out + 6, beacon->host_us);
}

int beacon_decode(bytes_t in, beacon_t *beacon) {
    if ((in.size > 0 && (in.data[0] & BEACON_CRTP_MASK) != BEACON_CRTP) ||
        (in.size > 1 && in.data[1] != BEACON_KIND)) {
        return ERR_START;
    }
    if (in.size < BEACON_BYTES) {
        return ERR_SHORT;
    }
    *beacon = (beacon_t){.sequence = load32_le(in.data + 2), .host_us = load64_le(in.data + 6)};
    return BEACON_BYTES;
}
