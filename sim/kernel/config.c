#include "config.h"

#include "oscillator.h"
#include "wire.h"
#include "world.h"

static const int64_t BYTE_PS_MAX = 5000000000;       // 5 ms
static const int64_t SPI_BYTE_PS_MAX = 1250000000;   // the longest window ends within what an oscillator sees
static const int64_t TIME_NS_MAX = (int64_t)1 << 50; // 13 days
static const uint32_t BUFFER_MAX = 1u << 28;

static bool in_range(int64_t value, int64_t min, int64_t max) {
    return value >= min && value <= max;
}

bool rate_ok(int64_t rate_ppb) {
    return in_range(rate_ppb, -OSCILLATOR_PPB_MAX, OSCILLATOR_PPB_MAX);
}

bool duration_ok(int64_t ns) {
    return in_range(ns, 0, TIME_NS_MAX);
}

bool probability_ok(double value) {
    return value >= 0 && value <= 1;
}

static bool clock_ok(const clock_config_t *clock) {
    uint8_t bits = clock->stamp_bits == 0 ? 64 : clock->stamp_bits;
    return in_range(clock->boot_ns, 0, TIME_NS_MAX) && rate_ok(clock->rate_ppb) && rate_ok(clock->ramp_ppb) &&
           in_range(clock->ramp_ns, 0, TIME_NS_MAX / 16) && rate_ok(clock->step_ppb) &&
           in_range(clock->step_ns, 0, TIME_NS_MAX) && in_range(clock->walk_ppb, 0, OSCILLATOR_PPB_MAX) &&
           bits <= 64 && clock->quantum <= QUANTUM_1MS && (clock->divider == 84 || clock->divider == 85) &&
           (bits == 64 || clock->stamp_start_us >> bits == 0);
}

bool config_ok(const robot_config_t *config) {
    bool ok = true;
    for (int mcu = 0; mcu < MCU_COUNT; mcu++) {
        ok = ok && clock_ok(&config->clocks[mcu]);
    }
    for (int wire = 0; wire < WIRE_COUNT; wire++) {
        ok = ok && wire_faults_ok(&config->wires[wire]);
    }
    return ok && in_range(config->uart1_byte_ps, 1, BYTE_PS_MAX) &&
           in_range(config->uart1_gap8_byte_ps, 1, BYTE_PS_MAX) &&
           in_range(config->uart2_stm32_byte_ps, 1, BYTE_PS_MAX) &&
           in_range(config->uart2_esp32_byte_ps, 1, BYTE_PS_MAX) &&
           in_range(config->spi_byte_ps, 1, SPI_BYTE_PS_MAX) &&
           in_range(config->spi_gap_ns, 0, TIME_NS_MAX) && in_range(config->tcp_byte_ps, 0, BYTE_PS_MAX) &&
           in_range(config->tcp_window_bytes, TCP_SEGMENT_BYTES, BUFFER_MAX) &&
           in_range(config->tcp_rto_ns, 1, TIME_NS_MAX) && in_range(config->network_up_ns, 0, TIME_NS_MAX) &&
           in_range(config->camera_frame_ns, 1, TIME_NS_MAX) &&
           in_range(config->camera_jitter_ns, 0, TIME_NS_MAX) && probability_ok(config->camera_fail) &&
           probability_ok(config->camera_hang) && config->host_wire <= HOST_UART1 &&
           in_range(config->host_ring_bytes, TCP_SEGMENT_BYTES, BUFFER_MAX);
}
