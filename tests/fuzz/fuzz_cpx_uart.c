/// A UART frame that decodes encodes to the same bytes; a credit or a refusal leaves the packet alone.
#include "claim.h"

#include "firmware/core/cpx_uart.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    cpx_packet_t packet;
    memset(&packet, POISON, sizeof packet);
    const int used = cpx_uart_decode((bytes_t){data, size}, &packet);
    if (used <= 2) {
        CLAIM(used < 0 || (used == 2 && data[0] == CPX_UART_START && data[1] == 0));
        CLAIM(untouched(&packet, sizeof packet));
        return 0;
    }
    CLAIM((size_t)used <= size && used <= CPX_UART_FRAME_MAX);
    uint8_t out[CPX_UART_FRAME_MAX];
    CLAIM(cpx_uart_encode(&packet, (bytes_mut_t){out, sizeof out}) == (size_t)used);
    CLAIM(memcmp(out, data, (size_t)used) == 0);
    return 0;
}
