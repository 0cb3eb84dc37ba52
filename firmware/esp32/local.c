#include "parts.h"

#include <string.h>

enum { KEY_MIN = 8, ADDRESS_BYTES = 4 };

esp32_queue_t *esp32_queue_to(esp32_t *self, uint8_t target) {
    const bool host_on_uart = self->config.host_on_uart != 0;
    switch (target) {
    case CPX_STM32:
        return host_on_uart ? NULL : &self->to_uart;
    case CPX_HOST:
        return host_on_uart ? &self->to_uart : &self->to_tcp;
    case CPX_GAP8:
        return &self->to_spi;
    default:
        return NULL;
    }
}

/// False when there is a way and no room on it.
static bool send(esp32_t *self, uint8_t target, uint8_t function, bytes_t data) {
    esp32_queue_t *queue = esp32_queue_to(self, target);
    if (queue == NULL || (target == CPX_HOST && !self->client)) {
        self->packets_unsent++;
        return true;
    }
    const cpx_packet_t packet = {
        .route = {.destination = target, .source = CPX_ESP32, .function = function, .last_packet = true},
        .data = data,
    };
    return esp32_queue_push(queue, &packet);
}

static void tell(esp32_t *self, uint8_t target, uint8_t function, bytes_t data) {
    self->packets_dropped += send(self, target, function, data) ? 0 : 1;
}

static void tell_client(esp32_t *self, uint8_t target, bool client) {
    const uint8_t data[] = {WIFI_CLIENT_CONNECTED, client};
    tell(self, target, CPX_WIFI_CTRL, (bytes_t){data, sizeof data});
}

void esp32_tell_client(esp32_t *self) {
    tell_client(self, CPX_GAP8, self->client);
    if (!self->config.host_on_uart) {
        tell_client(self, CPX_STM32, self->client);
    }
}

void esp32_repeat_client(esp32_t *self) {
    if (self->to_spi.fill == 0) {
        tell_client(self, CPX_GAP8, self->client);
    }
    if (self->to_uart.fill == 0 && !self->config.host_on_uart) {
        tell_client(self, CPX_STM32, self->client);
    }
}

void esp32_tell_new_client(esp32_t *self) {
    if (self->to_spi.fill == 0) {
        tell_client(self, CPX_GAP8, false);
        tell_client(self, CPX_GAP8, true);
    }
}

void esp32_tell_address(esp32_t *self, const uint8_t address[4]) {
    uint8_t data[1 + ADDRESS_BYTES] = {WIFI_CONNECTED};
    memcpy(data + 1, address, ADDRESS_BYTES);
    tell(self, CPX_GAP8, CPX_WIFI_CTRL, (bytes_t){data, sizeof data});
    tell(self, CPX_STM32, CPX_WIFI_CTRL, (bytes_t){data, sizeof data});
}

void esp32_tell_boot(esp32_t *self) {
    const uint8_t data[] = {BOOTLOADER_JUMP};
    tell(self, CPX_GAP8, CPX_BOOTLOADER, (bytes_t){data, sizeof data});
}

void esp32_send_status(esp32_t *self, uint64_t now_us) {
    const native_status_t status = {
        .up_us = now_us,
        .frames_forwarded = self->frames_forwarded,
        .frames_dropped = self->frames_dropped,
        .frames_cut = self->frames_cut,
        .packets_forwarded = self->packets_forwarded,
        .packets_dropped = self->packets_dropped,
        .packets_unroutable = self->packets_unroutable,
        .uart_bad_check = self->uart2.bad_check,
        .uart_bad_length = self->uart2.bad_length,
        .uart_garbage_bytes = self->uart2.garbage_bytes,
        .uart_gaps = self->uart2.gaps,
        .spi_errors = self->spi_errors,
        .tcp_skipped_bytes = self->tcp_rx.skipped_bytes,
    };
    uint8_t data[NATIVE_STATUS_BYTES];
    native_status_encode(&status, data);
    tell(self, CPX_HOST, CPX_APP, (bytes_t){data, sizeof data});
}

void esp32_asked(esp32_t *self, const cpx_packet_t *packet) {
    const cpx_route_t *route = &packet->route;
    native_stream_t stream;
    if (route->source != CPX_HOST || route->function != CPX_APP) {
        return;
    }
    if (route->destination == CPX_GAP8) {
        esp32_images_asked(self, packet->data);
    } else if (native_stream_decode(packet->data, &stream) > 0) {
        self->reports = stream.dialect != 0;
    }
}

bool esp32_reports_unasked(esp32_t *self, bytes_t in) {
    native_log_t report;
    const bool unasked = !self->reports && native_log_decode(in, &report) > 0;
    self->packets_unsent += unasked;
    return unasked;
}

/// Keeps a setting; the network has to be started again if it is another one than before.
static void set_text(esp32_t *self, uint8_t *text, uint8_t *text_size, bytes_t in) {
    if (in.size == *text_size && memcmp(text, in.data, in.size) == 0) {
        return;
    }
    memcpy(text, in.data, in.size);
    *text_size = (uint8_t)in.size;
    self->network_started = false;
}

/// False for settings that cannot be used.
static bool handle_wifi(esp32_t *self, bytes_t in) {
    const bytes_t argument = {in.data + 1, in.size - 1};
    switch (in.data[0]) {
    case WIFI_SET_SSID:
        if (argument.size == 0 || argument.size > sizeof self->ssid) {
            return false;
        }
        set_text(self, self->ssid, &self->ssid_size, argument);
        return true;
    case WIFI_SET_KEY:
        if ((argument.size > 0 && argument.size < KEY_MIN) || argument.size > sizeof self->key) {
            return false;
        }
        set_text(self, self->key, &self->key_size, argument);
        return true;
    case WIFI_CONNECT: {
        if (argument.size == 0 || self->ssid_size == 0 || self->config.host_on_uart) {
            return false;
        }
        const uint8_t mode = argument.data[0] != 0;
        if (mode != self->mode || !self->network_started) {
            self->mode = mode;
            self->network_started = true;
            self->network_start_waits = true;
        }
        return true;
    }
    default:
        return false;
    }
}

bool esp32_local(esp32_t *self, const cpx_packet_t *packet, uint64_t now_us) {
    const bytes_t in = packet->data;
    const uint8_t source = packet->route.source;
    native_stream_t stream;
    switch (packet->route.function) {
    case CPX_TEST:
        if (in.data[0] == TEST_ECHO) {
            return send(self, source, CPX_TEST, in);
        }
        self->packets_unroutable += in.data[0] != TEST_SINK;
        return true;
    case CPX_SYSTEM:
        if (in.data[0] != SYSTEM_RESET_GAP8) {
            self->packets_unroutable++;
            return true;
        }
        if (!send(self, source, CPX_SYSTEM, (bytes_t){in.data, 1})) {
            return false;
        }
        self->network_reset_waits = true;
        self->gap8_resets++;
        return true;
    case CPX_WIFI_CTRL:
        self->wifi_refused += handle_wifi(self, in) ? 0 : 1;
        return true;
    case CPX_APP:
        if (source != CPX_HOST || native_stream_decode(in, &stream) < 0) {
            self->packets_unroutable++;
            return true;
        }
        self->native = stream.dialect != 0;
        self->status_next_us = now_us;
        return true;
    default:
        self->packets_unroutable++;
        return true;
    }
}
