#include "world.h"

#include <string.h>

static size_t asked(robot_t *r, mcu_t mcu, mcu_t asker) {
    bytes_mut_t out = {mcu == MCU_GAP8 ? r->spi.master : r->spi.slave, SPI_SIDE_BYTES};
    size_t size = node_transmit(r, mcu, mcu == MCU_GAP8 ? (int)GAP8_PORT_SPI : (int)ESP32_PORT_SPI, out);
    if (mcu != asker && r->nodes[mcu].up) {
        node_set_timer(r, mcu); // the asker's is set when it has been polled
    }
    return size;
}

static void trace_unit(robot_t *r, wire_t wire, mcu_t sender, bytes_t bytes) {
    if (r->trace->mode == TRACE_OFF) {
        return;
    }
    trace_begin(&r->traces[wire], &(trace_run_t){.local_start_ns = node_local_ns(r, &r->nodes[sender]),
                                                 .true_start_ns = r->now_ns,
                                                 .byte_ps = r->config.spi_byte_ps,
                                                 .robot = (int16_t)r->index,
                                                 .wire = (uint8_t)wire});
    trace_bytes(r->trace, &r->traces[wire], bytes);
    trace_end(r->trace, &r->traces[wire]);
}

static void window_start(robot_t *r) {
    spi_t *spi = &r->spi;
    if (spi->master_size == 0) {
        spi->master_size = CPX_LINK_HEADER_BYTES;
        memset(spi->master, 0, CPX_LINK_HEADER_BYTES);
        node_t *gap8 = &r->nodes[MCU_GAP8];
        if (gap8->verbs->window != NULL) {
            gap8->verbs->window(gap8->app, node_local_ns(r, gap8));
        }
    }
    spi->under_way = true;
    trace_unit(r, WIRE_SPI_TO_ESP32, MCU_GAP8, (bytes_t){spi->master, spi->master_size});
    trace_unit(r, WIRE_SPI_TO_GAP8, MCU_ESP32, (bytes_t){spi->slave, spi->slave_size});
    // A delay of either direction holds up the window, so that neither overtakes itself.
    int64_t there_ns = carrier_delay_ns(&r->carriers[WIRE_SPI_TO_ESP32]);
    int64_t back_ns = carrier_delay_ns(&r->carriers[WIRE_SPI_TO_GAP8]);
    int64_t clock_ns = r->now_ns + r->config.spi_gap_ns + (there_ns > back_ns ? there_ns : back_ns);
    oscillator_t ahead = r->nodes[MCU_GAP8].oscillator;
    int64_t clock_local_ns = oscillator_local_ns(&ahead, clock_ns);
    size_t bytes = cpx_spi_window_bytes(spi->master_size, spi->slave_size);
    robot_at(r, SOURCE_SPI,
             oscillator_when_ns(&ahead, clock_local_ns + wire_time_ns(bytes, r->config.spi_byte_ps)));
}

void spi_poll(robot_t *r, mcu_t asker) {
    spi_t *spi = &r->spi;
    if (spi->under_way || !r->nodes[MCU_GAP8].up) {
        return;
    }
    if (spi->master_size == 0) { // the GAP8 does not know that the wire stands still
        spi->master_size = asked(r, MCU_GAP8, asker);
    }
    int64_t there_ns = carrier_free_ns(&r->carriers[WIRE_SPI_TO_ESP32], r->now_ns);
    int64_t back_ns = carrier_free_ns(&r->carriers[WIRE_SPI_TO_GAP8], r->now_ns);
    int64_t free_ns = there_ns > back_ns ? there_ns : back_ns;
    if (free_ns > r->now_ns) {
        robot_at(r, SOURCE_SPI, free_ns);
        return;
    }
    if (spi->slave_size == 0 && (asker == MCU_ESP32 || spi->master_size != 0)) {
        spi->slave_size = asked(r, MCU_ESP32, asker);
    }
    if (spi->slave_size > CPX_LINK_HEADER_BYTES || (spi->slave_size != 0 && spi->master_size != 0)) {
        window_start(r);
    } else {
        spi->slave_size = 0; // it was ready, and nobody had anything to say
    }
}

static void receive(robot_t *r, wire_t wire, mcu_t mcu, int port, bytes_mut_t unit) {
    carrier_t *carrier = &r->carriers[wire];
    carrier->counts.units++;
    carrier->counts.bytes += unit.size;
    if (carrier->faulty) {
        if (carrier_loses(carrier, r->now_ns)) {
            return;
        }
        unit.size = carrier_damage(carrier, unit.data, unit.size);
        if (carrier_duplicates(carrier)) {
            carrier->counts.duplicated++;
            node_receive(r, mcu, port, (bytes_t){unit.data, unit.size});
        }
    }
    node_receive(r, mcu, port, (bytes_t){unit.data, unit.size});
}

void spi_due(robot_t *r) {
    spi_t *spi = &r->spi;
    if (spi->under_way) {
        spi->under_way = false;
        bytes_mut_t there = {spi->master, spi->master_size};
        bytes_mut_t back = {spi->slave, spi->slave_size};
        spi->master_size = spi->slave_size = 0;
        receive(r, WIRE_SPI_TO_ESP32, MCU_ESP32, ESP32_PORT_SPI, there);
        receive(r, WIRE_SPI_TO_GAP8, MCU_GAP8, GAP8_PORT_SPI, back);
    }
    node_poll(r, MCU_ESP32);
    node_poll(r, MCU_GAP8);
}

void spi_off(robot_t *r, mcu_t mcu) {
    spi_t *spi = &r->spi;
    if (mcu == MCU_STM32) {
        return;
    }
    if (spi->under_way || mcu == MCU_GAP8) {
        spi->master_size = 0;
    }
    if (spi->under_way || mcu == MCU_ESP32) {
        spi->slave_size = 0;
    }
    spi->under_way = false;
    robot_not(r, SOURCE_SPI);
}
