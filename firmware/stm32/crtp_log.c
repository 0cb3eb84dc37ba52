#include "crtp_log.h"

#include "../core/checks.h"
#include "grid.h"

enum {
    PORT = 5 << 4,
    TOC = 0, ///< channels
    SETTINGS = 1,
    VALUES = 2,
    TOC_ITEM = 2,
    TOC_INFO = 3,
    STOP = 4,
    DELETE = 2,
    START = 3,
    RESET = 5,
    CREATE = 6,
    APPEND = 7,
    TYPE_MASK = 0x0F,
    VARIABLE_BYTES = 3, ///< in a request: type, place in the table
    HEAD_BYTES = 5,     ///< before values: header, block, ms
    NO_SUCH = 2,        ///< errno.h of the Crazyflie: ENOENT
    TOO_LONG = 7,       ///< E2BIG
    NO_ROOM = 12,       ///< ENOMEM
    EXISTS = 17,        ///< EEXIST
    UNFIT = 22,         ///< EINVAL
};

/// By its number in this protocol; 0: none.
static uint8_t number_of(char type) {
    static const char LETTERS[] = "BHIbhif";
    const char *found = memchr(LETTERS, type, sizeof LETTERS - 1);
    return found == NULL ? 0 : (uint8_t)(found - LETTERS + 1);
}

void crtp_log_reset(crtp_log_t *self) {
    memset(self, 0, sizeof *self);
    self->next_us = NEVER_US;
}

static void schedule(crtp_log_t *self) {
    self->next_us = NEVER_US;
    for (size_t i = 0; i < CRTP_LOG_BLOCKS; i++) {
        const crtp_log_block_t *block = &self->blocks[i];
        self->next_us = block->used && block->next_us < self->next_us ? block->next_us : self->next_us;
    }
}

static crtp_log_block_t *block_of(crtp_log_t *self, uint8_t id) {
    for (size_t i = 0; i < CRTP_LOG_BLOCKS; i++) {
        if (self->blocks[i].used && self->blocks[i].id == id) {
            return &self->blocks[i];
        }
    }
    return NULL;
}

static uint32_t checksum(const usd_table_t *table) {
    uint32_t crc = 0;
    for (uint8_t i = 0; i < table->variable_count; i++) {
        const usd_variable_t *variable = &table->variables[i];
        crc = crc32_zlib(crc, (bytes_t){(const uint8_t *)variable->name, strlen(variable->name) + 1});
        crc = crc32_zlib(crc, (bytes_t){(const uint8_t *)&variable->type, 1});
    }
    return crc;
}

/// u8 command, u16 count, u32 checksum, u8 most blocks, u8 most variables.
static size_t tell_info(const usd_table_t *table, uint8_t *out) {
    store16_le(out + 2, table->variable_count);
    store32_le(out + 4, checksum(table));
    out[8] = CRTP_LOG_BLOCKS;
    out[9] = CRTP_LOG_BLOCKS * CRTP_LOG_BYTES_MAX;
    return 10;
}

/// u8 command, u16 place, u8 type, group, 0, name, 0. The command alone: there is no such place.
static size_t tell_item(const usd_table_t *table, uint16_t place, uint8_t *out) {
    if (place >= table->variable_count) {
        return 2;
    }
    const usd_variable_t *variable = &table->variables[place];
    const size_t size = strlen(variable->name) + 1;
    store16_le(out + 2, place);
    out[4] = number_of(variable->type);
    memcpy(out + 5, variable->name, size);
    uint8_t *point = memchr(out + 5, '.', size);
    if (point != NULL) {
        *point = 0;
    }
    return 5 + size;
}

static uint8_t append(crtp_log_block_t *block, const usd_table_t *table, bytes_t in) {
    usd_block_t more = block->variables;
    for (size_t at = 0; at + VARIABLE_BYTES <= in.size; at += VARIABLE_BYTES) {
        const uint16_t place = load16_le(in.data + at + 1);
        if (place >= table->variable_count) {
            return NO_SUCH;
        }
        if ((in.data[at] & TYPE_MASK) != number_of(table->variables[place].type)) {
            return UNFIT;
        }
        if (more.variable_count == CRTP_LOG_BYTES_MAX) {
            return TOO_LONG;
        }
        more.variables[more.variable_count++] = (uint8_t)place;
    }
    if (usd_row_bytes(table, &more) > USD_ROW_HEAD_BYTES + CRTP_LOG_BYTES_MAX) {
        return TOO_LONG;
    }
    block->variables = more;
    return 0;
}

static uint8_t create(crtp_log_t *self, const usd_table_t *table, uint8_t id, bytes_t in) {
    if (block_of(self, id) != NULL) {
        return EXISTS;
    }
    for (size_t i = 0; i < CRTP_LOG_BLOCKS; i++) {
        crtp_log_block_t *block = &self->blocks[i];
        if (!block->used) {
            *block = (crtp_log_block_t){.id = id, .next_us = NEVER_US};
            block->variables.event = USD_CONFIG_FIXED;
            const uint8_t error = append(block, table, in);
            block->used = error == 0;
            return error;
        }
    }
    return NO_ROOM;
}

static uint8_t start(crtp_log_block_t *block, bytes_t in, uint64_t now_us) {
    if (in.size == 0 || in.data[0] == 0) {
        return UNFIT;
    }
    block->period_us = (uint32_t)in.data[0] * CRTP_LOG_PERIOD_US;
    block->next_us = now_us;
    return 0;
}

/// Of a command that is one; else UINT8_MAX.
static uint8_t set(crtp_log_t *self, const usd_table_t *table, bytes_t in, uint64_t now_us) {
    const uint8_t command = in.data[0];
    const bytes_t rest = {in.data + 2, in.size - 2};
    crtp_log_block_t *block = block_of(self, in.data[1]);
    if (command == CREATE) {
        return create(self, table, in.data[1], rest);
    }
    if (command == RESET) {
        crtp_log_reset(self);
        return 0;
    }
    if (command != APPEND && command != DELETE && command != START && command != STOP) {
        return UINT8_MAX;
    }
    if (block == NULL) {
        return NO_SUCH;
    }
    switch (command) {
    case APPEND:
        return append(block, table, rest);
    case START:
        return start(block, rest, now_us);
    case STOP:
        block->next_us = NEVER_US;
        return 0;
    default:
        block->used = false;
        return 0;
    }
}

size_t crtp_log_receive(crtp_log_t *self, const usd_table_t *table, bytes_t in, uint64_t now_us,
                        uint8_t out[40]) {
    const uint8_t channel = in.data[0] & 3U;
    if (in.size < 2) {
        return 0;
    }
    out[0] = in.data[0];
    out[1] = in.data[1];
    if (channel == TOC && in.data[1] == TOC_INFO) {
        return tell_info(table, out);
    }
    if (channel == TOC && in.data[1] == TOC_ITEM && in.size >= 4) {
        return tell_item(table, load16_le(in.data + 2), out);
    }
    const bool resets = in.data[1] == RESET;
    if (channel != SETTINGS || (in.size < 3 && !resets)) {
        return 0;
    }
    const uint8_t request[] = {RESET, 0};
    const bytes_t command =
        in.size < 3 ? (bytes_t){request, sizeof request} : (bytes_t){in.data + 1, in.size - 1};
    const uint8_t error = set(self, table, command, now_us);
    schedule(self);
    out[2] = command.data[1];
    out[3] = error;
    return error == UINT8_MAX ? 0 : 4;
}

size_t crtp_log_values(crtp_log_t *self, const usd_table_t *table, uint64_t now_us, const void *values,
                       uint8_t out[40]) {
    uint8_t row[USD_ROW_BYTES_MAX];
    for (size_t i = 0; i < CRTP_LOG_BLOCKS; i++) {
        crtp_log_block_t *block = &self->blocks[i];
        if (!block->used || now_us < block->next_us) {
            continue;
        }
        block->next_us = next_on_grid(block->next_us, block->period_us, now_us);
        schedule(self);
        const size_t size = usd_row_encode(table, &block->variables, 0, values, row) - USD_ROW_HEAD_BYTES;
        out[0] = PORT | VALUES;
        out[1] = block->id;
        store32_le(out + 2, (uint32_t)(now_us / 1000)); // of which 24 bits go
        memcpy(out + HEAD_BYTES, row + USD_ROW_HEAD_BYTES, size);
        return HEAD_BYTES + size;
    }
    return 0;
}
