#include "world.h"

static void tell(kernel_t *k, robot_t *r, const uint8_t *event, size_t size) {
    node_receive(k, r, MCU_ESP32, ESP32_PORT_NETWORK, (bytes_t){event, size});
}

void network_connect(kernel_t *k, robot_t *r) {
    if (!r->host_waits || !r->network_up || !r->nodes[MCU_ESP32].up) {
        return;
    }
    r->host_waits = false;
    r->connected = true;
    tell(k, r, (const uint8_t[]){NETWORK_CLIENT}, 1);
    node_poll(k, r, MCU_ESP32);
    tcp_poll(k, r, TO_ESP32);
}

void network_disconnect(kernel_t *k, robot_t *r) {
    r->host_waits = false;
    tcp_cut(k, r);
    if (r->connected) {
        r->connected = false;
        tell(k, r, (const uint8_t[]){NETWORK_CLIENT_GONE}, 1);
    }
}

void network_poll(kernel_t *k, robot_t *r) {
    uint8_t command[NETWORK_COMMAND_BYTES];
    size_t size = node_transmit(k, r, MCU_ESP32, ESP32_PORT_NETWORK, (bytes_mut_t){command, sizeof command});
    if (size >= 2 && command[0] == NETWORK_START) {
        if (r->connected) {
            network_disconnect(k, r);
        }
        r->network_up = false;
        r->network_mode = command[1];
        robot_at(k, r, SOURCE_NETWORK, k->now_ns + r->config.network_up_ns);
    } else if (size >= 1 && command[0] == NETWORK_RESET_GAP8) {
        node_off(k, r, MCU_GAP8, GAP8_RESET_NS);
    }
}

void network_due(kernel_t *k, robot_t *r) {
    r->network_up = true;
    if (r->network_mode == 0) {
        tell(k, r, (const uint8_t[]){NETWORK_UP, 10, 0, 0, 2, 1}, 6);
    } else {
        tell(k, r, (const uint8_t[]){NETWORK_UP, 192, 168, 4, 1}, 5);
    }
    node_poll(k, r, MCU_ESP32);
    network_connect(k, r);
}

void network_off(kernel_t *k, robot_t *r) {
    if (r->connected) {
        network_disconnect(k, r);
    }
    r->network_up = false;
    robot_not(k, r, SOURCE_NETWORK);
}
