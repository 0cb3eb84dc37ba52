#include "world.h"

int64_t node_local_ns(const robot_t *r, node_t *node) {
    if (node->read_ns != r->now_ns) {
        node->read_ns = r->now_ns;
        node->local_ns = oscillator_local_ns(&node->oscillator, r->now_ns);
        node->instant.up_us = (uint64_t)node->local_ns / 1000;
        node->instant.stamp_us = stamp_clock_us(&node->stamp, node->local_ns);
    }
    return node->local_ns;
}

instant_t node_instant(const robot_t *r, node_t *node) {
    node_local_ns(r, node);
    return node->instant;
}

int node_receive(robot_t *r, mcu_t mcu, int port, bytes_t in) {
    node_t *node = &r->nodes[mcu];
    return node->up ? node->verbs->receive(node->app, port, in, node_instant(r, node), node_local_ns(r, node))
                    : 0;
}

size_t node_transmit(robot_t *r, mcu_t mcu, int port, bytes_mut_t out) {
    node_t *node = &r->nodes[mcu];
    return node->up
               ? node->verbs->transmit(node->app, port, out, node_instant(r, node), node_local_ns(r, node))
               : 0;
}

void node_set_timer(robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    uint64_t deadline_us = node->verbs->deadline(node->app, node_local_ns(r, node));
    if (deadline_us == node->deadline_us) {
        return;
    }
    node->deadline_us = deadline_us;
    bool passed = deadline_us <= node_instant(r, node).up_us;
    if (passed || deadline_us > INT64_MAX / 1000) {
        robot_not(r, SOURCE_TIMER + mcu);
    } else {
        robot_at(r, SOURCE_TIMER + mcu, oscillator_when_ns(&node->oscillator, (int64_t)deadline_us * 1000));
    }
}

void node_poll(robot_t *r, mcu_t mcu) {
    if (!r->nodes[mcu].up) {
        return;
    }
    switch (mcu) {
    case MCU_STM32:
        uart_poll(r, LINE_UART1);
        uart_poll(r, LINE_UART2_STM32);
        storage_poll(r);
        break;
    case MCU_GAP8:
        uart_poll(r, LINE_UART1_GAP8);
        spi_poll(r, MCU_GAP8);
        camera_poll(r);
        break;
    default:
        tcp_offer(r);
        uart_poll(r, LINE_UART2_ESP32);
        spi_poll(r, MCU_ESP32);
        tcp_poll(r, TO_HOST);
        network_poll(r);
        break;
    }
    node_set_timer(r, mcu);
}

static void boot(robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    node->boots++;
    if (mcu == MCU_STM32) {
        r->config.stm32.log.boot = node->boots;
    }
    oscillator_restart(&node->oscillator, r->now_ns);
    stamp_clock_init(&node->stamp, &r->config.clocks[mcu]);
    node->read_ns = -1;
    node->deadline_us = NEVER_US;
    node->up = true;
    node->verbs->init(node->app, node->config, node_instant(r, node),
                      node_local_ns(r, node)); // the config was tried when the robot was added
    node_poll(r, mcu);
}

void node_timer(robot_t *r, mcu_t mcu) {
    node_t *node = &r->nodes[mcu];
    if (!node->up) {
        boot(r, mcu);
        return;
    }
    if (node_instant(r, node).up_us < node->deadline_us) { // further off than the oscillator looks
        node->deadline_us = NEVER_US;
        node_set_timer(r, mcu);
        return;
    }
    node_poll(r, mcu);
}

void node_off(robot_t *r, mcu_t mcu, int64_t off_ns) {
    r->nodes[mcu].up = false;
    uart_off(r, mcu);
    spi_off(r, mcu);
    if (mcu == MCU_STM32) {
        storage_off(r);
    } else if (mcu == MCU_GAP8) {
        camera_off(r);
    } else if (mcu == MCU_ESP32) {
        network_off(r);
    }
    int64_t boot_ns = r->now_ns + off_ns;
    int64_t origin_ns = r->nodes[mcu].oscillator.anchor_ns; // in the future if it has not been powered up yet
    robot_at(r, SOURCE_TIMER + mcu, boot_ns > origin_ns ? boot_ns : origin_ns);
}
