#include "usd_file.h"

#include "checks.h"

static const char FIXED_NAME[] = "fixedFrequency";
static const char STATUS_NAME[] = "log.status";
static const char STATUS_VARIABLES[][10] = {"requested", "accepted", "dropped", "stall_us",
                                            "syncs",     "errors",   "session", "crc"};
enum { STATUS_VARIABLE_COUNT = sizeof STATUS_VARIABLES / sizeof STATUS_VARIABLES[0] };

/// Bytes go by; those from `from` on are kept, while there is room.
typedef struct {
    uint32_t from;
    uint32_t at;
    size_t fill;
    bytes_mut_t out;
} window_t;

static void put(window_t *self, const void *bytes, size_t size) {
    for (size_t i = 0; i < size; i++, self->at++) {
        if (self->at >= self->from && self->fill < self->out.size) {
            self->out.data[self->fill++] = ((const uint8_t *)bytes)[i];
        }
    }
}

static void put16(window_t *self, uint16_t value) {
    uint8_t bytes[2];
    store16_le(bytes, value);
    put(self, bytes, sizeof bytes);
}

static void put_name(window_t *self, const char *name) {
    put(self, name, strlen(name) + 1);
}

static void put_variable(window_t *self, const char *name, char type) {
    const char end[] = {'(', type, ')', 0};
    put(self, name, strlen(name));
    put(self, end, sizeof end);
}

static size_t payload_count(const usd_table_t *table, const usd_block_t *block) {
    return block->event == USD_CONFIG_FIXED ? 0 : table->events[block->event].payload_count;
}

static const usd_variable_t *variable_of(const usd_table_t *table, const usd_block_t *block, size_t place) {
    const size_t own = payload_count(table, block);
    return place < own ? &table->events[block->event].payload[place]
                       : &table->variables[block->variables[place - own]];
}

static size_t value_count(const usd_table_t *table, const usd_block_t *block) {
    return payload_count(table, block) + block->variable_count;
}

static void put_type(window_t *self, const usd_table_t *table, const usd_block_t *block) {
    const size_t count = value_count(table, block);
    put16(self, block->event);
    put_name(self, block->event == USD_CONFIG_FIXED ? FIXED_NAME : table->events[block->event].name);
    put16(self, (uint16_t)count);
    for (size_t i = 0; i < count; i++) {
        const usd_variable_t *variable = variable_of(table, block, i);
        put_variable(self, variable->name, variable->type);
    }
}

size_t usd_header_encode(const usd_config_t *config, uint32_t from, bytes_mut_t out) {
    window_t window = {.from = from, .out = out};
    const uint8_t magic = USD_FILE_MAGIC;
    put(&window, &magic, 1);
    put16(&window, USD_FILE_VERSION);
    put16(&window, (uint16_t)(config->block_count + 1));
    for (uint8_t i = 0; i < config->block_count; i++) {
        put_type(&window, config->table, &config->blocks[i]);
    }
    put16(&window, config->table->event_count);
    put_name(&window, STATUS_NAME);
    put16(&window, STATUS_VARIABLE_COUNT);
    for (uint8_t i = 0; i < STATUS_VARIABLE_COUNT; i++) {
        put_variable(&window, STATUS_VARIABLES[i], 'I');
    }
    return window.fill;
}

static size_t type_bytes(char type) {
    return type == 'B' || type == 'b' ? 1 : type == 'H' || type == 'h' ? 2 : 4;
}

size_t usd_row_bytes(const usd_table_t *table, const usd_block_t *block) {
    size_t bytes = USD_ROW_HEAD_BYTES;
    for (size_t i = 0; i < value_count(table, block); i++) {
        bytes += type_bytes(variable_of(table, block, i)->type);
    }
    return bytes;
}

static size_t store(uint8_t *out, const uint8_t *value, size_t bytes) {
    uint16_t half;
    uint32_t word;
    switch (bytes) {
    case 1:
        *out = *value;
        break;
    case 2:
        memcpy(&half, value, sizeof half);
        store16_le(out, half);
        break;
    default:
        memcpy(&word, value, sizeof word);
        store32_le(out, word);
    }
    return bytes;
}

size_t usd_row_encode(const usd_table_t *table, const usd_block_t *block, uint64_t stamp_us,
                      const void *values, uint8_t out[154]) {
    store16_le(out, block->event);
    store64_le(out + 2, stamp_us);
    size_t size = USD_ROW_HEAD_BYTES;
    for (size_t i = 0; i < value_count(table, block); i++) {
        const usd_variable_t *variable = variable_of(table, block, i);
        size += store(out + size, (const uint8_t *)values + variable->offset, type_bytes(variable->type));
    }
    return size;
}

void usd_status_encode(const usd_table_t *table, const usd_counters_t *counters, uint64_t stamp_us,
                       uint32_t crc, uint8_t out[42]) {
    const uint32_t values[] = {counters->requested, counters->accepted, counters->dropped, counters->stall_us,
                               counters->syncs,     counters->errors,   counters->session};
    store16_le(out, table->event_count);
    store64_le(out + 2, stamp_us);
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        store32_le(out + USD_ROW_HEAD_BYTES + 4 * i, values[i]);
    }
    store32_le(out + USD_STATUS_CRC_AT, crc32_zlib(crc, (bytes_t){out, USD_STATUS_CRC_AT}));
}
