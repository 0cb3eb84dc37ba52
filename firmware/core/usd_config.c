#include "usd_config.h"

#include "cpx.h"

enum { VERSION = 1, ON_BYTES = 3, VARIABLE_MIN = 4, MODE_MAX = 2, TICK_US = 1000 };

/// What the next line is.
enum {
    LINE_VERSION = 0,
    LINE_RING = 1,
    LINE_NAME = 2,
    LINE_STARTUP = 3,
    LINE_BLOCK = 4,     ///< "on:", or a variable
    LINE_FREQUENCY = 5, ///< of the block under way
    LINE_MODE = 6,
    LINE_SKIP = 7, ///< a variable of a block that is left out, or "on:"
    LINE_NEVER = 8 ///< the head is not usable
};

void usd_config_init(usd_config_t *self, const usd_table_t *table) {
    memset(self, 0, sizeof *self);
    self->table = table;
    self->line = 1;
}

static void found(usd_config_t *self, usd_finding_kind_t kind) {
    const uint32_t count = (uint32_t)self->errors + self->warnings;
    if (count < USD_CONFIG_FINDINGS_MAX) {
        self->findings[count] = (usd_finding_t){self->line, (uint8_t)kind};
    }
    uint16_t *counter = kind <= USD_ERROR_LAST ? &self->errors : &self->warnings;
    *counter = *counter == UINT16_MAX ? UINT16_MAX : (uint16_t)(*counter + 1);
}

/// The digits that the line begins with; false if there are none, or more than nine.
static bool number(usd_config_t *self, uint32_t max, uint32_t *value) {
    uint32_t sum = 0;
    uint8_t digits = 0;
    while (digits < self->size && self->text[digits] >= '0' && self->text[digits] <= '9') {
        if (digits == 9) {
            return false;
        }
        sum = sum * 10 + (uint32_t)(self->text[digits++] - '0');
    }
    if (digits == 0 || sum > max) {
        return false;
    }
    if (digits < self->size) {
        found(self, USD_WARNING_TRAILING);
    }
    *value = sum;
    return true;
}

/// Is this what the line says from its character `from` on?
static bool says(const usd_config_t *self, uint8_t from, const char *name) {
    const size_t size = strlen(name);
    return self->size == from + size && memcmp(self->text + from, name, size) == 0;
}

static void unusable(usd_config_t *self, usd_finding_kind_t kind) {
    found(self, kind);
    self->state = LINE_NEVER;
}

static void take_ring(usd_config_t *self) {
    uint32_t bytes;
    if (!number(self, UINT32_MAX, &bytes)) {
        unusable(self, USD_ERROR_NUMBER);
        return;
    }
    if (bytes < USD_CONFIG_RING_MIN || bytes > USD_CONFIG_RING_MAX) {
        found(self, USD_WARNING_RING);
        bytes = bytes < USD_CONFIG_RING_MIN ? USD_CONFIG_RING_MIN : USD_CONFIG_RING_MAX;
    }
    self->ring_bytes = (uint16_t)bytes;
    self->state = LINE_NAME;
}

static void take_name(usd_config_t *self) {
    for (uint8_t i = 0; i < self->size; i++) {
        const char each = self->text[i];
        if (each <= ' ' || each > '~' || memchr("\"*/:<>?\\|", each, 9) != NULL) {
            unusable(self, USD_ERROR_NAME);
            return;
        }
    }
    if (self->size > USD_CONFIG_NAME_MAX) {
        found(self, USD_WARNING_NAME_LONG);
        self->size = USD_CONFIG_NAME_MAX;
    }
    memcpy(self->name, self->text, self->size);
    self->state = LINE_STARTUP;
}

static void close_block(usd_config_t *self) {
    self->block_count = (uint8_t)(self->block_count + self->in_block);
    self->in_block = false;
}

/// The place of the line's event in the table, or USD_CONFIG_FIXED; -1: there is none of this name.
static int find_event(const usd_config_t *self) {
    for (int i = 0; i < self->table->event_count; i++) {
        if (says(self, ON_BYTES, self->table->events[i].name)) {
            return i;
        }
    }
    return says(self, ON_BYTES, "fixedFrequency") ? USD_CONFIG_FIXED : -1;
}

static void begin_block(usd_config_t *self) {
    close_block(self);
    self->state = LINE_SKIP;
    const int event = find_event(self);
    bool repeated = false;
    for (uint8_t i = 0; i < self->block_count; i++) {
        repeated = repeated || self->blocks[i].event == event;
    }
    if (event < 0 || repeated || self->block_count == USD_CONFIG_BLOCKS_MAX) {
        found(self, event < 0 ? USD_ERROR_EVENT : repeated ? USD_ERROR_REPEATED : USD_ERROR_FULL);
        return;
    }
    usd_block_t *block = &self->blocks[self->block_count];
    block->event = (uint16_t)event;
    block->variable_count = 0;
    self->in_block = event != USD_CONFIG_FIXED; // which has to get its mode first
    self->state = self->in_block ? LINE_BLOCK : LINE_FREQUENCY;
}

static void take_frequency(usd_config_t *self) {
    uint32_t hz;
    self->state = LINE_SKIP;
    if (!number(self, USD_CONFIG_HZ_MAX, &hz) || hz == 0) {
        found(self, USD_ERROR_FREQUENCY);
        return;
    }
    if (USD_CONFIG_HZ_MAX % hz != 0) {
        found(self, USD_WARNING_ROUNDED);
    }
    self->period_us = USD_CONFIG_HZ_MAX / hz * TICK_US;
    self->state = LINE_MODE;
}

static void take_mode(usd_config_t *self) {
    uint32_t mode = 0;
    const bool known = number(self, MODE_MAX, &mode);
    if (!known) {
        found(self, USD_ERROR_MODE);
    }
    self->in_block = mode != 0;
    self->state = self->in_block ? LINE_BLOCK : LINE_SKIP;
}

static void take_variable(usd_config_t *self) {
    if (self->state == LINE_SKIP) {
        return;
    }
    if (self->size < VARIABLE_MIN) {
        found(self, USD_WARNING_SHORT);
        return;
    }
    if (!self->in_block) {
        found(self, USD_ERROR_NO_BLOCK);
        return;
    }
    usd_block_t *block = &self->blocks[self->block_count];
    for (uint8_t i = 0; i < self->table->variable_count; i++) {
        if (says(self, 0, self->table->variables[i].name)) {
            if (block->variable_count == USD_CONFIG_VARIABLES_MAX) {
                found(self, USD_ERROR_FULL);
            } else {
                block->variables[block->variable_count++] = i;
            }
            return;
        }
    }
    found(self, USD_ERROR_VARIABLE);
}

static bool begins_block(const usd_config_t *self) {
    return self->size >= ON_BYTES && memcmp(self->text, "on:", ON_BYTES) == 0;
}

static void take_line(usd_config_t *self) {
    uint32_t value;
    switch (self->state) {
    case LINE_VERSION:
        if (!number(self, VERSION, &value) || value != VERSION) {
            unusable(self, USD_ERROR_VERSION);
            return;
        }
        self->state = LINE_RING;
        return;
    case LINE_RING:
        take_ring(self);
        return;
    case LINE_NAME:
        take_name(self);
        return;
    case LINE_STARTUP:
        if (!number(self, 1, &value)) {
            unusable(self, USD_ERROR_NUMBER);
            return;
        }
        self->on_startup = value == 1;
        self->state = LINE_BLOCK;
        return;
    case LINE_FREQUENCY:
        take_frequency(self);
        return;
    case LINE_MODE:
        take_mode(self);
        return;
    case LINE_NEVER:
        return;
    default:
        if (begins_block(self)) {
            begin_block(self);
        } else {
            take_variable(self);
        }
    }
}

/// Nothing of a line that is too long is used.
static void drop_line(usd_config_t *self) {
    found(self, USD_ERROR_LINE_LONG);
    if (self->state < LINE_BLOCK || self->state == LINE_NEVER) {
        self->state = LINE_NEVER;
    } else if (begins_block(self)) {
        close_block(self); // what follows is not its
        self->state = LINE_SKIP;
    } else if (self->state == LINE_FREQUENCY || self->state == LINE_MODE) {
        self->state = LINE_SKIP;
    }
}

static void end_line(usd_config_t *self) {
    if (self->long_line) {
        drop_line(self);
    } else if (self->size > 0) {
        take_line(self);
    } else if (!self->comment && self->state < LINE_BLOCK) {
        found(self, USD_WARNING_BLANK);
    }
    self->size = 0;
    self->comment = false;
    self->seen = false;
    self->long_line = false;
    self->line = self->line == UINT16_MAX ? UINT16_MAX : (uint16_t)(self->line + 1);
}

static bool is_space(uint8_t byte) {
    return byte == ' ' || (byte >= '\t' && byte <= '\r');
}

void usd_config_put(usd_config_t *self, bytes_t in) {
    for (size_t i = 0; i < in.size; i++) {
        const uint8_t byte = in.data[i];
        if (byte == '\n') {
            end_line(self);
            continue;
        }
        self->seen = true;
        self->comment = self->comment || byte == '#';
        if (self->comment || is_space(byte)) {
            continue;
        }
        if (self->size == USD_CONFIG_LINE_MAX) {
            self->long_line = true;
        } else {
            self->text[self->size++] = (char)byte;
        }
    }
}

int usd_config_end(usd_config_t *self) {
    if (self->seen) {
        if (self->size > 0) {
            found(self, USD_WARNING_NO_NEWLINE);
        }
        end_line(self);
    }
    close_block(self);
    if (self->state < LINE_BLOCK) {
        found(self, USD_ERROR_HEAD);
        return ERR_VALUE;
    }
    if (self->state == LINE_FREQUENCY || self->state == LINE_MODE) {
        found(self, USD_ERROR_CUT);
    }
    bool fixed = false;
    for (uint8_t i = 0; i < self->block_count; i++) {
        fixed = fixed || self->blocks[i].event == USD_CONFIG_FIXED;
    }
    self->period_us = fixed ? self->period_us : 0;
    return self->state == LINE_NEVER || self->block_count == 0 ? ERR_VALUE : 0;
}
