#include "gap8.h"

enum { ADDRESS = 0x0, SIZE = 0x4, CFG = 0x8 };                        ///< of a channel
enum { RX = 0x00, TX = 0x10, UART_STATUS = 0x20, UART_SETUP = 0x24 }; ///< of a peripheral of the uDMA
enum { CHANNEL_CONTINUOUS = 1 << 0, CHANNEL_ENABLE = 1 << 4 };
enum {
    UART_SETUP_TX = 1 << 8,
    UART_SETUP_RX = 1 << 9,
    UART_SETUP_DIVIDER = 16,
    UART_BITS = 10,
    UART_MISMATCH_PERCENT = 4
};

enum { GPIO_IN = 0x04 / 4, GPIO_EVENT_ENABLE = 0x0C / 4, GPIO_TYPE_1 = 0x14 / 4, GPIO_STATUS = 0x18 / 4 };
enum { GPIO_PIN_ESP32 = 18, GPIO_RISE = 1 };

enum {
    CAMERA_COMMAND = 0,
    CAMERA_ADDRESS = 2,
    CAMERA_SIZE = 3,
    CAMERA_START = 4,
    CAMERA_LENGTH = 5,
};

/// Memory that a DMA can reach: L2. NULL after a failure.
static uint8_t *l2(emulator_t *e, uint32_t address, size_t size) {
    uint8_t *at = address >= GAP8_L2 ? emulator_ram_at(e, address, size) : NULL;
    if (at == NULL) {
        emulator_fail(e, "a DMA of %zu bytes at 0x%08x is not within L2", size, address);
    }
    return at;
}

static bool channel_read(const gap8_channel_t *channel, uint32_t offset, uint32_t *value) {
    switch (offset) {
    case ADDRESS:
        *value = channel->address;
        return true;
    case SIZE:
        *value = channel->size;
        return true;
    case CFG:
        *value = channel->cfg;
        return true;
    default:
        return false;
    }
}

/// Continuous transfers are modelled of one byte.
static void start(emulator_t *e, const gap8_channel_t *channel) {
    const bool again = channel->cfg == (CHANNEL_ENABLE | CHANNEL_CONTINUOUS) && channel->size == 1;
    if (channel->cfg != CHANNEL_ENABLE && !again) {
        emulator_fail(e, "its code starts a DMA of %u bytes with 0x%x, which is not modelled", channel->size,
                      channel->cfg);
        return;
    }
    l2(e, channel->address, channel->size);
}

// Transfers of bytes, one at a time: the queue of a second one is not modelled.
static bool channel_write(emulator_t *e, gap8_channel_t *channel, uint32_t offset, uint32_t value) {
    if (channel->cfg != 0) {
        emulator_fail(e, "its code sets up a DMA while the one before is under way");
        return true;
    }
    switch (offset) {
    case ADDRESS:
        channel->address = value;
        return true;
    case SIZE:
        channel->size = value;
        return true;
    case CFG:
        channel->cfg = value;
        start(e, channel);
        return true;
    default:
        return false;
    }
}

/// The transfer ends with what has come; a continuous one begins anew.
static void channel_receive(emulator_t *e, gap8_channel_t *channel, bytes_t in, const char *port) {
    if (channel->cfg == 0) {
        emulator_fail(e, "no DMA is set up for what comes on %s", port);
    } else if (in.size > channel->size) {
        emulator_fail(e, "%zu bytes come on %s, and the DMA has room for %u", in.size, port, channel->size);
    } else if (in.size != 0) {
        memcpy(emulator_at(e, channel->address, in.size), in.data, in.size);
    }
    if ((channel->cfg & CHANNEL_CONTINUOUS) == 0) {
        channel->size -= (uint32_t)in.size;
        channel->cfg = 0;
    }
}

int64_t gap8_uart_byte_ps(emulator_t *e) {
    return UART_BITS * (1000000 / GAP8_FC_MHZ) *
           (int64_t)((gap8_of(e)->uart_setup >> UART_SETUP_DIVIDER) + 1);
}

/// Nothing on the chip would tell its firmware.
static void check_baud(emulator_t *e) {
    const int64_t wire_ps = e->wire_byte_ps[GAP8_UART1];
    const int64_t own_ps = gap8_uart_byte_ps(e);
    const int64_t difference_ps = own_ps > wire_ps ? own_ps - wire_ps : wire_ps - own_ps;
    if (wire_ps != 0 && difference_ps * 100 > wire_ps * UART_MISMATCH_PERCENT) {
        emulator_fail(e, "UART1 is set up for bytes of %lld ns, and they take %lld",
                      (long long)(own_ps / 1000), (long long)(wire_ps / 1000));
    }
}

void gap8_uart_receive(emulator_t *e, bytes_t in) {
    gap8_machine_t *m = gap8_of(e);
    if ((m->uart_setup & UART_SETUP_RX) == 0) {
        return; // it does not listen
    }
    check_baud(e);
    for (size_t i = 0; i < in.size && !emulator_failed(e); i++) {
        channel_receive(e, &m->uart_rx, (bytes_t){in.data + i, 1}, "UART1");
        gap8_soc_event(e, GAP8_EVENT_UART_RX);
        emulator_run(e, false);
    }
}

// The event comes when the last byte has left; a real one comes when the DMA has moved it, and nothing
// depends on that.
void gap8_uart_sent(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    if (!m->uart_given) {
        return;
    }
    m->uart_given = false;
    m->uart_tx.address++;
    m->uart_tx.size--;
    if (m->uart_tx.size == 0) {
        m->uart_tx.cfg = 0;
        m->news = true;
        gap8_soc_event(e, GAP8_EVENT_UART_TX);
    }
}

size_t gap8_uart_take(emulator_t *e, bytes_mut_t out) {
    gap8_machine_t *m = gap8_of(e);
    if (m->uart_tx.cfg == 0 || m->uart_given || out.size == 0) {
        return 0;
    }
    if ((m->uart_setup & UART_SETUP_TX) == 0) {
        emulator_fail(e, "it sends on UART1, whose transmitter is off");
        return 0;
    }
    m->uart_given = true;
    out.data[0] = *emulator_at(e, m->uart_tx.address, 1);
    return 1;
}

bool gap8_uart_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    const gap8_machine_t *m = gap8_of(e);
    switch (offset) {
    case UART_STATUS:
        *value = 0;
        return true;
    case UART_SETUP:
        *value = m->uart_setup;
        return true;
    default:
        return offset >= TX ? channel_read(&m->uart_tx, offset - TX, value)
                            : channel_read(&m->uart_rx, offset, value);
    }
}

bool gap8_uart_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_machine_t *m = gap8_of(e);
    if (offset == UART_SETUP) {
        m->uart_setup = value;
        return true;
    }
    return offset >= TX ? channel_write(e, &m->uart_tx, offset - TX, value)
                        : channel_write(e, &m->uart_rx, offset, value);
}

void gap8_spi_receive(emulator_t *e, bytes_t in) {
    channel_receive(e, &gap8_of(e)->spi_rx, in, "SPI");
    gap8_soc_event(e, GAP8_EVENT_SPIM1_RX);
    emulator_run(e, false);
}

static void line_rises(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    const uint32_t type = m->gpio[GPIO_TYPE_1] >> (GPIO_PIN_ESP32 - 16) * 2 & 3;
    if ((m->gpio[GPIO_EVENT_ENABLE] >> GPIO_PIN_ESP32 & 1) != 0 && type == GPIO_RISE) {
        m->gpio[GPIO_STATUS] |= 1U << GPIO_PIN_ESP32;
        gap8_soc_event(e, GAP8_EVENT_GPIO);
    }
}

void gap8_spi_asked(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    if (m->spi_given) {
        m->spi_given = false;
        m->spi_tx.cfg = 0;
        m->news = true;
        m->gpio[GPIO_IN] &= ~(1U << GPIO_PIN_ESP32);
        gap8_soc_event(e, GAP8_EVENT_SPIM1_EOT);
    } else if (m->spi_tx.cfg == 0 && !m->news) {
        line_rises(e);
    }
}

void gap8_spi_window(emulator_t *e) {
    gap8_machine_t *m = gap8_of(e);
    m->gpio[GPIO_IN] |= 1U << GPIO_PIN_ESP32;
    line_rises(e);
    emulator_run(e, true);
    if (m->spi_tx.cfg == 0 || emulator_failed(e)) {
        return;
    }
    m->spi_given = true;
    const uint8_t *out = emulator_at(e, m->spi_tx.address, m->spi_tx.size);
    for (uint32_t i = 0; i < m->spi_tx.size; i++) {
        if (out[i] != 0) {
            emulator_fail(e, "it has something to say on SPI, a moment after it had nothing");
            return;
        }
    }
}

size_t gap8_spi_take(emulator_t *e, bytes_mut_t out) {
    gap8_machine_t *m = gap8_of(e);
    if (m->spi_tx.cfg == 0 || m->spi_given) {
        return 0;
    }
    const size_t size = m->spi_tx.size;
    if (size > out.size) {
        emulator_fail(e, "it sends %zu bytes on SPI, where %zu fit a window", size, out.size);
        return 0;
    }
    memcpy(out.data, emulator_at(e, m->spi_tx.address, size), size);
    m->spi_given = true;
    return size;
}

bool gap8_spi_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    const gap8_machine_t *m = gap8_of(e);
    return offset < TX ? channel_read(&m->spi_rx, offset, value)
                       : channel_read(&m->spi_tx, offset - TX, value);
}

bool gap8_spi_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_machine_t *m = gap8_of(e);
    return offset < TX ? channel_write(e, &m->spi_rx, offset, value)
                       : channel_write(e, &m->spi_tx, offset - TX, value);
}

bool gap8_gpio_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    uint32_t *at = &gap8_of(e)->gpio[offset / 4];
    *value = *at;
    if (offset / 4 == GPIO_STATUS) {
        *at = 0;
    }
    return true;
}

bool gap8_gpio_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_of(e)->gpio[offset / 4] = value;
    return offset / 4 != GPIO_STATUS;
}

void gap8_camera_receive(emulator_t *e, bytes_t body) {
    uint32_t *camera = gap8_of(e)->camera;
    if (body.size > camera[CAMERA_SIZE]) {
        emulator_fail(e,
                      "the camera's picture has %zu bytes, and the image keeps at most %u: smaller pictures",
                      body.size, camera[CAMERA_SIZE]);
        return;
    }
    uint8_t *to = body.size == 0 ? NULL : l2(e, camera[CAMERA_ADDRESS], body.size);
    if (to != NULL) {
        memcpy(to, body.data, body.size);
    }
    camera[CAMERA_LENGTH] = (uint32_t)body.size;
    gap8_raise(e, GAP8_LINE_CAMERA);
    emulator_run(e, false);
}

size_t gap8_camera_take(emulator_t *e, bytes_mut_t out) {
    gap8_machine_t *m = gap8_of(e);
    if (!m->camera_started || out.size < 8) {
        return 0;
    }
    m->camera_started = false;
    store32_le(out.data, m->camera[CAMERA_COMMAND]);
    store32_le(out.data + 4, m->camera[CAMERA_COMMAND + 1]);
    return 8;
}

bool gap8_camera_read(emulator_t *e, uint32_t offset, uint32_t *value) {
    *value = gap8_of(e)->camera[offset / 4];
    return true;
}

bool gap8_camera_write(emulator_t *e, uint32_t offset, uint32_t value) {
    gap8_machine_t *m = gap8_of(e);
    m->camera[offset / 4] = value;
    m->camera_started = m->camera_started || offset / 4 == CAMERA_START;
    return true;
}
