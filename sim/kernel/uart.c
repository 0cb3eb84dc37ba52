#include "world.h"

static int64_t sender_now_ns(robot_t *r, const line_t *line) {
    return line->sender < 0 ? r->now_ns : node_local_ns(r, &r->nodes[line->sender]);
}

static size_t next_byte(robot_t *r, line_t *line) {
    return line->sender < 0
               ? ring_read(&r->host_out, &line->byte, 1)
               : node_transmit(r, (mcu_t)line->sender, line->port, (bytes_mut_t){&line->byte, 1});
}

void uart_init(robot_t *r) {
    const robot_config_t *config = &r->config;
    bool host = config->host_wire == HOST_UART2;
    r->lines[LINE_UART1] = (line_t){
        .sender = MCU_STM32, .port = STM32_PORT_UART1, .wire = WIRE_UART1, .byte_ps = config->uart1_byte_ps};
    r->lines[LINE_UART1_GAP8] = (line_t){.sender = MCU_GAP8,
                                         .port = GAP8_PORT_UART1,
                                         .wire = WIRE_UART1_TO_STM32,
                                         .byte_ps = config->uart1_gap8_byte_ps};
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

static void unit_start(robot_t *r, int wire) {
    carrier_t *carrier = &r->carriers[wire];
    uart_queue_t *queue = &r->queues[wire];
    carrier->counts.units++;
    queue->engaged = carrier->faulty || queue->ready;
    if (!carrier->faulty) {
        return;
    }
    queue->lost = carrier_loses(carrier, r->now_ns);
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

static void enqueue(robot_t *r, int wire, const uint8_t *bytes, size_t size) {
    uart_queue_t *queue = &r->queues[wire];
    int64_t arrival_ns = r->now_ns + queue->delay_ns;
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

static void queue_pass(robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    while (queue->fill != 0 && queue->arrival_ns[queue->head] <= r->now_ns) {
        uint8_t byte = queue->bytes[queue->head];
        queue->fill--;
        queue->head = queue->fill == 0 ? 0 : (queue->head + 1) % UART_QUEUE_BYTES; // 0 stays in the cache
        uart_deliver(r, wire, byte);
    }
    if (queue->fill != 0) {
        robot_at(r, (uint32_t)(SOURCE_QUEUE + wire), queue->arrival_ns[queue->head]);
    }
}

void uart_queue_due(robot_t *r, int wire) {
    int64_t free_ns = carrier_free_ns(&r->carriers[wire], r->now_ns);
    if (free_ns > r->now_ns) {
        robot_at(r, (uint32_t)(SOURCE_QUEUE + wire), free_ns);
    } else {
        queue_pass(r, wire);
    }
}

static void held_release(robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    enqueue(r, wire, queue->held, queue->held_size);
    queue->held_size = 0;
    queue->ready = false;
    uart_queue_due(r, wire);
}

static void unit_byte(robot_t *r, int wire, uint8_t byte) {
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
                held_release(r, wire);
            }
        }
    }
    if (!queue->holding) {
        enqueue(r, wire, &byte, 1);
        uart_queue_due(r, wire);
    }
}

static void unit_end(robot_t *r, int wire) {
    uart_queue_t *queue = &r->queues[wire];
    if (queue->ready || queue->copying) {
        r->carriers[wire].counts.reordered += queue->ready;
        r->carriers[wire].counts.duplicated += !queue->ready;
        held_release(r, wire);
    }
    queue->ready = queue->holding && queue->held_size != 0;
    queue->holding = queue->copying = queue->lost = queue->engaged = false;
    queue->delay_ns = 0;
}

// A byte has left its sender: the receiver gets it now, if nothing on the wire says otherwise.
static void carry(robot_t *r, int wire, uint8_t byte) {
    carrier_t *carrier = &r->carriers[wire];
    carrier->counts.bytes++;
    if (r->queues[wire].engaged || carrier->stall_until_ns > r->now_ns || r->queues[wire].fill != 0) {
        unit_byte(r, wire, byte);
    } else {
        uart_deliver(r, wire, byte);
    }
}

void uart_deliver(robot_t *r, int wire, uint8_t byte) {
    bool to_host = false;
    mcu_t mcu = MCU_ESP32;
    int port = ESP32_PORT_UART2;
    if (wire == WIRE_UART1) {
        mcu = MCU_GAP8;
        port = GAP8_PORT_UART1;
        to_host = r->config.host_wire == HOST_UART1;
    } else if (wire == WIRE_UART1_TO_STM32) {
        mcu = MCU_STM32;
        port = STM32_PORT_UART1;
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
    node_receive(r, mcu, port, (bytes_t){&byte, 1});
    node_poll(r, mcu);
}

static void run_end(robot_t *r, line_t *line) {
    line->in_run = false;
    if (line->wire < 0) {
        return;
    }
    if (r->trace->mode != TRACE_OFF) {
        trace_end(r->trace, &r->traces[line->wire]);
    }
    if (r->queues[line->wire].engaged) {
        unit_end(r, line->wire);
    }
}

static void run_start(robot_t *r, line_t *line) {
    const node_t *sender = line->sender < 0 ? NULL : &r->nodes[line->sender];
    if (sender != NULL && sender->verbs->byte_ps != NULL) {
        line->byte_ps = sender->verbs->byte_ps(sender->app, line->port);
    }
    line->in_run = true;
    line->start_ns = sender_now_ns(r, line);
    line->bytes = 0;
    if (line->wire < 0) {
        return;
    }
    if (r->trace->mode != TRACE_OFF) {
        trace_begin(&r->traces[line->wire], &(trace_run_t){.local_start_ns = line->start_ns,
                                                           .true_start_ns = r->now_ns,
                                                           .byte_ps = line->byte_ps,
                                                           .robot = (int16_t)r->index,
                                                           .wire = (uint8_t)line->wire});
    }
    unit_start(r, line->wire);
}

void uart_poll(robot_t *r, int index) {
    line_t *line = &r->lines[index];
    if (line->busy) {
        return;
    }
    if (next_byte(r, line) == 0) {
        if (line->in_run) {
            run_end(r, line);
        }
        return;
    }
    if (!line->in_run) {
        run_start(r, line);
    }
    line->busy = true;
    line->bytes++;
    int64_t end_ns = line->start_ns + wire_time_ns(line->bytes, line->byte_ps);
    robot_at(r, (uint32_t)(SOURCE_LINE + index),
             line->sender < 0 ? end_ns : oscillator_when_ns(&r->nodes[line->sender].oscillator, end_ns));
}

void uart_byte_end(robot_t *r, int index) {
    line_t *line = &r->lines[index];
    line->busy = false;
    if (line->wire >= 0) {
        if (r->trace->mode != TRACE_OFF) {
            trace_bytes(r->trace, &r->traces[line->wire], (bytes_t){&line->byte, 1});
        }
        carry(r, line->wire, line->byte);
    }
    if (line->sender < 0) {
        uart_poll(r, index);
        return;
    }
    node_t *sender = &r->nodes[line->sender];
    if (sender->verbs->sent != NULL && sender->up) {
        sender->verbs->sent(sender->app, line->port, node_local_ns(r, sender));
    }
    node_poll(r, (mcu_t)line->sender);
}

void uart_off(robot_t *r, mcu_t mcu) {
    for (int index = 0; index < LINE_COUNT; index++) {
        line_t *line = &r->lines[index];
        if (line->sender != (int)mcu) {
            continue;
        }
        if (line->in_run) {
            run_end(r, line);
        }
        line->busy = false;
        robot_not(r, (uint32_t)(SOURCE_LINE + index));
    }
}
