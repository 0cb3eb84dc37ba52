#include "app.h"

#include "parts.h"

#include <string.h>

int esp32_init(esp32_t *self, const esp32_config_t *config, instant_t now) {
    if (config->host_on_uart > 1 || config->bridge > 1 || config->host_on_uart + config->bridge > 1) {
        return ERR_VALUE;
    }
    memset(self, 0, sizeof *self);
    self->config = *config;
    self->to_uart = (esp32_queue_t){.slots = self->to_uart_slots, .capacity = ESP32_TO_UART};
    self->to_spi = (esp32_queue_t){.slots = self->to_spi_slots, .capacity = ESP32_TO_SPI};
    self->to_tcp = (esp32_queue_t){.slots = self->to_tcp_slots, .capacity = ESP32_TO_TCP};
    self->client_next_us = now.up_us;
    cpx_uart_init(&self->uart2, now.up_us);
    cpx_tcp_rx_init(&self->tcp_rx);
    esp32_images_reset(self);
    if (config->bridge) {
        esp32_bridge_init(self);
    } else {
        esp32_tell_boot(self);
    }
    return 0;
}

static esp32_queue_t *queue_of(esp32_t *self, esp32_port_t port) {
    switch (port) {
    case ESP32_PORT_UART2:
        return &self->to_uart;
    case ESP32_PORT_SPI:
        return &self->to_spi;
    default:
        return &self->to_tcp;
    }
}

static bool has_route(const cpx_packet_t *packet, uint8_t source, uint8_t destination) {
    return packet->route.source == source && packet->route.destination == destination &&
           packet->route.function == CPX_APP;
}

/// True when done with it: forwarded, handled, or dropped and counted. False when it needs room that is not
/// there.
static bool route(esp32_t *self, const cpx_packet_t *packet, esp32_port_t from, uint64_t now_us) {
    if (!cpx_route_ok(&packet->route)) {
        self->packets_unroutable++;
        return true;
    }
    if (packet->data.size == 0) {
        self->packets_empty++;
        return true;
    }
    if (packet->route.destination == CPX_ESP32) {
        return esp32_local(self, packet, now_us);
    }
    esp32_queue_t *queue = esp32_queue_to(self, packet->route.destination);
    if (queue == NULL || queue == queue_of(self, from)) {
        self->packets_unroutable++;
        return true;
    }
    if (packet->route.destination == CPX_HOST && !self->client) {
        self->packets_unsent++;
        return true;
    }
    if (from == ESP32_PORT_SPI && has_route(packet, CPX_GAP8, CPX_HOST) && esp32_images_take(self, packet)) {
        return true;
    }
    if (has_route(packet, CPX_STM32, CPX_HOST) && esp32_reports_unasked(self, packet->data)) {
        return true;
    }
    if (!esp32_queue_push(queue, packet)) {
        return false;
    }
    self->packets_forwarded++;
    esp32_asked(self, packet);
    return true;
}

static void hold(esp32_held_t *held, const cpx_packet_t *packet, uint64_t until_us) {
    (void)esp32_packet_store(&held->packet, packet); // it came over a link, so it fits
    held->until_us = until_us;
}

/// Tries again to find room for a held packet. True when none is held any more.
static bool release(esp32_t *self, esp32_held_t *held, esp32_port_t from, uint64_t now_us) {
    if (held->packet.size == 0) {
        return true;
    }
    const cpx_packet_t packet = esp32_packet_view(&held->packet);
    if (!route(self, &packet, from, now_us)) {
        if (now_us < held->until_us) {
            return false;
        }
        self->packets_dropped++;
    }
    held->packet.size = 0;
    if (from == ESP32_PORT_UART2) {
        cpx_uart_accept(&self->uart2);
    }
    return true;
}

/// Everything that was on its way to or from the old client goes.
static void set_client(esp32_t *self, bool on, uint64_t now_us) {
    self->packets_unsent += self->to_tcp.fill;
    self->to_tcp.fill = 0;
    self->packet_sent = 0;
    esp32_images_reset(self);
    cpx_tcp_rx_clear(&self->tcp_rx);
    self->packets_dropped += self->from_tcp.packet.size > 0;
    self->from_tcp.packet.size = 0;
    self->bridged_fill = 0;
    self->native = false;
    self->reports = false;
    self->client = on;
    if (!self->config.bridge) {
        self->client_next_us = now_us + ESP32_CLIENT_REPEAT_US;
        esp32_tell_client(self);
    }
}

static void receive_uart(esp32_t *self, bytes_t in, uint64_t now_us) {
    for (size_t i = 0; i < in.size; i++) {
        cpx_packet_t packet;
        const bool complete = cpx_uart_receive(&self->uart2, in.data[i], now_us, &packet);
        if (self->config.host_on_uart && !self->client &&
            self->uart2.packets_in + self->uart2.credits_in > 0) {
            set_client(self, true, now_us);
        }
        if (!complete) {
            continue;
        }
        if (!release(self, &self->from_uart, ESP32_PORT_UART2, now_us)) {
            self->packets_dropped++; // it came without a credit
        } else if (route(self, &packet, ESP32_PORT_UART2, now_us)) {
            cpx_uart_accept(&self->uart2);
        } else {
            hold(&self->from_uart, &packet, now_us + ESP32_HOLD_UART_US);
        }
    }
}

static void receive_spi(esp32_t *self, bytes_t in, uint64_t now_us) {
    cpx_packet_t packet;
    if (self->config.bridge) {
        esp32_bridge_receive_spi(self, in);
    } else if (cpx_link_decode(in, &packet) < 0) {
        self->spi_errors++;
    } else if (load16_le(in.data) > 0 && !route(self, &packet, ESP32_PORT_SPI, now_us)) {
        self->packets_dropped++;
    }
}

static size_t receive_tcp(esp32_t *self, bytes_t in, uint64_t now_us) {
    bytes_t rest = in;
    cpx_packet_t packet;
    if (!self->client || self->config.host_on_uart) {
        return in.size; // of a connection that has just gone
    }
    if (self->config.bridge) {
        return esp32_bridge_receive_tcp(self, in);
    }
    self->tcp_heard_us = now_us;
    while (release(self, &self->from_tcp, ESP32_PORT_TCP, now_us) &&
           cpx_tcp_rx(&self->tcp_rx, &rest, &packet)) {
        if (!route(self, &packet, ESP32_PORT_TCP, now_us)) {
            hold(&self->from_tcp, &packet, now_us + ESP32_HOLD_TCP_US);
        }
    }
    return in.size - rest.size;
}

static void receive_network(esp32_t *self, bytes_t in, uint64_t now_us) {
    if (in.size == 0 || self->config.host_on_uart) {
        return;
    }
    switch (in.data[0]) {
    case NETWORK_UP:
        self->network_up = true;
        if (in.size >= 6 && in.data[5] == 1) {
            esp32_tell_address(self, in.data + 1);
        }
        break;
    case NETWORK_CLIENT:
        set_client(self, true, now_us);
        break;
    case NETWORK_DOWN:
        self->network_up = false;
        self->network_started = self->network_start_waits;
        if (self->client) {
            set_client(self, false, now_us);
        }
        break;
    case NETWORK_CLIENT_GONE:
        if (self->client) {
            set_client(self, false, now_us);
        }
        break;
    default:
        break;
    }
}

int esp32_receive(esp32_t *self, esp32_port_t port, bytes_t in, instant_t now) {
    switch (port) {
    case ESP32_PORT_UART2:
        if (!self->config.bridge) {
            receive_uart(self, in, now.up_us);
        }
        break;
    case ESP32_PORT_SPI:
        receive_spi(self, in, now.up_us);
        break;
    case ESP32_PORT_TCP:
        return (int)receive_tcp(self, in, now.up_us);
    case ESP32_PORT_NETWORK:
        receive_network(self, in, now.up_us);
        break;
    default:
        break;
    }
    return (int)in.size;
}

/// When the packet that the host has begun is given up.
static uint64_t tcp_gap_us(const esp32_t *self) {
    const bool waits = cpx_tcp_rx_waits(&self->tcp_rx) && self->from_tcp.packet.size == 0;
    return waits ? self->tcp_heard_us + ESP32_TCP_GAP_US : NEVER_US;
}

static void run_timers(esp32_t *self, uint64_t now_us) {
    (void)release(self, &self->from_uart, ESP32_PORT_UART2, now_us);
    if (self->from_tcp.packet.size > 0) {
        (void)receive_tcp(self, (bytes_t){0}, now_us);
    }
    while (now_us >= tcp_gap_us(self)) { // ends: each turn skips a byte
        const uint64_t heard_us = self->tcp_heard_us;
        cpx_tcp_rx_give_up(&self->tcp_rx);
        (void)receive_tcp(self, (bytes_t){0}, now_us);
        self->tcp_heard_us = heard_us;
    }
    if (now_us >= self->client_next_us) {
        const bool news = self->ssid_size == 0 && !self->config.host_on_uart;
        self->client_next_us = now_us + (news ? ESP32_NEWS_REPEAT_US : ESP32_CLIENT_REPEAT_US);
        esp32_repeat_client(self);
    }
    if (self->native && now_us >= self->status_next_us) {
        self->status_next_us = now_us + ESP32_STATUS_US;
        esp32_send_status(self, now_us);
    }
}

size_t esp32_transmit(esp32_t *self, esp32_port_t port, bytes_mut_t out, instant_t now) {
    if (out.size == 0) {
        return 0;
    }
    switch (port) {
    case ESP32_PORT_UART2:
        if (self->config.bridge) {
            return 0;
        }
        // Here, at the port that is asked first, so that what is queued now goes out in the same round.
        run_timers(self, now.up_us);
        return esp32_output_uart(self, out, now.up_us);
    case ESP32_PORT_SPI:
        return self->config.bridge ? esp32_bridge_output_spi(self, out) : esp32_output_spi(self, out);
    case ESP32_PORT_TCP:
        return esp32_output_tcp(self, out);
    case ESP32_PORT_NETWORK:
        return esp32_output_network(self, out);
    default:
        return 0;
    }
}

static uint64_t earlier(uint64_t a_us, uint64_t b_us) {
    return a_us < b_us ? a_us : b_us;
}

static uint64_t held_until_us(const esp32_held_t *held) {
    return held->packet.size > 0 ? held->until_us : NEVER_US;
}

uint64_t esp32_deadline(const esp32_t *self) {
    if (self->config.bridge) {
        return NEVER_US; // it only ever answers what comes
    }
    uint64_t deadline_us = earlier(held_until_us(&self->from_uart), held_until_us(&self->from_tcp));
    deadline_us = earlier(deadline_us, earlier(self->client_next_us, tcp_gap_us(self)));
    if (self->native) {
        deadline_us = earlier(deadline_us, self->status_next_us);
    }
    // Inside a frame the caller comes by itself when the last byte has left.
    if (self->uart2.tx_sent == 0 && self->uart2.credit_sent == 0) {
        deadline_us = earlier(deadline_us, esp32_output_loads(self) ? 0 : cpx_uart_deadline(&self->uart2));
    }
    return deadline_us;
}
