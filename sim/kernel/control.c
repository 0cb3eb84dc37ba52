#include "config.h"
#include "world.h"

int kernel_set_faults(kernel_t *k, int robot, wire_t wire, const wire_faults_t *faults) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)wire >= WIRE_COUNT || !wire_faults_ok(faults)) {
        return KERNEL_ERR_CONFIG;
    }
    carrier_set_faults(&r->carriers[wire], faults, r->now_ns);
    return 0;
}

int kernel_stall(kernel_t *k, int robot, wire_t wire, int64_t duration_ns) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)wire >= WIRE_COUNT || !duration_ok(duration_ns)) {
        return KERNEL_ERR_CONFIG;
    }
    carrier_t *carrier = &r->carriers[wire];
    int64_t until_ns = r->now_ns + duration_ns;
    carrier->stall_until_ns = until_ns > carrier->stall_until_ns ? until_ns : carrier->stall_until_ns;
    carrier->counts.stalls++;
    return 0;
}

int kernel_inject(kernel_t *k, int robot, wire_t wire, const uint8_t *in, size_t size) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)wire >= WIRE_COUNT) {
        return KERNEL_ERR_CONFIG;
    }
    bytes_t bytes = {in, size};
    switch (wire) {
    case WIRE_SPI_TO_ESP32:
        node_receive(r, MCU_ESP32, ESP32_PORT_SPI, bytes);
        node_poll(r, MCU_ESP32);
        break;
    case WIRE_SPI_TO_GAP8:
        node_receive(r, MCU_GAP8, GAP8_PORT_SPI, bytes);
        node_poll(r, MCU_GAP8);
        break;
    case WIRE_TCP_TO_HOST:
        r->carriers[wire].counts.overflowed += size - ring_write(&r->host_in, in, size);
        break;
    case WIRE_TCP_TO_ESP32:
        node_receive(r, MCU_ESP32, ESP32_PORT_TCP, bytes);
        node_poll(r, MCU_ESP32);
        break;
    default:
        for (size_t i = 0; i < size; i++) {
            uart_deliver(r, (int)wire, in[i]);
        }
        break;
    }
    return 0;
}

int kernel_radio(kernel_t *k, int robot, const uint8_t *in, size_t size) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || r->emulated[MCU_STM32].emulator != NULL) {
        return KERNEL_ERR_CONFIG;
    }
    node_receive(r, MCU_STM32, STM32_PORT_RADIO, (bytes_t){in, size});
    node_poll(r, MCU_STM32);
    return 0;
}

int kernel_set_rate(kernel_t *k, int robot, mcu_t mcu, int64_t rate_ppb) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT || !rate_ok(rate_ppb)) {
        return KERNEL_ERR_CONFIG;
    }
    node_t *node = &r->nodes[mcu];
    oscillator_set_rate(&node->oscillator, r->now_ns, rate_ppb);
    if (node->up) { // its deadline moves; what is on a wire by now ends when it was going to
        node->deadline_us = NEVER_US;
        node_set_timer(r, mcu);
    }
    return 0;
}

int kernel_reset_stamp_clock(kernel_t *k, int robot, mcu_t mcu, uint64_t to_us) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT) {
        return KERNEL_ERR_CONFIG;
    }
    node_t *node = &r->nodes[mcu];
    if (node->up) {
        stamp_clock_reset(&node->stamp, node_local_ns(r, node), to_us);
        node->read_ns = -1; // what was read at this instant no longer holds
        if (node->verbs->reset_stamp != NULL) {
            node->verbs->reset_stamp(node->app, to_us, node_local_ns(r, node));
        }
    }
    return 0;
}

int kernel_reboot(kernel_t *k, int robot, mcu_t mcu, int64_t off_ns) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT || !duration_ok(off_ns)) {
        return KERNEL_ERR_CONFIG;
    }
    node_off(r, mcu, off_ns);
    return 0;
}

int kernel_set_camera_faults(kernel_t *k, int robot, double fail, double hang) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || !probability_ok(fail) || !probability_ok(hang)) {
        return KERNEL_ERR_CONFIG;
    }
    r->camera.fail = random_threshold(fail);
    r->camera.hang = random_threshold(hang);
    return 0;
}
