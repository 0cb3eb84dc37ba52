/// The ESP32's app, whatever comes over UART2, SPI, TCP and from the network: each of its links carries good
/// packets only, and once it has sent all it has, its deadline lies ahead.
#include "claim.h"
#include "input.h"

#include "firmware/esp32/app.h"

enum { SENT_AT_ONCE_MAX = 20000, TCP_PIECE_MAX = 300 };

typedef struct {
    esp32_t app;
    instant_t now;
    cpx_uart_t stm32;
    cpx_tcp_rx_t host;
    size_t bridge_left; ///< of the packet under way to the host
    uint8_t bridge_head[CPX_LINK_HEADER_BYTES];
    uint8_t bridge_head_fill;
} bench_t;

static bool hear_uart(bench_t *self) {
    uint8_t byte;
    if (esp32_transmit(&self->app, ESP32_PORT_UART2, (bytes_mut_t){&byte, 1}, self->now) == 0) {
        return false;
    }
    cpx_packet_t packet;
    if (cpx_uart_receive(&self->stm32, byte, 0, &packet)) {
        CLAIM(cpx_route_ok(&packet.route) && packet.data.size > 0);
        cpx_uart_accept(&self->stm32);
    }
    CLAIM(self->stm32.garbage_bytes == 0);
    return true;
}

/// False when there is nothing but the idle header.
static bool hear_spi(bench_t *self) {
    uint8_t out[NANOCOCKPIT_FRAME_MAX];
    const size_t size = esp32_transmit(&self->app, ESP32_PORT_SPI, (bytes_mut_t){out, sizeof out}, self->now);
    if (size == 0) {
        return false;
    }
    cpx_packet_t packet;
    const bytes_t window = {out, size};
    const bool bridge = self->app.config.bridge != 0;
    CLAIM((bridge ? nanocockpit_link_decode(window, &packet) : cpx_link_decode(window, &packet)) ==
          (int)size);
    if (load16_le(out) == 0) {
        return false;
    }
    CLAIM(cpx_route_ok(&packet.route) && packet.data.size > 0);
    CLAIM(bridge || packet.route.destination == CPX_GAP8);
    return true;
}

/// Headers of NanoCockpit's follow each other at the distances that they state.
static void hear_bridge(bench_t *self, bytes_t in) {
    while (in.size > 0) {
        if (self->bridge_left > 0) {
            self->bridge_left -= take(&in, self->bridge_left).size;
            continue;
        }
        self->bridge_head[self->bridge_head_fill++] = take_byte(&in);
        if (self->bridge_head_fill == CPX_LINK_HEADER_BYTES) {
            self->bridge_head_fill = 0;
            self->bridge_left = load16_le(self->bridge_head);
            CLAIM(self->bridge_left >= 1 && self->bridge_left <= NANOCOCKPIT_DATA_MAX);
        }
    }
}

static bool hear_tcp(bench_t *self, size_t most) {
    uint8_t out[TCP_PIECE_MAX];
    const size_t size = esp32_transmit(&self->app, ESP32_PORT_TCP, (bytes_mut_t){out, most}, self->now);
    CLAIM(size <= most);
    if (self->app.config.bridge) {
        hear_bridge(self, (bytes_t){out, size});
        return size > 0;
    }
    bytes_t in = {out, size};
    cpx_packet_t packet;
    while (cpx_tcp_rx(&self->host, &in, &packet)) {
        CLAIM(packet.route.destination == CPX_HOST && packet.data.size > 0);
    }
    CLAIM(self->host.skipped_bytes == 0);
    return size > 0;
}

static bool hear_network(bench_t *self) {
    uint8_t out[128];
    const size_t size =
        esp32_transmit(&self->app, ESP32_PORT_NETWORK, (bytes_mut_t){out, sizeof out}, self->now);
    if (size == 0) {
        return false;
    }
    CLAIM(size == 1 ? out[0] == NETWORK_RESET_GAP8
                    : out[0] == NETWORK_START && size == 4U + out[2] + out[3 + out[2]]);
    return true;
}

static void send_all(bench_t *self) {
    bool sent = true;
    for (int i = 0; sent; i++) {
        CLAIM(i < SENT_AT_ONCE_MAX);
        sent = hear_uart(self);
        sent = hear_spi(self) || sent;
        sent = hear_tcp(self, TCP_PIECE_MAX) || sent;
        sent = hear_network(self) || sent;
    }
    CLAIM(esp32_deadline(&self->app) > self->now.up_us);
}

static void receive(bench_t *self, esp32_port_t port, bytes_t in) {
    const int taken = esp32_receive(&self->app, port, in, self->now);
    CLAIM(taken >= 0 && (size_t)taken <= in.size);
    CLAIM(port == ESP32_PORT_TCP || (size_t)taken == in.size);
    if (port == ESP32_PORT_NETWORK && in.size > 0 && in.data[0] >= NETWORK_CLIENT &&
        in.data[0] <= NETWORK_DOWN) {
        cpx_tcp_rx_init(&self->host); // another host, which gets nothing of what the last one had begun
        self->bridge_left = 0;
        self->bridge_head_fill = 0;
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static bench_t bench;
    bytes_t input = {data, size};
    memset(&bench.now, 0, sizeof bench.now);
    cpx_uart_init(&bench.stm32, 0);
    cpx_tcp_rx_init(&bench.host);
    bench.bridge_left = 0;
    bench.bridge_head_fill = 0;
    const uint8_t wires = take_byte(&input);
    const esp32_config_t config = {.host_on_uart = wires & 1U, .bridge = (wires & 3U) == 2};
    CLAIM(esp32_init(&bench.app, &config, bench.now) == 0);
    while (input.size > 0) {
        const uint8_t choice = take_byte(&input);
        const size_t amount = choice >> 3;
        switch (choice & 7U) {
        case 0:
        case 1:
        case 2:
        case 3:
            receive(&bench, (esp32_port_t)(choice & 3U), take(&input, amount * 4));
            break;
        case 4:
            bench.now.up_us += take_us(&input);
            break;
        case 5:
            (void)hear_tcp(&bench, amount);
            break;
        case 6:
            for (size_t i = 0; i < amount * 4 && hear_uart(&bench); i++) {}
            break;
        default:
            send_all(&bench);
        }
    }
    send_all(&bench);
    return 0;
}
