#include "world.h"

static const node_t *up_node(const kernel_t *k, int robot, mcu_t mcu) {
    const robot_t *r = robot_of(k, robot);
    return r != NULL && (unsigned)mcu < MCU_COUNT && r->nodes[mcu].up ? &r->nodes[mcu] : NULL;
}

uint64_t kernel_local_ns(const kernel_t *k, int robot, mcu_t mcu) {
    const node_t *node = up_node(k, robot, mcu);
    return node == NULL ? 0 : (uint64_t)oscillator_peek_ns(&node->oscillator, k->now_ns);
}

uint64_t kernel_stamp_us(const kernel_t *k, int robot, mcu_t mcu) {
    const node_t *node = up_node(k, robot, mcu);
    return node == NULL ? 0 : stamp_clock_us(&node->stamp, oscillator_peek_ns(&node->oscillator, k->now_ns));
}

const stm32_t *kernel_stm32(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL || r->emulated[MCU_STM32].emulator != NULL ? NULL : &r->stm32;
}

const gap8_t *kernel_gap8(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL || r->emulated[MCU_GAP8].emulator != NULL ? NULL : &r->gap8;
}

const esp32_t *kernel_esp32(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL ? NULL : &r->esp32;
}

wire_counts_t kernel_wire_counts(const kernel_t *k, int robot, wire_t wire) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL || (unsigned)wire >= WIRE_COUNT ? (wire_counts_t){0} : r->carriers[wire].counts;
}

size_t kernel_robot_bytes(const kernel_t *k, int robot) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL ? 0 : r->memory;
}

size_t kernel_read_truth(kernel_t *k, frame_truth_t *out, size_t count) {
    size_t moved = 0;
    for (; moved < count && k->truth_fill != 0; moved++) {
        out[moved] = k->truth[k->truth_head];
        k->truth_head = (k->truth_head + 1) % TRUTH_MAX;
        k->truth_fill--;
    }
    return moved;
}

uint64_t kernel_truth_lost(const kernel_t *k) {
    return k->truth_lost;
}

int kernel_trace(kernel_t *k, int mode) {
    if (mode < TRACE_OFF || mode > TRACE_FULL) {
        return KERNEL_ERR_CONFIG;
    }
    trace_start(&k->trace, mode);
    for (uint32_t i = 0; i < k->robot_count; i++) {
        for (int wire = 0; wire < WIRE_COUNT; wire++) {
            trace_wire_start(&k->robots[i]->traces[wire]);
        }
    }
    return 0;
}

uint64_t kernel_trace_hash(const kernel_t *k, int robot, wire_t wire) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL || (unsigned)wire >= WIRE_COUNT ? 0 : r->traces[wire].hash;
}

const trace_run_t *kernel_trace_runs(const kernel_t *k, size_t *count) {
    *count = k->trace.run_count;
    return k->trace.runs;
}

void kernel_trace_forget(kernel_t *k) {
    k->trace.run_count = 0;
    k->trace.size = 0;
}

const uint8_t *kernel_trace_data(const kernel_t *k, size_t *size) {
    *size = k->trace.size;
    return k->trace.data;
}
