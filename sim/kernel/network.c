#include "world.h"

static void tell(robot_t *r, const uint8_t *event, size_t size) {
    node_receive(r, MCU_ESP32, ESP32_PORT_NETWORK, (bytes_t){event, size});
}

void network_connect(robot_t *r) {
    if (!r->host_waits || !r->network_up || !r->nodes[MCU_ESP32].up) {
        return;
    }
    r->host_waits = false;
    r->connected = true;
    tell(r, (const uint8_t[]){NETWORK_CLIENT}, 1);
    node_poll(r, MCU_ESP32);
    tcp_poll(r, TO_ESP32);
}

void network_disconnect(robot_t *r) {
    r->host_waits = false;
    tcp_cut(r);
    if (r->connected) {
        r->connected = false;
        tell(r, (const uint8_t[]){NETWORK_CLIENT_GONE}, 1);
    }
}

void network_poll(robot_t *r) {
    uint8_t command[NETWORK_COMMAND_BYTES];
    size_t size = node_transmit(r, MCU_ESP32, ESP32_PORT_NETWORK, (bytes_mut_t){command, sizeof command});
    if (size >= 2 && command[0] == NETWORK_START) {
        if (r->connected) {
            network_disconnect(r);
        }
        r->network_up = false;
        r->network_mode = command[1];
        robot_at(r, SOURCE_NETWORK, r->now_ns + r->config.network_up_ns);
    } else if (size >= 1 && command[0] == NETWORK_RESET_GAP8) {
        node_off(r, MCU_GAP8, GAP8_RESET_NS);
    }
}

void network_due(robot_t *r) {
    r->network_up = true;
    if (r->network_mode == 0) {
        tell(r, (const uint8_t[]){NETWORK_UP, 10, 0, 0, 2, 1}, 6);
    } else {
        tell(r, (const uint8_t[]){NETWORK_UP, 192, 168, 4, 1}, 5);
    }
    node_poll(r, MCU_ESP32);
    network_connect(r);
}

void network_off(robot_t *r) {
    if (r->connected) {
        network_disconnect(r);
    }
    r->network_up = false;
    robot_not(r, SOURCE_NETWORK);
}
