#include "usd.h"

#include "crc32.h"

enum { NO_TYPE = USD_TYPES_MAX };

/// No clock of a robot runs this long (year-long stamps are zeroed or erased bytes, or no stamps).
static uint64_t stamp_max(const usd_layout_t *layout) {
    return layout->stamp_bytes == 8 ? UINT64_C(1) << 48 : UINT32_MAX;
}

static inline uint64_t stamp_at(const usd_layout_t *layout, const uint8_t *row) {
    return layout->stamp_bytes == 8 ? load64_le(row + USD_ID_BYTES) : load32_le(row + USD_ID_BYTES);
}

/// The type of the row at `at`, NO_TYPE if its id is unknown. There are at least USD_ID_BYTES.
static inline uint8_t type_at(const usd_layout_t *layout, const uint8_t *row) {
    return (uint8_t)(layout->type_of_id[load16_le(row)] - 1U);
}

static inline bool follows(const usd_layout_t *layout, uint64_t stamp, uint64_t last, uint64_t ahead) {
    return stamp >= last ? stamp - last <= ahead : last - stamp <= layout->back;
}

/// Zeros are a row where a type has the id 0; what was never written is full of them.
static inline bool believable(const usd_layout_t *layout, const uint8_t *row, uint64_t stamp) {
    return stamp < stamp_max(layout) && (stamp != 0 || load16_le(row) != 0);
}

static void check(bytes_t in, usd_walk_t *walk) {
    if (walk->check) {
        walk->crc = crc32_host(walk->crc, (bytes_t){in.data + walk->checked, walk->at - walk->checked});
        walk->checked = walk->at;
    }
}

static uint8_t pass(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk) {
    const size_t head = USD_ID_BYTES + layout->stamp_bytes;
    // Most rows are of the type of the row before. To compare with that one lets the processor go on without
    // waiting for the table; so does keeping `at` and `last` out of memory.
    uint16_t id = 0;
    uint8_t type = NO_TYPE;
    uint32_t size = 0;
    uint64_t at = walk->at;
    uint64_t last = walk->last;
    uint8_t why = USD_END;
    while (at < in.size) {
        const uint8_t *row = in.data + at;
        const uint64_t left = in.size - at;
        if (left < head) {
            why = USD_CUT;
            break;
        }
        if (type == NO_TYPE || load16_le(row) != id) {
            id = load16_le(row);
            type = type_at(layout, row);
            if (type == NO_TYPE) {
                why = USD_UNKNOWN;
                break;
            }
            size = layout->row_bytes[type];
        }
        const uint64_t stamp = stamp_at(layout, row);
        if (strict && (!believable(layout, row, stamp) ||
                       (walk->has_last && !follows(layout, stamp, last, layout->ahead)))) {
            why = USD_TIME;
            break;
        }
        if (left < size) {
            why = USD_CUT;
            break;
        }
        const bool back = walk->has_last && stamp < last;
        const bool far_back = back && last - stamp > layout->back;
        const bool status = type == layout->status;
        if (far_back || status) {
            if (walk->marks_max - walk->marks_count < (uint32_t)far_back + status) {
                why = USD_MARKS;
                break;
            }
            if (far_back) {
                walk->marks[walk->marks_count++] = (usd_mark_t){at, last, stamp, USD_BACK};
            }
            if (status) {
                walk->marks[walk->marks_count++] = (usd_mark_t){at, last, stamp, USD_STATUS};
            }
        }
        if (!back || far_back) {
            last = stamp;
        }
        walk->has_last = true;
        walk->rows[type]++;
        walk->row = at;
        at += size;
        if (walk->check && at - walk->checked >= USD_CHECK_BYTES) {
            walk->at = at;
            check(in, walk);
        }
    }
    walk->at = at;
    walk->last = last;
    return why;
}

uint8_t usd_walk(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk) {
    const uint8_t why = pass(layout, in, strict, walk);
    check(in, walk);
    return why;
}

uint32_t usd_chain(const usd_layout_t *layout, bytes_t in, uint64_t at, const uint64_t *last, uint32_t most,
                   bool *ends) {
    const size_t head = USD_ID_BYTES + layout->stamp_bytes;
    uint64_t before = last != NULL ? *last : 0;
    bool has_before = last != NULL;
    *ends = false;
    for (uint32_t rows = 0; rows < most; rows++) {
        if (at > in.size || in.size - at < head) {
            *ends = true;
            return rows;
        }
        const uint8_t *row = in.data + at;
        const uint8_t type = type_at(layout, row);
        if (type == NO_TYPE) {
            return rows;
        }
        const uint64_t stamp = stamp_at(layout, row);
        if (!believable(layout, row, stamp) ||
            (has_before && !follows(layout, stamp, before, layout->near))) {
            return rows;
        }
        before = stamp;
        has_before = true;
        if (layout->row_bytes[type] > in.size - at) {
            *ends = true;
            return rows;
        }
        at += layout->row_bytes[type];
    }
    return most;
}

uint64_t usd_find(const usd_layout_t *layout, bytes_t in, uint64_t at, const uint64_t *last) {
    for (; at < in.size; at++) {
        bool ends = false;
        if (last != NULL) {
            const uint32_t rows = usd_chain(layout, in, at, last, USD_CHAIN, &ends);
            if (rows >= USD_CHAIN || (ends && rows >= USD_CHAIN_END)) {
                return at;
            }
        }
        const uint32_t rows = usd_chain(layout, in, at, NULL, USD_CHAIN_LONG, &ends);
        if (rows >= USD_CHAIN_LONG || (ends && rows >= USD_CHAIN_LONG_END)) {
            return at;
        }
    }
    return in.size;
}

/// memcpy for some dozens of bytes, without a call.
static inline void copy(uint8_t *restrict to, const uint8_t *restrict from, size_t size) {
    enum { BLOCK = 16 };
    if (size < BLOCK) {
        memcpy(to, from, size);
        return;
    }
    for (size_t at = 0; at + BLOCK < size; at += BLOCK) {
        memcpy(to + at, from + at, BLOCK);
    }
    memcpy(to + size - BLOCK, from + size - BLOCK, BLOCK);
}

bool usd_copy(const usd_layout_t *layout, bytes_t in, uint64_t at, uint64_t end, uint8_t *const *out,
              const uint64_t *room, uint64_t *filled) {
    if (end > in.size) {
        return false;
    }
    while (at < end) {
        if (end - at < USD_ID_BYTES) {
            return false;
        }
        const uint16_t id = load16_le(in.data + at);
        const uint8_t type = type_at(layout, in.data + at);
        if (type == NO_TYPE) {
            return false;
        }
        const uint32_t size = layout->row_bytes[type];
        const size_t kept = size - USD_ID_BYTES;
        uint8_t *to = out[type] + filled[type] * kept;
        uint64_t left = room[type] - filled[type];
        // As long as rows are of this type.
        do {
            if (size > end - at || left == 0) {
                return false;
            }
            copy(to, in.data + at + USD_ID_BYTES, kept);
            to += kept;
            left--;
            filled[type]++;
            at += size;
        } while (end - at >= USD_ID_BYTES && load16_le(in.data + at) == id);
    }
    return true;
}
