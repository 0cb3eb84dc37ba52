#include "app.h"

#include "parts.h"

#include <string.h>

int gap8_init(gap8_t *self, const gap8_config_t *config, instant_t now) {
    if (native_camera_check(&config->camera) != 0 || config->firmware > GAP8_NANOCOCKPIT ||
        (config->firmware == GAP8_NANOCOCKPIT && config->camera.encoding != IMAGE_RAW) ||
        config->stamp_bits > 64 || (config->stamp_bits > 0 && config->stamp_bits < 32) ||
        config->width > IMAGE_SIDE_MAX || config->height > IMAGE_SIDE_MAX ||
        (config->width > 0 && config->height == 0)) {
        return ERR_VALUE;
    }
    memset(self, 0, sizeof *self); // some compilers would make a literal of it on the stack
    self->config = *config;
    self->camera = config->camera;
    self->camera_next = config->camera;
    self->capturing = -1;
    self->sending = -1;
    self->capture_next_us = now.up_us;
    gap8_times_init(self);
    return 0;
}

static void send(gap8_t *self, uint8_t destination, uint8_t function, bytes_t data) {
    if (self->queue_fill == GAP8_QUEUE_PACKETS || data.size > GAP8_QUEUE_DATA) {
        self->packets_dropped++;
        return;
    }
    gap8_packet_t *packet = &self->queue[(self->queue_head + self->queue_fill) % GAP8_QUEUE_PACKETS];
    const cpx_route_t route = {
        .destination = destination, .source = CPX_GAP8, .function = function, .last_packet = true};
    cpx_route_encode(&route, packet->route);
    memcpy(packet->data, data.data, data.size);
    packet->size = (uint8_t)data.size;
    self->queue_fill++;
}

static void set_client(gap8_t *self, bool on, uint64_t now_us) {
    if (on == self->client) {
        return;
    }
    self->client = on;
    if (on) {
        gap8_captures_begin(self, now_us);
    } else {
        gap8_frames_drop(self);
        self->burst_left = 0;
        self->stream = (native_stream_t){0};
    }
}

static void reply(gap8_t *self, uint8_t destination, uint8_t request, uint8_t status) {
    uint8_t data[NATIVE_REPLY_BYTES];
    native_reply_encode(&(native_reply_t){request, status}, data);
    self->requests_refused += status != 0;
    send(self, destination, CPX_APP, (bytes_t){data, sizeof data});
}

/// The paper's camera settings: false if it is something else. Nothing answers them.
static bool handle_paper(gap8_t *self, const cpx_packet_t *packet, uint64_t now_us) {
    paper_camera_t asked;
    if (paper_camera_decode(packet->data, &asked) < 0) {
        return false;
    }
    uint16_t lines =
        asked.exposure_lines < PAPER_CAMERA_LINES_MAX ? asked.exposure_lines : PAPER_CAMERA_LINES_MAX;
    lines = lines < PAPER_CAMERA_LINES_MIN ? PAPER_CAMERA_LINES_MIN : lines;
    const native_camera_t camera = {
        .auto_exposure = asked.auto_exposure,
        .analog_gain = asked.analog_gain,
        .digital_gain = asked.digital_gain,
        .burst = asked.burst,
        .encoding = asked.encoding,
        .exposure_lines = lines,
        .frame_period_us = self->camera_next.frame_period_us,
    };
    if (native_camera_check(&camera) != 0) {
        self->requests_refused++;
    } else {
        gap8_captures_set(self, &camera, now_us);
    }
    return true;
}

/// Native requests: false if it is none, or from somebody who may not ask.
static bool handle_request(gap8_t *self, const cpx_packet_t *packet, uint64_t now_us) {
    const uint8_t source = packet->route.source;
    native_camera_t camera;
    if (self->config.firmware != GAP8_NATIVE) {
        return self->config.firmware == GAP8_PAPER && handle_paper(self, packet, now_us);
    }
    if ((source == CPX_HOST || source == CPX_STM32) && native_camera_decode(packet->data, &camera) > 0) {
        const uint8_t refused = native_camera_check(&camera);
        if (refused == 0) {
            gap8_captures_set(self, &camera, now_us);
        }
        reply(self, source, NATIVE_CAMERA, refused);
        return true;
    }
    native_stream_t stream;
    const int result = native_stream_decode(packet->data, &stream);
    if (source != CPX_HOST || (result < 0 && result != ERR_VALUE)) {
        return false;
    }
    if (result == ERR_VALUE) {
        reply(self, source, NATIVE_STREAM, packet->data.data[2] > 1 ? 1 : 2); // dialect, data_max
        return true;
    }
    self->stream = stream;
    reply(self, source, NATIVE_STREAM, 0);
    return true;
}

/// False for a packet that means nothing here.
static bool handle(gap8_t *self, const cpx_packet_t *packet, uint64_t now_us) {
    const bytes_t in = packet->data;
    if (!cpx_route_ok(&packet->route) || packet->route.destination != CPX_GAP8 || in.size == 0) {
        return false;
    }
    switch (packet->route.function) {
    case CPX_WIFI_CTRL:
        if (in.data[0] == WIFI_CLIENT_CONNECTED && in.size >= 2) {
            set_client(self, in.data[1] != 0, now_us);
            return true;
        }
        return in.data[0] == WIFI_CONNECTED && in.size >= 5;
    case CPX_APP:
        return handle_request(self, packet, now_us);
    case CPX_TEST:
        if (in.data[0] == TEST_ECHO) {
            send(self, packet->route.source, CPX_TEST, in);
        }
        return in.data[0] == TEST_SINK || in.data[0] == TEST_ECHO;
    case CPX_BOOTLOADER:
        return in.data[0] == BOOTLOADER_JUMP; // the app is what it jumps to
    default:
        return false;
    }
}

static void receive_spi(gap8_t *self, bytes_t in, instant_t now) {
    cpx_packet_t packet;
    const bool nanocockpit = self->config.firmware == GAP8_NANOCOCKPIT;
    const int result = nanocockpit ? nanocockpit_link_decode(in, &packet) : cpx_link_decode(in, &packet);
    if (result < 0) {
        self->spi_errors++;
    } else if (load16_le(in.data) > 0) {
        const bool known = nanocockpit ? gap8_buffers_receive(self, &packet, now.stamp_us)
                                       : handle(self, &packet, now.up_us);
        self->packets_unknown += known ? 0 : 1;
    }
}

int gap8_receive(gap8_t *self, gap8_port_t port, bytes_t in, instant_t now) {
    if (port == GAP8_PORT_UART1) {
        gap8_times_receive(self, in, now);
    } else if (port == GAP8_PORT_SPI) {
        receive_spi(self, in, now);
    } else if (port == GAP8_PORT_CAMERA) {
        gap8_captures_expire(self, now.up_us);
        gap8_captures_end(self, in, now.stamp_us);
    }
    return (int)in.size;
}

static size_t transmit_spi(gap8_t *self, bytes_mut_t out) {
    const bool nanocockpit = self->config.firmware == GAP8_NANOCOCKPIT;
    if (out.size < (size_t)(nanocockpit ? NANOCOCKPIT_FRAME_MAX : CPX_LINK_FRAME_MAX)) {
        return 0;
    }
    if (self->queue_fill == 0) {
        return gap8_frames_packet(self, out);
    }
    const gap8_packet_t *first = &self->queue[self->queue_head];
    cpx_packet_t packet = {.data = {first->data, first->size}};
    cpx_route_decode(first->route, &packet.route);
    self->queue_head = (uint8_t)((self->queue_head + 1) % GAP8_QUEUE_PACKETS);
    self->queue_fill--;
    return cpx_link_encode(&packet, out);
}

size_t gap8_transmit(gap8_t *self, gap8_port_t port, bytes_mut_t out, instant_t now) {
    if (port == GAP8_PORT_UART1) {
        return gap8_echo_transmit(self, out, now.stamp_us);
    }
    gap8_captures_expire(self, now.up_us);
    switch (port) {
    case GAP8_PORT_SPI:
        return transmit_spi(self, out);
    case GAP8_PORT_CAMERA:
        return gap8_captures_command(self, out, now.up_us);
    default:
        return 0;
    }
}

uint64_t gap8_deadline(const gap8_t *self) {
    return gap8_captures_deadline(self);
}
