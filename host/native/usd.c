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

/// memcpy for some dozens of bytes, without a call.
static inline void copy(uint8_t *restrict to, const uint8_t *restrict from, size_t size) {
    enum { HALF = 16, BLOCK = 32 };
    if (size < HALF) {
        memcpy(to, from, size);
    } else if (size < BLOCK) {
        memcpy(to, from, HALF);
        memcpy(to + size - HALF, from + size - HALF, HALF);
    } else {
        for (size_t at = 0; at + BLOCK < size; at += BLOCK) {
            memcpy(to + at, from + at, BLOCK);
        }
        memcpy(to + size - BLOCK, from + size - BLOCK, BLOCK);
    }
}

/// Rows of one type that follow each other. To compare with its id lets the processor go on without waiting
/// for the table of types.
typedef struct {
    uint8_t type;
    uint16_t id;
    uint32_t size;
    uint64_t rows;
    uint64_t room;
    uint8_t *to;
} series_t;

static void end_series(usd_walk_t *walk, const series_t *series) {
    if (series->type != NO_TYPE) {
        walk->rows[series->type] = series->rows;
    }
}

static series_t begin_series(const usd_layout_t *layout, const usd_walk_t *walk, const uint8_t *row) {
    series_t series = {.type = type_at(layout, row), .id = load16_le(row)};
    if (series.type == NO_TYPE) {
        return series;
    }
    series.size = layout->row_bytes[series.type];
    series.rows = walk->rows[series.type];
    series.room = UINT64_MAX;
    if (walk->out != NULL) {
        series.room = walk->room[series.type];
        if (series.rows < series.room) {
            series.to = walk->out[series.type] + series.rows * (series.size - USD_ID_BYTES);
        }
    }
    return series;
}

/// Rows like the one before: of its series, later, and not to be marked. Most of a log is that, so this is
/// the least that can be done for one. Returns where it ends; the caller looks closer at what follows.
static inline uint64_t repeat(bytes_t in, uint64_t at, bool long_stamps, series_t *series, uint64_t *last) {
    series_t now = *series; // not in memory that `copy` might write to
    uint64_t before = *last;
    while (now.rows < now.room && at < in.size && in.size - at >= now.size) {
        const uint8_t *row = in.data + at;
        const uint64_t stamp = long_stamps ? load64_le(row + USD_ID_BYTES) : load32_le(row + USD_ID_BYTES);
        if (load16_le(row) != now.id || stamp < before) {
            break;
        }
        before = stamp;
        if (now.to != NULL) {
            copy(now.to, row + USD_ID_BYTES, now.size - USD_ID_BYTES);
            now.to += now.size - USD_ID_BYTES;
        }
        now.rows++;
        at += now.size;
    }
    *series = now;
    *last = before;
    return at;
}

static uint8_t pass(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk) {
    const size_t head = USD_ID_BYTES + layout->stamp_bytes;
    series_t series = {.type = NO_TYPE};
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
        if (series.type == NO_TYPE || load16_le(row) != series.id) {
            end_series(walk, &series);
            series = begin_series(layout, walk, row);
            if (series.type == NO_TYPE) {
                why = USD_UNKNOWN;
                break;
            }
        }
        const uint64_t stamp = stamp_at(layout, row);
        if (strict && (!believable(layout, row, stamp) ||
                       (walk->has_last && !follows(layout, stamp, last, layout->ahead)))) {
            why = USD_TIME;
            break;
        }
        if (left < series.size) {
            why = USD_CUT;
            break;
        }
        if (series.rows == series.room) {
            why = USD_ROOM;
            break;
        }
        const bool back = walk->has_last && stamp < last;
        const bool far_back = back && last - stamp > layout->back;
        const bool status = series.type == layout->status;
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
        if (walk->out != NULL) {
            copy(series.to, row + USD_ID_BYTES, series.size - USD_ID_BYTES);
            series.to += series.size - USD_ID_BYTES;
        }
        walk->has_last = true;
        series.rows++;
        at += series.size;
        if (!strict && !status) {
            const uint64_t block = walk->checked + USD_CHECK_BYTES;
            const size_t stop = walk->check && block < in.size ? (size_t)block : in.size;
            at = repeat((bytes_t){in.data, stop}, at, layout->stamp_bytes == 8, &series, &last);
        }
        walk->row = at - series.size;
        if (walk->check && at - walk->checked >= USD_CHECK_BYTES) {
            walk->at = at;
            check(in, walk);
        }
    }
    end_series(walk, &series);
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
