/// config.txt on the card: which variables the STM32 logs, how often, and into which file.
///
/// The text is taken in pieces of any size, as they come off the card. White space does not count, nor does
/// what follows a '#'. Four lines: the version, 1; the bytes of the ring between the rows and the card; the
/// name of the file; 0 or 1: whether logging begins at boot. Then blocks: "on:fixedFrequency", a frequency, a
/// mode (0 off, 1 and 2 on) and one variable a line; or "on:" and an event, and one variable a line.
///
/// Files that the firmware of the Crazyflie takes mean the same here. Where that firmware goes wrong without
/// a word, there is a finding with its line: an error if something that was asked for is not logged, else a
/// warning. The rest is logged.
#ifndef SPINDECK_CORE_USD_CONFIG_H
#define SPINDECK_CORE_USD_CONFIG_H

#include "bytes.h"

enum {
    USD_CONFIG_LINE_MAX = 31, ///< characters that count
    USD_CONFIG_NAME_MAX = 10, ///< of a file; two digits follow
    USD_CONFIG_BLOCKS_MAX = 20,
    USD_CONFIG_VARIABLES_MAX = 32, ///< in a block
    USD_CONFIG_PAYLOAD_MAX = 4,    ///< values that an event carries of its own
    USD_CONFIG_FINDINGS_MAX = 16,  ///< that are kept; all are counted
    USD_CONFIG_HZ_MAX = 1000,
    /// Bytes; what asks for less gets this. The card takes whole sectors, so up to 511 bytes wait for the
    /// rest of theirs; beside them the widest row (USD_ROW_BYTES_MAX), the status row of the next sync and
    /// the file's end (USD_LOG_END_BYTES) must fit: 511 + 154 + 42 + 46. In 512, which many files say, a log
    /// stops when its first sector is almost full.
    USD_CONFIG_RING_MIN = 753,
    USD_CONFIG_RING_MAX = 65535, ///< likewise, for more
    USD_CONFIG_FIXED = 0xFFFF,   ///< usd_block_t.event of the block with a frequency; its id in the file
};

/// usd_finding_t.kind. Up to USD_ERROR_LAST they are errors.
typedef enum {
    USD_ERROR_VERSION = 0,    ///< line 1 is not 1
    USD_ERROR_NUMBER = 1,     ///< not a number, or one that is out of range
    USD_ERROR_NAME = 2,       ///< no name, or with characters that no file name has
    USD_ERROR_HEAD = 3,       ///< the text ends within the first four lines
    USD_ERROR_LINE_LONG = 4,  ///< more than USD_CONFIG_LINE_MAX characters: the line is left out
    USD_ERROR_EVENT = 5,      ///< no such event: its block is left out
    USD_ERROR_VARIABLE = 6,   ///< no such variable: it is left out
    USD_ERROR_NO_BLOCK = 7,   ///< a variable before any "on:"
    USD_ERROR_REPEATED = 8,   ///< a second block for the same event: it is left out
    USD_ERROR_FULL = 9,       ///< too many blocks, or variables in one: left out
    USD_ERROR_FREQUENCY = 10, ///< not 1..USD_CONFIG_HZ_MAX: the block is left out
    USD_ERROR_MODE = 11,      ///< not 0..2: the block is left out
    USD_ERROR_CUT = 12,       ///< the text ends before the frequency or the mode
    USD_ERROR_LAST = 12,
    USD_WARNING_ROUNDED = 13,    ///< 1000 is no multiple of the frequency: the next higher is taken
    USD_WARNING_RING = 14,       ///< the ring gets the least or the most that there is
    USD_WARNING_NAME_LONG = 15,  ///< cut to USD_CONFIG_NAME_MAX
    USD_WARNING_NO_NEWLINE = 16, ///< the last line has none: the Crazyflie's firmware does not see it
    USD_WARNING_BLANK = 17,      ///< in the head: the Crazyflie's firmware takes it for a value
    USD_WARNING_SHORT = 18,      ///< a line of 1 to 3 characters is ignored
    USD_WARNING_TRAILING = 19,   ///< something stands behind a number: it is ignored
} usd_finding_kind_t;

/// One value of a row.
typedef struct {
    char name[32];   ///< "group.name"
    char type;       ///< as in the file: B b H h I i f
    uint16_t offset; ///< in the values that the caller gives for each row
} usd_variable_t;

typedef struct {
    char name[32];
    uint8_t payload_count;
    usd_variable_t payload[4]; ///< what the event carries of its own, before the variables
} usd_event_t;

/// What can be logged: constants of the app. An event's place in the table is its id in the file; that of
/// status rows is event_count.
typedef struct {
    const usd_variable_t *variables;
    const usd_event_t *events;
    uint8_t variable_count;
    uint8_t event_count;
} usd_table_t;

/// A kind of row.
typedef struct {
    uint16_t event; ///< place in the table, or USD_CONFIG_FIXED
    uint8_t variable_count;
    uint8_t variables[32]; ///< places in the table
} usd_block_t;

typedef struct {
    uint16_t line; ///< 1 is the first
    uint8_t kind;  ///< usd_finding_kind_t
} usd_finding_t;

/// The parser, and what it has found.
typedef struct {
    uint32_t period_us; ///< of rows at a fixed frequency; 0: none
    uint16_t ring_bytes;
    bool on_startup;
    char name[11]; ///< NUL-terminated
    uint8_t block_count;
    usd_block_t blocks[20];
    uint16_t errors;
    uint16_t warnings;
    usd_finding_t findings[16]; ///< the first of them
    // Private from here on.
    uint16_t line;
    uint8_t state;
    uint8_t size; ///< of `text`
    bool comment;
    bool seen; ///< something stands in this line, if only white space or a comment
    bool long_line;
    bool in_block; ///< of `blocks[block_count]`, which is under way
    char text[31];
    const usd_table_t *table;
} usd_config_t;

/// `table` must live as long as `self`.
void usd_config_init(usd_config_t *self, const usd_table_t *table);

/// The next piece of the text.
void usd_config_put(usd_config_t *self, bytes_t in);

/// The text is over. 0, or ERR_VALUE when there is nothing that could be logged: the head is not usable, or
/// no block is left.
int usd_config_end(usd_config_t *self);

#endif
