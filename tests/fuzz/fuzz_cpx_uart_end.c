/// One end of UART2, whatever comes in and whenever: no byte is lost from the account, the deadline tells the
/// truth, and what goes out is always whole frames and credits.
#include "claim.h"

#include "firmware/core/cpx_uart.h"

enum { BYTE_US = 17, CREDIT_BYTES = 2, FRAME_EXTRA_BYTES = 5 };

typedef struct {
    cpx_uart_t end;
    cpx_uart_t peer; ///< hears all that the end sends, over a clean line
    uint64_t now_us;
    size_t in_bytes;
    size_t packet_bytes;
} line_t;

static void receive(line_t *self, uint8_t byte) {
    cpx_packet_t packet;
    const uint32_t bad_versions = self->end.bad_version;
    self->in_bytes++;
    if (cpx_uart_receive(&self->end, byte, self->now_us, &packet)) {
        CLAIM(packet.route.version == CPX_VERSION && packet.data.size <= CPX_DATA_UART_MAX);
        CLAIM(packet.data.data >= self->end.rx &&
              packet.data.data + packet.data.size < self->end.rx + sizeof self->end.rx);
        self->packet_bytes += packet.data.size + FRAME_EXTRA_BYTES;
    }
    const size_t waiting = (size_t)self->end.rx_fill - self->end.rx_taken;
    const size_t known =
        self->packet_bytes + CREDIT_BYTES * (size_t)self->end.credits_in + self->end.garbage_bytes + waiting;
    if (self->end.bad_version != bad_versions) {
        self->packet_bytes += self->in_bytes - known; // the frame of a wrong version
    } else {
        CLAIM(known == self->in_bytes);
    }
}

static void transmit(line_t *self, size_t most) {
    for (size_t i = 0; i < most; i++) {
        uint8_t byte = 0;
        const bool due = cpx_uart_deadline(&self->end) <= self->now_us;
        const size_t sent = cpx_uart_transmit(&self->end, &byte, self->now_us);
        CLAIM(sent == (due ? 1 : 0));
        if (sent == 0) {
            return;
        }
        self->now_us += BYTE_US;
        cpx_packet_t packet;
        if (cpx_uart_receive(&self->peer, byte, 0, &packet)) {
            cpx_uart_accept(&self->peer);
        }
        CLAIM(self->peer.garbage_bytes == 0);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    line_t line = {0};
    cpx_uart_init(&line.end, 0);
    cpx_uart_init(&line.peer, 0);
    // A byte says what to do, and how much of it: 0..63 bytes come in, and so on.
    for (size_t i = 0; i < size; i++) {
        const size_t amount = data[i] & 63U;
        switch (data[i] >> 6) {
        case 0:
            for (size_t end = i + amount; i < end && i + 1 < size; i++) {
                line.now_us += BYTE_US;
                receive(&line, data[i + 1]);
            }
            break;
        case 1:
            transmit(&line, amount * 4);
            break;
        case 2:
            line.now_us += amount * amount * 100;
            break;
        default:
            if (amount == 0) {
                cpx_uart_accept(&line.end);
            } else {
                const cpx_route_t route = {
                    .destination = CPX_ESP32, .source = CPX_STM32, .function = CPX_APP};
                const size_t data_size = amount * 2 < size - i ? amount * 2 : size - i;
                (void)cpx_uart_send(&line.end, &(cpx_packet_t){route, {data + i, data_size}});
            }
        }
    }
    CLAIM(line.peer.packets_in == line.end.packets_out);
    return 0;
}
