#include "app.h"

#include "parts.h"

#include <string.h>

enum { COMMAND_BYTES_MAX = 1 + 64, TEXT_BYTES_MAX = 24 };

static bool has_nul(const char *text, size_t size) {
    return memchr(text, 0, size) != NULL;
}

static uint64_t stamp_period_us(const stm32_t *self) {
    const uint32_t period_us = self->config.stamp_period_us;
    return period_us == 0 ? STAMP_PERIOD_US : period_us;
}

// The verbs are not inlined, so that sizes and faults are told by their names.
__attribute__((noinline)) int stm32_init(stm32_t *self, const stm32_config_t *config, instant_t now) {
    if (config->wifi_mode > 2 || config->stamp_format > STM32_NANOCOCKPIT_US ||
        !has_nul(config->wifi_ssid, sizeof config->wifi_ssid) ||
        !has_nul(config->wifi_key, sizeof config->wifi_key)) {
        return ERR_VALUE;
    }
    // Not as one value: a copy of all this would not fit the stack.
    memset(self, 0, offsetof(stm32_t, log_ring));
    self->config = *config;
    self->stamp_next_us = config->stamp_period_us == UINT32_MAX ? NEVER_US : now.up_us;
    self->wifi_next_us = config->wifi_mode == 0 ? NEVER_US : now.up_us;
    self->crtp_next_us = NEVER_US;
    self->report_next_us = NEVER_US;
    crtp_log_reset(&self->telemetry);
    self->mocap_next_us = config->mocap_period_us == 0 ? NEVER_US : now.up_us;
    const motion_t moves = motion_at(&config->pose, config->sway_m, now.up_us);
    self->attitude = attitude_of(&moves.pose); // it only sways
    self->table = stm32_table();
    cpx_uart_init(&self->uart2, now.up_us);
    stm32_log_init(&self->log, &config->log, &self->table, self->log_ring);
    return 0;
}

void stm32_send(stm32_t *self, uint8_t destination, uint8_t function, bytes_t data) {
    if (self->queue_fill == STM32_QUEUE_PACKETS || data.size > CPX_DATA_UART_MAX) {
        self->packets_dropped++;
        return;
    }
    stm32_packet_t *packet = &self->queue[(self->queue_head + self->queue_fill) % STM32_QUEUE_PACKETS];
    const cpx_route_t route = {.destination = destination, .source = CPX_STM32, .function = function};
    cpx_route_encode(&route, packet->route);
    memcpy(packet->data, data.data, data.size);
    packet->size = (uint8_t)data.size;
    self->queue_fill++;
}

static void send_command(stm32_t *self, uint8_t command, const char *argument, size_t size) {
    uint8_t data[COMMAND_BYTES_MAX] = {command};
    memcpy(data + 1, argument, size);
    stm32_send(self, CPX_ESP32, CPX_WIFI_CTRL, (bytes_t){data, 1 + size});
}

static void set_up_wifi(stm32_t *self) {
    if (self->queue_fill > 0) {
        return; // the ESP32 has not taken what was sent last
    }
    const stm32_config_t *config = &self->config;
    const char access_point = config->wifi_mode == 1;
    send_command(self, WIFI_SET_SSID, config->wifi_ssid, strlen(config->wifi_ssid));
    if (config->wifi_key[0] != 0) {
        send_command(self, WIFI_SET_KEY, config->wifi_key, strlen(config->wifi_key));
    }
    send_command(self, WIFI_CONNECT, &access_point, 1);
}

static void send_crtp(stm32_t *self) {
    uint8_t text[TEXT_BYTES_MAX] = "\0crtp "; // CRTP header 0: port 0, console
    size_t size = 6;
    uint32_t divisor = 1;
    while (self->crtp_sequence / divisor >= 10) {
        divisor *= 10;
    }
    for (; divisor > 0; divisor /= 10) {
        text[size++] = (uint8_t)('0' + self->crtp_sequence / divisor % 10);
    }
    text[size++] = '\n';
    self->crtp_sequence++;
    stm32_send(self, CPX_HOST, CPX_CRTP, (bytes_t){text, size});
}

static void run_timers(stm32_t *self, instant_t now) {
    const uint64_t now_us = now.up_us;
    if (now_us >= self->wifi_next_us) {
        set_up_wifi(self);
        self->wifi_next_us = now_us + STM32_WIFI_RETRY_US;
    }
    if (now_us >= self->crtp_next_us) {
        send_crtp(self);
        self->crtp_next_us = next_on_grid(self->crtp_next_us, self->config.crtp_period_us, now_us);
    }
    if (stm32_log_runs(&self->log)) {
        stm32_log_rows(self, now);
    }
}

static void set_bridge(stm32_t *self, bool on, uint64_t now_us) {
    if (on != self->bridge && self->config.crtp_period_us > 0) {
        self->crtp_next_us = on ? now_us : NEVER_US;
    }
    self->bridge = on;
}

static void set_client(stm32_t *self, bool on, uint64_t now_us) {
    self->client = on;
    if (on) {
        self->wifi_next_us = NEVER_US;
        return;
    }
    self->report_next_us = NEVER_US;
    crtp_log_reset(&self->telemetry);
    set_bridge(self, false, now_us);
    if (self->config.wifi_mode != 0) {
        self->wifi_next_us = now_us; // the ESP32 may have started anew and know no settings
    }
}

/// False for a packet that means nothing here.
static bool handle(stm32_t *self, const cpx_packet_t *packet, instant_t now) {
    const bytes_t in = packet->data;
    if (!cpx_route_ok(&packet->route) || packet->route.destination != CPX_STM32 || in.size == 0) {
        return false;
    }
    switch (packet->route.function) {
    case CPX_SYSTEM:
        if (in.data[0] == SYSTEM_CLIENT && in.size >= 2) {
            set_client(self, in.data[1] != 0, now.up_us);
            return true;
        }
        if (in.data[0] == SYSTEM_BRIDGE && in.size >= 2) {
            set_bridge(self, in.data[1] != 0, now.up_us);
            return true;
        }
        if (in.data[0] == SYSTEM_SHUTDOWN) {
            stm32_log_set(&self->log, false);
            return true;
        }
        return false;
    case CPX_WIFI_CTRL:
        if (in.data[0] == WIFI_CLIENT_CONNECTED && in.size >= 2) {
            set_client(self, in.data[1] != 0, now.up_us);
            return true;
        }
        return in.data[0] == WIFI_CONNECTED && in.size >= 5;
    case CPX_TEST:
        if (in.data[0] == TEST_ECHO) {
            stm32_send(self, packet->route.source, CPX_TEST, in);
        }
        return in.data[0] == TEST_SINK || in.data[0] == TEST_ECHO;
    case CPX_CRTP:
        self->crtp_ignored += stm32_crtp(self, in, now) ? 0 : 1;
        return true;
    case CPX_APP:
        return stm32_reports_asked(self, packet, now.up_us);
    case CPX_CONSOLE:
        return true;
    default:
        return false;
    }
}

__attribute__((noinline)) int stm32_receive(stm32_t *self, stm32_port_t port, bytes_t in, instant_t now) {
    self->rests_us = 0;
    if (port == STM32_PORT_STORAGE) {
        self->answers_unknown += stm32_log_answer(&self->log, in, now) ? 0 : 1;
    }
    if (port == STM32_PORT_RADIO) {
        self->crtp_ignored += in.size > 0 && stm32_crtp(self, in, now) ? 0 : 1;
    }
    for (size_t i = 0; port == STM32_PORT_UART1 && i < in.size; i++) {
        stm32_echo_hear(self, in.data[i], now);
    }
    for (size_t i = 0; port == STM32_PORT_UART2 && i < in.size; i++) {
        cpx_packet_t packet;
        if (cpx_uart_receive(&self->uart2, in.data[i], now.up_us, &packet)) {
            self->packets_unknown += handle(self, &packet, now) ? 0 : 1;
            cpx_uart_accept(&self->uart2);
        }
    }
    return (int)in.size;
}

/// Since the last message; a wrap of a clock of 32 or 48 bits is none, when as much has passed of uptime.
static bool was_set_back(const stm32_t *self, instant_t now) {
    const uint64_t back_us = self->stamp_last.stamp_us - now.stamp_us;
    const uint64_t most_us = 2 * (now.up_us - self->stamp_last.up_us) + STAMP_PERIOD_US;
    return now.stamp_us < self->stamp_last.stamp_us && ((uint64_t)1 << 32) - back_us > most_us &&
           ((uint64_t)1 << 48) - back_us > most_us;
}

static void begin_stamp(stm32_t *self, instant_t now) {
    const uint64_t period_us = stamp_period_us(self);
    self->stamps_late += (uint32_t)((now.up_us - self->stamp_next_us) / period_us);
    self->stamp_next_us = next_on_grid(self->stamp_next_us, period_us, now.up_us);
    self->epoch = (uint8_t)(self->epoch + was_set_back(self, now));
    self->stamp_last = now;
    self->stamp_size = stm32_message(self, now);
    self->stamp_echoes = false;
    self->stamp_sequence++;
    self->stamp_sent = 0;
}

/// Between two stamps. False: nobody has asked.
static bool begin_answer(stm32_t *self, instant_t now) {
    const uint8_t size = stm32_echo_answer(self, now);
    if (size == 0) {
        return false;
    }
    self->stamp_size = size;
    self->stamp_echoes = true;
    self->stamp_sent = 0;
    return true;
}

static size_t transmit_stamp(stm32_t *self, uint8_t *out, instant_t now) {
    if (self->stamp_sent == self->stamp_size) {
        if (now.up_us >= self->stamp_next_us) {
            begin_stamp(self, now);
        } else if (!begin_answer(self, now)) {
            return 0;
        }
    }
    *out = self->stamp[self->stamp_sent++];
    self->stamps_sent += self->stamp_sent == self->stamp_size && !self->stamp_echoes;
    return 1;
}

static size_t transmit_cpx(stm32_t *self, uint8_t *out, instant_t now) {
    if (now.up_us >= self->report_next_us) {
        stm32_report(self, now);
    }
    while (now.up_us >= self->telemetry.next_us) { // ends: it is later behind each packet
        stm32_telemetry(self, now);
    }
    if (self->queue_fill > 0) {
        const stm32_packet_t *first = &self->queue[self->queue_head];
        cpx_packet_t packet = {.data = {first->data, first->size}};
        cpx_route_decode(first->route, &packet.route);
        if (cpx_uart_send(&self->uart2, &packet)) {
            self->queue_head = (uint8_t)((self->queue_head + 1) % STM32_QUEUE_PACKETS);
            self->queue_fill--;
        }
    }
    const size_t size = cpx_uart_transmit(&self->uart2, out, now.up_us);
    self->uart2_busy = size > 0;
    return size;
}

__attribute__((noinline)) size_t stm32_transmit(stm32_t *self, stm32_port_t port, bytes_mut_t out,
                                                instant_t now) {
    if (out.size == 0) {
        return 0;
    }
    if (now.up_us >= self->rests_us) {
        self->rests_us = 0;
        run_timers(self, now);
    } else if (port != STM32_PORT_UART1) {
        return 0;
    }
    switch (port) {
    case STM32_PORT_UART1:
        return transmit_stamp(self, out.data, now);
    case STM32_PORT_UART2:
        return transmit_cpx(self, out.data, now);
    case STM32_PORT_STORAGE:
        return stm32_log_request(&self->log, out, now);
    default:
        return 0;
    }
}

static uint64_t earlier(uint64_t a_us, uint64_t b_us) {
    return a_us < b_us ? a_us : b_us;
}

/// For all but UART1.
static uint64_t others_us(const stm32_t *self) {
    uint64_t deadline_us = earlier(self->wifi_next_us, self->crtp_next_us);
    deadline_us = earlier(deadline_us, stm32_rows_deadline(self));
    if (!self->uart2_busy) {
        const bool loads = self->queue_fill > 0 && self->uart2.tx_size == 0;
        deadline_us = earlier(deadline_us, loads ? 0 : cpx_uart_deadline(&self->uart2));
        deadline_us = earlier(deadline_us, self->report_next_us);
        deadline_us = earlier(deadline_us, self->telemetry.next_us);
    }
    return deadline_us;
}

__attribute__((noinline)) uint64_t stm32_deadline(stm32_t *self) {
    const uint64_t deadline_us = self->rests_us != 0 ? self->rests_us : others_us(self);
    // The caller comes by itself when the byte that is on its way has left.
    self->rests_us = self->uart2_busy ? 0 : deadline_us;
    return self->stamp_sent == self->stamp_size ? earlier(deadline_us, self->stamp_next_us) : deadline_us;
}
