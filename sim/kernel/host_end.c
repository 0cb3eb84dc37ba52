#include "world.h"

void kernel_host_connect(kernel_t *k, int robot) {
    robot_t *r = robot_of(k, robot);
    if (r != NULL && r->config.host_wire == HOST_TCP && !r->connected) {
        r->host_waits = true;
        network_connect(r);
    }
}

void kernel_host_disconnect(kernel_t *k, int robot) {
    robot_t *r = robot_of(k, robot);
    if (r != NULL && r->config.host_wire == HOST_TCP) {
        network_disconnect(r);
        node_poll(r, MCU_ESP32);
    }
}

bool kernel_host_connected(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r != NULL && (r->connected || r->config.host_wire != HOST_TCP);
}

size_t kernel_host_available(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL ? 0 : r->host_in.fill;
}

size_t kernel_host_read(kernel_t *k, int robot, uint8_t *out, size_t size) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL) {
        return 0;
    }
    size_t moved = ring_read(&r->host_in, out, size);
    if (moved != 0 && r->connected && !r->pipes[TO_HOST].on_link) {
        robot_at(r, SOURCE_TCP_LINK + TO_HOST, r->now_ns); // the window may have opened
    }
    return moved;
}

size_t kernel_host_write(kernel_t *k, int robot, const uint8_t *in, size_t size) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (r->config.host_wire == HOST_TCP && !r->connected && !r->host_waits)) {
        return 0;
    }
    if (r->config.host_wire == HOST_UART1) {
        return size; // UART1 is only listened to
    }
    size_t taken = ring_write(&r->host_out, in, size);
    if (r->config.host_wire == HOST_UART2) {
        uart_poll(r, LINE_HOST);
    } else {
        tcp_poll(r, TO_ESP32);
    }
    return taken;
}
