#include "usd.h"

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

static inline bool follows(const usd_layout_t *layout, uint64_t stamp, uint64_t last) {
    return stamp >= last ? stamp - last <= layout->ahead : last - stamp <= layout->back;
}

/// Zeros are a row where a type has the id 0; what was never written is full of them.
static inline bool believable(const usd_layout_t *layout, const uint8_t *row, uint64_t stamp) {
    return stamp < stamp_max(layout) && (stamp != 0 || load16_le(row) != 0);
}

static bool add_mark(usd_walk_t *walk, uint8_t kind, uint64_t stamp) {
    if (walk->marks_count >= walk->marks_max) {
        return false;
    }
    walk->marks[walk->marks_count++] = (usd_mark_t){walk->at, walk->last, stamp, kind};
    return true;
}

uint8_t usd_walk(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk) {
    const size_t head = USD_ID_BYTES + layout->stamp_bytes;
    while (walk->at < in.size) {
        const uint8_t *row = in.data + walk->at;
        const uint64_t left = in.size - walk->at;
        if (left < head) {
            return USD_CUT;
        }
        const uint8_t type = type_at(layout, row);
        if (type == NO_TYPE) {
            return USD_UNKNOWN;
        }
        const uint32_t size = layout->row_bytes[type];
        const uint64_t stamp = stamp_at(layout, row);
        if (strict &&
            (!believable(layout, row, stamp) || (walk->has_last && !follows(layout, stamp, walk->last)))) {
            return USD_TIME;
        }
        if (left < size) {
            return USD_CUT;
        }
        const bool back = walk->has_last && stamp < walk->last;
        const bool far_back = back && walk->last - stamp > layout->back;
        if (far_back && !add_mark(walk, USD_BACK, stamp)) {
            return USD_MARKS;
        }
        if (type == layout->status && !add_mark(walk, USD_STATUS, stamp)) {
            walk->marks_count -= far_back;
            return USD_MARKS;
        }
        if (!back || far_back) {
            walk->last = stamp;
        }
        walk->has_last = true;
        walk->rows[type]++;
        walk->row = walk->at;
        walk->at += size;
    }
    return USD_END;
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
        if (!believable(layout, row, stamp) || (has_before && !follows(layout, stamp, before))) {
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
            if (rows >= USD_CHAIN || (ends && rows > 0)) {
                return at;
            }
        }
        const uint32_t rows = usd_chain(layout, in, at, NULL, USD_CHAIN_LONG, &ends);
        if (rows >= USD_CHAIN_LONG || (ends && rows >= USD_CHAIN_END)) {
            return at;
        }
    }
    return in.size;
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
        const uint8_t type = type_at(layout, in.data + at);
        if (type == NO_TYPE || layout->row_bytes[type] > end - at || filled[type] >= room[type]) {
            return false;
        }
        const size_t size = layout->row_bytes[type] - USD_ID_BYTES;
        memcpy(out[type] + filled[type] * size, in.data + at + USD_ID_BYTES, size);
        filled[type]++;
        at += layout->row_bytes[type];
    }
    return true;
}
