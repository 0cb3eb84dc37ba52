/// Each message of the paper's firmware and of NanoCockpit that decodes encodes to the same bytes (spare ones
/// as 0); a refusal leaves the output alone. On UART1 each byte is in a message, garbage, or waiting, and
/// each message found is really there.
#include "claim.h"

#include "firmware/core/uart1.h"

/// Decodes `in` as one type of message and claims what the first line says. `spare` to `spare_end` is not
/// judged.
#define ROUND_TRIP(type, decode, bytes, spare, spare_end)                                                    \
    static void type##_round_trip(bytes_t in) {                                                              \
        type##_t read;                                                                                       \
        memset(&read, POISON, sizeof read);                                                                  \
        const int used = decode(in, &read);                                                                  \
        if (used < (bytes)) {                                                                                \
            CLAIM(untouched(&read, sizeof read));                                                            \
            return;                                                                                          \
        }                                                                                                    \
        CLAIM((size_t)used <= in.size);                                                                      \
        if (used > (bytes)) {                                                                                \
            return;                                                                                          \
        }                                                                                                    \
        uint8_t out[bytes];                                                                                  \
        type##_encode(&read, out);                                                                           \
        CLAIM(memcmp(out, in.data, spare) == 0);                                                             \
        CLAIM(memcmp(out + (spare_end), in.data + (spare_end), (bytes) - (spare_end)) == 0);                 \
    }

ROUND_TRIP(paper_stamp, paper_stamp_decode, PAPER_STAMP_BYTES, 0, 0)
ROUND_TRIP(paper_header, paper_header_decode, PAPER_HEADER_BYTES, 0, 0)
ROUND_TRIP(paper_camera, paper_camera_decode, PAPER_CAMERA_BYTES, 0, 0)
ROUND_TRIP(nanocockpit_state, nanocockpit_uart_decode, NANOCOCKPIT_STATE_BYTES, 0, 0)
ROUND_TRIP(nanocockpit_begin, nanocockpit_begin_decode, NANOCOCKPIT_BEGIN_BYTES, 10, 12)
ROUND_TRIP(nanocockpit_metadata, nanocockpit_metadata_decode, NANOCOCKPIT_METADATA_BYTES, 53, 56)
ROUND_TRIP(nanocockpit_reply, nanocockpit_reply_decode, NANOCOCKPIT_REPLY_BYTES, 5, 25)

static void link_round_trip(bytes_t in) {
    cpx_packet_t packet;
    memset(&packet, POISON, sizeof packet);
    const int used = nanocockpit_link_decode(in, &packet);
    if (used < 0) {
        CLAIM(untouched(&packet, sizeof packet));
        return;
    }
    CLAIM(packet.data.data == in.data + 4 && (size_t)used == packet.data.size + 4);
    CLAIM(packet.data.size <= NANOCOCKPIT_DATA_MAX && (size_t)used <= in.size);
    uint8_t out[4];
    nanocockpit_link_header(&packet.route, packet.data.size, out);
    CLAIM(memcmp(out, in.data, sizeof out) == 0);
}

static void search(bytes_t in, uint8_t kinds) {
    uart1_rx_t rx;
    size_t in_messages = 0;
    uart1_rx_init(&rx, kinds);
    for (size_t i = 0; i < in.size; i++) {
        uart1_message_t message;
        uart1_rx_put(&rx, in.data[i]);
        while (uart1_rx_take(&rx, &message)) {
            uint8_t out[PAPER_STAMP_BYTES];
            const uint8_t *there = in.data + i + 1 - rx.fill - message.size;
            CLAIM((message.kind & kinds) != 0);
            in_messages += message.size;
            switch (message.kind) {
            case UART1_STAMP:
                stamp_encode(&message.stamp, out);
                break;
            case UART1_PAPER:
                paper_stamp_encode(&message.paper, out);
                break;
            case UART1_ECHO:
                echo_answer_encode(&message.echo, out);
                break;
            default:
                CLAIM(message.kind == UART1_NANOCOCKPIT);
                if (message.size != NANOCOCKPIT_STATE_BYTES) {
                    continue;
                }
                nanocockpit_state_encode(&message.state, out);
            }
            CLAIM(memcmp(out, there, message.size) == 0);
        }
        CLAIM(rx.fill < UART1_MESSAGE_MAX);
        CLAIM(in_messages + rx.garbage_bytes + rx.fill == i + 1);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const bytes_t in = {data, size};
    paper_stamp_round_trip(in);
    paper_header_round_trip(in);
    paper_camera_round_trip(in);
    nanocockpit_state_round_trip(in);
    nanocockpit_begin_round_trip(in);
    nanocockpit_metadata_round_trip(in);
    nanocockpit_reply_round_trip(in);
    link_round_trip(in);
    if (size > 0) {
        search((bytes_t){data + 1, size - 1}, data[0] & UART1_ALL);
    }
    return 0;
}
