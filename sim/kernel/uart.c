#include "world.h"

static int64_t sender_now_ns(const kernel_t *k, robot_t *r, const line_t *line) {
    return line->sender < 0 ? k->now_ns : node_local_ns(k, &r->nodes[line->sender]);
}

static size_t next_byte(kernel_t *k, robot_t *r, line_t *line) {
    return line->sender < 0
               ? ring_read(&r->host_out, &line->byte, 1)
               : node_transmit(k, r, (mcu_t)line->sender, line->port, (bytes_mut_t){&line->byte, 1});
}

void uart_init(robot_t *r) {
    const robot_config_t *config = &r->config;
    bool host = config->host_wire == HOST_UART2;
    r->lines[LINE_UART1] = (line_t){
        .sender = MCU_STM32, .port = STM32_PORT_UART1, .wire = WIRE_UART1, .byte_ps = config->uart1_byte_ps};
    r->lines[LINE_UART2_STM32] = (line_t){.sender = MCU_STM32,
                                          .port = STM32_PORT_UART2,
                                          .wire = host ? -1 : WIRE_UART2_TO_ESP32,
                                          .byte_ps = config->uart2_stm32_byte_ps};
    r->lines[LINE_UART2_ESP32] = (line_t){.sender = MCU_ESP32,
                                          .port = ESP32_PORT_UART2,
                                          .wire = WIRE_UART2_TO_STM32,
                                          .byte_ps = config->uart2_esp32_byte_ps};
    r->lines[LINE_HOST] =
        (line_t){.sender = -1, .wire = WIRE_UART2_TO_ESP32, .byte_ps = config->uart2_stm32_byte_ps};
}

static void unit_start(kernel_t *k, robot_t *r, int wire) {
    carrier_t *carrier = &r->carriers[wire];
    uart_queue_t *queue = &r->queues[wire];
    carrier->counts.units++;
    queue->engaged = carrier->faulty || queue->ready;
    if (!carrier->faulty) {
        return;
    }
    queue->lost = carrier_loses(carrier, k->now_ns);
    bool twice = carrier_duplicates(carrier);
    bool late = carrier_reorders(carrier);
    queue->delay_ns = carrier_delay_ns(carrier);
    // One unit can be held at a time, and nothing is left of a lost one.
    if (!queue->lost && !queue->ready) {
        queue->holding = late;
        queue->copying = twice && !late;
        queue->held_size = 0;
    }
}

static void enqueue(kernel_t *k, robot_t *r, int wire, const uint8_t *bytes, size_t size) {
    uart_queue_t *queue = &r->queues[wire];
    int64_t arrival_ns = k->now_ns + queue->delay_ns;
    queue->last_ns = arrival_ns > queue->last_ns ? arrival_ns : queue->last_ns;
    for (size_t i = 0; i < size; i++) {
        if (queue->fill == UART_QUEUE_BYTES) {
            r->carriers[wire].counts.overflowed++;
            continue;
        }
        uint32_t at = (queue->head + queue->fill++) % UART_QUEUE_BYTES;
        queue->arrival_ns[at] = queue->last_ns;
        queue->bytes[at] = bytes[i];
    }
}

static void queue_pass(kernel_t *k, robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    while (queue->fill != 0 && queue->arrival_ns[queue->head] <= k->now_ns) {
        uint8_t byte = queue->bytes[queue->head];
        queue->fill--;
        queue->head = queue->fill == 0 ? 0 : (queue->head + 1) % UART_QUEUE_BYTES; // 0 stays in the cache
        uart_deliver(k, r, wire, byte);
    }
    if (queue->fill != 0) {
        robot_at(k, r, (uint32_t)(SOURCE_QUEUE + wire), queue->arrival_ns[queue->head]);
    }
}

void uart_queue_due(kernel_t *k, robot_t *r, int wire) {
    int64_t free_ns = carrier_free_ns(&r->carriers[wire], k->now_ns);
    if (free_ns > k->now_ns) {
        robot_at(k, r, (uint32_t)(SOURCE_QUEUE + wire), free_ns);
    } else {
        queue_pass(k, r, wire);
    }
}

static void held_release(kernel_t *k, robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    enqueue(k, r, wire, queue->held, queue->held_size);
    queue->held_size = 0;
    queue->ready = false;
    uart_queue_due(k, r, wire);
}

static void unit_byte(kernel_t *k, robot_t *r, int wire, uint8_t byte) {
    carrier_t *carrier = &r->carriers[wire];
    uart_queue_t *queue = &r->queues[wire];
    if (queue->lost || carrier_damage(carrier, &byte, 1) == 0) {
        return;
    }
    if (queue->holding || queue->copying) {
        if (queue->held_size < UART_HELD_BYTES) {
            queue->held[queue->held_size++] = byte;
        } else { // too long to be held: it goes on as it is
            bool late = queue->holding;
            queue->holding = queue->copying = false;
            if (late) {
                held_release(k, r, wire);
            }
        }
    }
    if (!queue->holding) {
        enqueue(k, r, wire, &byte, 1);
        uart_queue_due(k, r, wire);
    }
}

static void unit_end(kernel_t *k, robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    if (queue->ready || queue->copying) {
        r->carriers[wire].counts.reordered += queue->ready;
        r->carriers[wire].counts.duplicated += !queue->ready;
        held_release(k, r, wire);
    }
    queue->ready = queue->holding && queue->held_size != 0;
    queue->holding = queue->copying = queue->lost = queue->engaged = false;
    queue->delay_ns = 0;
}

// A byte has left its sender: the receiver gets it now, if nothing on the wire says otherwise.
static void carry(kernel_t *k, robot_t *r, int wire, uint8_t byte) {
    carrier_t *carrier = &r->carriers[wire];
    carrier->counts.bytes++;
    if (r->queues[wire].engaged || carrier->stall_until_ns > k->now_ns || r->queues[wire].fill != 0) {
        unit_byte(k, r, wire, byte);
    } else {
        uart_deliver(k, r, wire, byte);
    }
}

void uart_deliver(kernel_t *k, robot_t *r, int wire, uint8_t byte) {
    bool to_host = false;
    mcu_t mcu = MCU_ESP32;
    int port = ESP32_PORT_UART2;
    if (wire == WIRE_UART1) {
        mcu = MCU_GAP8;
        port = GAP8_PORT_UART1;
        to_host = r->config.host_wire == HOST_UART1;
    } else if (wire == WIRE_UART2_TO_STM32) {
        mcu = MCU_STM32;
        port = STM32_PORT_UART2;
        to_host = r->config.host_wire == HOST_UART2;
    }
    if (to_host && ring_write(&r->host_in, &byte, 1) == 0) {
        r->carriers[wire].counts.overflowed++;
    }
    if (to_host && mcu == MCU_STM32) {
        return; // the host sits in its place
    }
    node_receive(k, r, mcu, port, (bytes_t){&byte, 1});
    node_poll(k, r, mcu);
}

static void run_end(kernel_t *k, robot_t *r, line_t *line) {
    line->in_run = false;
    if (line->wire < 0) {
        return;
    }
    if (k->trace.mode != TRACE_OFF) {
        trace_end(&k->trace, &r->traces[line->wire]);
    }
    if (r->queues[line->wire].engaged) {
        unit_end(k, r, line->wire);
    }
}

static void run_start(kernel_t *k, robot_t *r, line_t *line) {
    const node_t *sender = line->sender < 0 ? NULL : &r->nodes[line->sender];
    if (sender != NULL && sender->verbs->byte_ps != NULL) {
        line->byte_ps = sender->verbs->byte_ps(sender->app, line->port);
    }
    line->in_run = true;
    line->start_ns = sender_now_ns(k, r, line);
    line->bytes = 0;
    if (line->wire < 0) {
        return;
    }
    if (k->trace.mode != TRACE_OFF) {
        trace_begin(&r->traces[line->wire], &(trace_run_t){.local_start_ns = line->start_ns,
                                                           .true_start_ns = k->now_ns,
                                                           .byte_ps = line->byte_ps,
                                                           .robot = (int16_t)r->index,
                                                           .wire = (uint8_t)line->wire});
    }
    unit_start(k, r, line->wire);
}

void uart_poll(kernel_t *k, robot_t *r, int index) {
    line_t *line = &r->lines[index];
    if (line->busy) {
        return;
    }
    if (next_byte(k, r, line) == 0) {
        if (line->in_run) {
            run_end(k, r, line);
        }
        return;
    }
    if (!line->in_run) {
        run_start(k, r, line);
    }
    line->busy = true;
    line->bytes++;
    int64_t end_ns = line->start_ns + wire_time_ns(line->bytes, line->byte_ps);
    robot_at(k, r, (uint32_t)(SOURCE_LINE + index),
             line->sender < 0 ? end_ns : oscillator_when_ns(&r->nodes[line->sender].oscillator, end_ns));
}

void uart_byte_end(kernel_t *k, robot_t *r, int index) {
    line_t *line = &r->lines[index];
    line->busy = false;
    if (line->wire >= 0) {
        if (k->trace.mode != TRACE_OFF) {
            trace_bytes(&k->trace, &r->traces[line->wire], (bytes_t){&line->byte, 1});
        }
        carry(k, r, line->wire, line->byte);
    }
    if (line->sender < 0) {
        uart_poll(k, r, index);
        return;
    }
    node_t *sender = &r->nodes[line->sender];
    if (sender->verbs->sent != NULL && sender->up) {
        sender->verbs->sent(sender->app, line->port, node_local_ns(k, sender));
    }
    node_poll(k, r, (mcu_t)line->sender);
}

void uart_off(kernel_t *k, robot_t *r, mcu_t mcu) {
    for (int index = 0; index < LINE_COUNT; index++) {
        line_t *line = &r->lines[index];
        if (line->sender != (int)mcu) {
            continue;
        }
        if (line->in_run) {
            run_end(k, r, line);
        }
        line->busy = false;
        robot_not(k, r, (uint32_t)(SOURCE_LINE + index));
    }
}
