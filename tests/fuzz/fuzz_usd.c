// Rows of a uSD log: whatever the bytes, a walk ends inside them and accounts for every one it has passed,
// what it copies are the rows it has passed, and a place that is found is one.
#include "claim.h"
#include "firmware/core/checks.h"
#include "host/native/crc32.h"
#include "host/native/usd.h"
#include "input.h"

enum { TYPES = 3, MARKS = 4 };

/// Types with ids that fuzzed bytes hit easily: 0, 1 and 0xFFFF.
static void make_layout(usd_layout_t *layout, bytes_t *in) {
    static const uint16_t IDS[TYPES] = {0, 1, 0xFFFF};
    memset(layout, 0, sizeof *layout);
    const uint8_t choice = take_byte(in);
    layout->stamp_bytes = (choice & 1U) != 0 ? 8 : 4;
    layout->types = TYPES;
    layout->status = (choice >> 1) % (TYPES + 1);
    layout->back = take_byte(in);
    layout->ahead = (uint64_t)take_byte(in) << 8;
    layout->near = take_byte(in);
    for (uint8_t type = 0; type < TYPES; type++) {
        layout->row_bytes[type] = USD_ID_BYTES + layout->stamp_bytes + take_byte(in) % 40U;
        layout->type_of_id[IDS[type]] = (uint8_t)(type + 1);
    }
}

/// All of it, with as many calls as the marks need. Returns why it ended.
static uint8_t walk_all(const usd_layout_t *layout, bytes_t in, bool strict, usd_walk_t *walk) {
    static usd_mark_t marks[MARKS];
    *walk = (usd_walk_t){.marks = marks, .marks_max = MARKS, .check = true};
    uint8_t why = USD_MARKS;
    for (size_t calls = 0; why == USD_MARKS; calls++) {
        CLAIM(calls <= in.size);
        walk->marks_count = 0;
        why = usd_walk(layout, in, strict, walk);
        CLAIM(walk->marks_count <= MARKS);
        for (uint32_t i = 0; i < walk->marks_count; i++) {
            CLAIM(marks[i].offset < walk->at);
        }
    }
    CLAIM(walk->at <= in.size && (why == USD_END) == (walk->at == in.size));
    uint64_t passed = 0;
    for (uint8_t type = 0; type < TYPES; type++) {
        passed += walk->rows[type] * layout->row_bytes[type];
    }
    CLAIM(passed == walk->at);
    CLAIM(walk->crc == crc32_zlib(0, (bytes_t){in.data, walk->at}));
    return why;
}

/// The same walk again, with room for a row more of one type each time that there is no room.
static void copy_all(const usd_layout_t *layout, bytes_t in, const usd_walk_t *before) {
    static usd_mark_t marks[MARKS];
    uint8_t *out[TYPES] = {NULL};
    uint64_t room[TYPES] = {0};
    usd_walk_t walk = {.marks = marks, .marks_max = MARKS, .out = out, .room = room};
    uint8_t why = USD_ROOM;
    while (why == USD_ROOM || why == USD_MARKS) {
        walk.marks_count = 0;
        why = usd_walk(layout, in, false, &walk);
        if (why == USD_ROOM) {
            const uint8_t type = (uint8_t)(layout->type_of_id[load16_le(in.data + walk.at)] - 1U);
            CLAIM(type < TYPES && walk.rows[type] == room[type]);
            room[type]++;
            // Of exactly the size: the sanitizer sees a byte too many.
            out[type] = realloc(out[type], room[type] * (layout->row_bytes[type] - USD_ID_BYTES));
            CLAIM(out[type] != NULL);
        }
    }
    CLAIM(walk.at == before->at && walk.row == before->row && walk.last == before->last);
    CLAIM(memcmp(walk.rows, before->rows, sizeof walk.rows) == 0);
    uint64_t copied[TYPES] = {0};
    for (uint64_t at = 0; at < walk.at;) {
        const uint8_t type = (uint8_t)(layout->type_of_id[load16_le(in.data + at)] - 1U);
        const size_t size = layout->row_bytes[type] - USD_ID_BYTES;
        CLAIM(memcmp(out[type] + copied[type] * size, in.data + at + USD_ID_BYTES, size) == 0);
        copied[type]++;
        at += layout->row_bytes[type];
    }
    for (uint8_t type = 0; type < TYPES; type++) {
        free(out[type]);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static usd_layout_t layout;
    static usd_walk_t strict, lenient;
    bytes_t in = {data, size};
    make_layout(&layout, &in);
    walk_all(&layout, in, true, &strict);
    walk_all(&layout, in, false, &lenient);
    CLAIM(strict.at <= lenient.at);
    copy_all(&layout, in, &lenient);

    const uint64_t last = strict.last;
    const uint64_t from = strict.at + 1;
    const uint64_t found = usd_find(&layout, in, from, strict.has_last ? &last : NULL);
    CLAIM(found == in.size || (found >= from && found < in.size));
    if (found < in.size) {
        bool ends = false;
        CLAIM(usd_chain(&layout, in, found, NULL, USD_CHAIN_END, &ends) >= USD_CHAIN_END);
    }
    return 0;
}
