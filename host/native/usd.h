/// Rows of a uSD log: walked and copied into packed arrays, found again behind damage.
///
/// A row is a u16 id, a stamp (u64 us in version 2, u32 ms in version 1) and its values, packed,
/// little-endian. All memory is the caller's. Every function is bounded by the bytes it is given, whatever
/// they hold.
#ifndef SPINDECK_HOST_USD_H
#define SPINDECK_HOST_USD_H

#include "../../firmware/core/bytes.h"

enum {
    USD_TYPES_MAX = 255,
    USD_IDS = 65536,
    USD_ID_BYTES = 2,
    USD_CHECK_BYTES = 131072, ///< a CRC goes on this far at a time: it fits a cache
    USD_CHAIN = 3,     ///< rows in a row that prove a place after damage, when their times fit the row before
    USD_CHAIN_END = 2, ///< the same, when the bytes end behind them
    USD_CHAIN_LONG = 8, ///< rows that fit only each other
    USD_CHAIN_LONG_END = 3,
};

/// Why usd_walk has stopped.
enum {
    USD_END = 0,     ///< the last row ends where the bytes do
    USD_UNKNOWN = 1, ///< no type has this id
    USD_CUT = 2,     ///< the row here is longer than what is left
    USD_TIME = 3,    ///< strict only: the time of the row here does not follow from the row before
    USD_MARKS = 4,   ///< no room for another mark: empty them and go on
    USD_ROOM = 5,    ///< no room in `out` for the row here: make some and go on
};

/// usd_mark_t.kind
enum { USD_STATUS = 0, USD_BACK = 1 };

/// How the rows of one file lie: made by the caller from its header.
typedef struct {
    uint8_t stamp_bytes; ///< 8 or 4
    uint8_t types;
    uint8_t status;                    ///< the type whose rows are marked; `types`: none
    uint64_t back;                     ///< how far a stamp may lie behind the latest; in its unit
    uint64_t ahead;                    ///< and before it, in a walk
    uint64_t near;                     ///< the same in a chain, where rows have yet to be believed
    uint32_t row_bytes[USD_TYPES_MAX]; ///< with id and stamp
    uint8_t type_of_id[USD_IDS];       ///< the type + 1; 0: no type has this id
} usd_layout_t;

typedef struct {
    uint64_t offset; ///< of the row
    uint64_t before; ///< the latest stamp before it
    uint64_t stamp;
    uint8_t kind; ///< USD_STATUS, or USD_BACK: it lies more than `back` behind `before`
} usd_mark_t;

/// A walk under way, with room for two marks at least. The caller sets `at`, `marks`, `marks_max`,
/// `has_last`, `last`, `check`, `out` and `room`; the rest is 0.
typedef struct {
    uint64_t at;   ///< the next row
    uint64_t row;  ///< the one before it, if any was passed
    uint64_t last; ///< the latest stamp so far
    bool has_last;
    usd_mark_t *marks;
    uint32_t marks_max;
    uint32_t marks_count;
    uint64_t rows[USD_TYPES_MAX]; ///< passed, by type
    bool check;                   ///< compute `crc`, which costs less here than later: the bytes are at hand
    uint32_t crc;                 ///< of the bytes from the first to `at`
    uint64_t checked;             ///< how far it goes while the walk is under way
    uint8_t *const *out; ///< NULL, or by type where the stamps and values of its rows go, one after the other
    const uint64_t *room; ///< rows that fit there, those of `rows` included
} usd_walk_t;

/// Passes rows from `walk->at` on, until something stops it. Strict: also a time that is out of bounds, or
/// zeros that look like a row. A walk that is not strict takes the rows' times as they are.
uint8_t usd_walk(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk);

/// How many whole rows (at most `most`) follow each other at `at` with plausible times; the first is held
/// against `last` if there is one. `ends`: what stands behind them is the end, or a plausible row cut off
/// there.
uint32_t usd_chain(const usd_layout_t *layout, bytes_t in, uint64_t at, const uint64_t *last, uint32_t most,
                   bool *ends);

/// The first place from `at` on where USD_CHAIN rows follow `last` (if it is given), or USD_CHAIN_LONG rows
/// each other. `in.size`: none.
uint64_t usd_find(const usd_layout_t *layout, bytes_t in, uint64_t at, const uint64_t *last);

#endif
