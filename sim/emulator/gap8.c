#include "gap8.h"

typedef struct {
    uint32_t address;
    uint32_t bytes;
    bool (*read)(emulator_t *e, uint32_t offset, uint32_t *value);
    bool (*write)(emulator_t *e, uint32_t offset, uint32_t value);
} block_t;

static bool soc_events_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    (void)offset;
    *value = gap8_soc_event_pop(e);
    return true;
}

static bool soc_masks_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    *value = gap8_of(e)->soc_masks[offset / 4];
    return true;
}

static bool soc_masks_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_of(e)->soc_masks[offset / 4] = value;
    return true;
}

// What these two say is not modelled: clocks run, and pads are what they should be.
static bool clocks_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    (void)offset;
    *value = gap8_of(e)->udma_clocks;
    return true;
}

static bool clocks_write(emulator_t *e, uint32_t offset, uint32_t value) {
    (void)offset;
    gap8_of(e)->udma_clocks = value;
    return true;
}

static bool pads_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    *value = gap8_of(e)->pads[offset / 4];
    return true;
}

static bool pads_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_of(e)->pads[offset / 4] = value;
    return true;
}

/// The most used first.
static const block_t BLOCKS[] = {
    {GAP8_TIMER, 0x28, gap8_timer_read, gap8_timer_write},
    {GAP8_SOC_EVENTS, 4, soc_events_read, NULL},
    {GAP8_EVENT_UNIT, 0x2C, gap8_event_unit_read, gap8_event_unit_write},
    {GAP8_UART, 0x28, gap8_uart_read, gap8_uart_write},
    {GAP8_SPIM1, 0x20, gap8_spi_read, gap8_spi_write},
    {GAP8_GPIO, 0x20, gap8_gpio_read, gap8_gpio_write},
    {GAP8_CAMERA, 0x1C, gap8_camera_read, gap8_camera_write},
    {GAP8_UDMA_CLOCKS, 4, clocks_read, clocks_write},
    {GAP8_PADS, 0x10, pads_read, pads_write},
    {GAP8_SOC_EVENT_MASKS, 8, soc_masks_read, soc_masks_write},
};

static const block_t *block_at(uint32_t address, unsigned size) {
    for (size_t i = 0; i < sizeof BLOCKS / sizeof BLOCKS[0]; i++) {
        if (address - BLOCKS[i].address < BLOCKS[i].bytes) {
            return size == 4 && address % 4 == 0 ? &BLOCKS[i] : NULL;
        }
    }
    return NULL;
}

static uint32_t bus_read(emulator_t *e, uint32_t address, unsigned size) {
    const block_t *block = block_at(address, size);
    uint32_t value = 0;
    if (block == NULL || !block->read(e, address - block->address, &value)) {
        emulator_fail(e, "its code reads %u bytes at 0x%08x, where this model has no register", size,
                      address);
    }
    return value;
}

static void bus_write(emulator_t *e, uint32_t address, unsigned size, uint32_t value) {
    const block_t *block = block_at(address, size);
    if (block == NULL || block->write == NULL || !block->write(e, address - block->address, value)) {
        emulator_fail(e, "its code writes %u bytes at 0x%08x, where this model has no register to be written",
                      size, address);
    }
}

static void reset(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    m->timers[0].match_ns = m->timers[1].match_ns = INT64_MAX;
    m->soc_masks[0] = m->soc_masks[1] = UINT32_MAX;
}

static void port_receive(emulator_t *e, int port, bytes_t in) {
    gap8_of(e)->news = true;
    switch (port) {
    case GAP8_UART1:
        gap8_uart_receive(e, in);
        break;
    case GAP8_SPI:
        gap8_spi_receive(e, in);
        break;
    default:
        gap8_camera_receive(e, in);
        break;
    }
}

static void port_asked(emulator_t *e, int port) {
    if (port == GAP8_SPI) {
        gap8_spi_asked(e);
    } else if (port == GAP8_UART1) {
        gap8_uart_sent(e);
    }
}

static size_t port_take(emulator_t *e, int port, bytes_mut_t out) {
    if (port == GAP8_UART1) { // the first to be asked: what else there is to send, the others take
        return gap8_uart_take(e, out);
    }
    gap8_of(e)->news = false;
    switch (port) {
    case GAP8_SPI:
        return gap8_spi_take(e, out);
    case GAP8_CAMERA_PORT:
        return gap8_camera_take(e, out);
    default:
        return 0;
    }
}

static int64_t alarm_ns(emulator_t *e) {
    return gap8_timer_ns(gap8_of(e));
}

static int64_t byte_ps(emulator_t *e, int port) {
    return port == GAP8_UART1 ? gap8_uart_byte_ps(e) : 0;
}

static void reset_stamp(emulator_t *e) {
    gap8_raise(e, GAP8_LINE_SOFTWARE);
}

const machine_t gap8_machine = {
    .name = "gap8",
    .cpu = &rv32_cpu,
    .memories = {{RV32_ROM, RV32_ROM_BYTES, false},
                 {GAP8_FC_TCDM, 16 * 1024, true},
                 {GAP8_L2, 512 * 1024, true}},
    .devices = {{0x00200000, 0x5000}, {0x1A101000, 0x6000}, {0x1A170000, 0x1000}},
    .state_bytes = sizeof(gap8_machine_t),
    .reset = reset,
    .read = bus_read,
    .write = bus_write,
    .receive = port_receive,
    .asked = port_asked,
    .take = port_take,
    .alarm_ns = alarm_ns,
    .alarm = gap8_timer_due,
    .byte_ps = byte_ps,
    .window = gap8_spi_window,
    .reset_stamp = reset_stamp,
};
