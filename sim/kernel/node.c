#include "world.h"

int64_t node_local_ns(const kernel_t *k, node_t *node) {
    if (node->read_ns != k->now_ns) {
        node->read_ns = k->now_ns;
        node->local_ns = oscillator_local_ns(&node->oscillator, k->now_ns);
        node->instant.up_us = (uint64_t)node->local_ns / 1000;
        node->instant.stamp_us = stamp_clock_us(&node->stamp, node->local_ns);
    }
    return node->local_ns;
}

instant_t node_instant(const kernel_t *k, node_t *node) {
    node_local_ns(k, node);
    return node->instant;
}

int node_receive(kernel_t *k, robot_t *r, mcu_t mcu, int port, bytes_t in) {
    node_t *node = &r->nodes[mcu];
    return node->up ? node->verbs->receive(node->app, port, in, node_instant(k, node), node_local_ns(k, node))
                    : 0;
}

size_t node_transmit(kernel_t *k, robot_t *r, mcu_t mcu, int port, bytes_mut_t out) {
    node_t *node = &r->nodes[mcu];
    return node->up
               ? node->verbs->transmit(node->app, port, out, node_instant(k, node), node_local_ns(k, node))
               : 0;
}

void node_set_timer(kernel_t *k, robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    uint64_t deadline_us = node->verbs->deadline(node->app, node_local_ns(k, node));
    if (deadline_us == node->deadline_us) {
        return;
    }
    node->deadline_us = deadline_us;
    bool passed = deadline_us <= node_instant(k, node).up_us;
    if (passed || deadline_us > INT64_MAX / 1000) {
        robot_not(k, r, SOURCE_TIMER + mcu);
    } else {
        robot_at(k, r, SOURCE_TIMER + mcu,
                 oscillator_when_ns(&node->oscillator, (int64_t)deadline_us * 1000));
    }
}

void node_poll(kernel_t *k, robot_t *r, mcu_t mcu) {
    if (!r->nodes[mcu].up) {
        return;
    }
    switch (mcu) {
    case MCU_STM32:
        uart_poll(k, r, LINE_UART1);
        uart_poll(k, r, LINE_UART2_STM32);
        storage_poll(k, r);
        break;
    case MCU_GAP8:
        spi_poll(k, r, MCU_GAP8);
        camera_poll(k, r);
        break;
    default:
        tcp_offer(k, r);
        uart_poll(k, r, LINE_UART2_ESP32);
        spi_poll(k, r, MCU_ESP32);
        tcp_poll(k, r, TO_HOST);
        network_poll(k, r);
        break;
    }
    node_set_timer(k, r, mcu);
}

static void boot(kernel_t *k, robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    node->boots++;
    if (mcu == MCU_STM32) {
        r->config.stm32.log.boot = node->boots;
    }
    oscillator_restart(&node->oscillator, k->now_ns);
    stamp_clock_init(&node->stamp, &r->config.clocks[mcu]);
    node->read_ns = -1;
    node->deadline_us = NEVER_US;
    node->up = true;
    node->verbs->init(node->app, node->config, node_instant(k, node),
                      node_local_ns(k, node)); // the config was tried when the robot was added
    node_poll(k, r, mcu);
}

void node_timer(kernel_t *k, robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    if (!node->up) {
        boot(k, r, mcu);
        return;
    }
    if (node_instant(k, node).up_us < node->deadline_us) { // further off than the oscillator looks
        node->deadline_us = NEVER_US;
        node_set_timer(k, r, mcu);
        return;
    }
    node_poll(k, r, mcu);
}

void node_off(kernel_t *k, robot_t *r, mcu_t mcu, int64_t off_ns) {
    r->nodes[mcu].up = false;
    uart_off(k, r, mcu);
    spi_off(k, r, mcu);
    if (mcu == MCU_STM32) {
        storage_off(k, r);
    } else if (mcu == MCU_GAP8) {
        camera_off(k, r);
    } else if (mcu == MCU_ESP32) {
        network_off(k, r);
    }
    int64_t boot_ns = k->now_ns + off_ns;
    int64_t origin_ns = r->nodes[mcu].oscillator.anchor_ns; // in the future if it has not been powered up yet
    robot_at(k, r, SOURCE_TIMER + mcu, boot_ns > origin_ns ? boot_ns : origin_ns);
}
