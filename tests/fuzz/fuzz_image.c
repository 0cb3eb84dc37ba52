/// Each image message that decodes encodes to the same bytes (spare bytes as 0); a refusal leaves the output
/// alone. Messages with a check are tried once more with one that matches.
#include "claim.h"

#include "firmware/core/checks.h"
#include "firmware/core/image.h"
#include "firmware/core/native_log.h"

/// Decodes `in` as one type of message, of `least` bytes or more, and claims what the first line says.
/// `spare` to `spare_end` is not judged, nor what comes from `end` on: the check of a message whose spare
/// bytes are in use.
#define ROUND_TRIP(type, bytes, least, spare, spare_end, end)                                                \
    static void type##_round_trip(bytes_t in) {                                                              \
        type##_t read;                                                                                       \
        memset(&read, POISON, sizeof read);                                                                  \
        const int used = type##_decode(in, &read);                                                           \
        if (used < 0) {                                                                                      \
            CLAIM(untouched(&read, sizeof read));                                                            \
            return;                                                                                          \
        }                                                                                                    \
        CLAIM(used >= (least) && (size_t)used <= in.size);                                                   \
        uint8_t out[bytes];                                                                                  \
        type##_encode(&read, out);                                                                           \
        CLAIM(memcmp(out, in.data, spare) == 0);                                                             \
        CLAIM(memcmp(out + (spare_end), in.data + (spare_end), (end) - (spare_end)) == 0);                   \
    }

ROUND_TRIP(image_stock, IMAGE_STOCK_BYTES, IMAGE_STOCK_BYTES, 0, 0, IMAGE_STOCK_BYTES)
// The length of the header may be another.
ROUND_TRIP(native_frame, NATIVE_FRAME_BYTES, NATIVE_FRAME_SHORT_BYTES, 2, 4,
           NATIVE_FRAME_SHORT_BYTES - NATIVE_CHECK_BYTES)
ROUND_TRIP(native_status, NATIVE_STATUS_BYTES, NATIVE_STATUS_BYTES, 2, 4, 60)
ROUND_TRIP(native_log, NATIVE_LOG_BYTES, NATIVE_LOG_BYTES, 0, 0, NATIVE_LOG_BYTES)
ROUND_TRIP(native_stream, NATIVE_STREAM_BYTES, NATIVE_STREAM_BYTES, 3, 4, NATIVE_STREAM_BYTES)
ROUND_TRIP(native_camera, NATIVE_CAMERA_BYTES, NATIVE_CAMERA_BYTES, 7, 8, NATIVE_CAMERA_BYTES)
ROUND_TRIP(native_reply, NATIVE_REPLY_BYTES, NATIVE_REPLY_BYTES, 0, 0, NATIVE_REPLY_BYTES)

/// Of a frame that is long enough, what comes after its first check too.
static void clock_round_trip(bytes_t in) {
    native_frame_t read;
    if (native_frame_decode(in, &read) < NATIVE_FRAME_CLOCK_BYTES) {
        return;
    }
    uint8_t out[NATIVE_FRAME_BYTES];
    native_frame_encode(&read, out);
    const size_t clock = NATIVE_FRAME_CLOCK_BYTES - NATIVE_CHECK_BYTES - NATIVE_FRAME_SHORT_BYTES;
    CLAIM(memcmp(out + NATIVE_FRAME_SHORT_BYTES, in.data + NATIVE_FRAME_SHORT_BYTES, clock) == 0);
    if (read.echoes != 0) {
        const size_t echo = NATIVE_FRAME_BYTES - NATIVE_CHECK_BYTES - NATIVE_FRAME_CLOCK_BYTES;
        CLAIM(memcmp(out + NATIVE_FRAME_CLOCK_BYTES, in.data + NATIVE_FRAME_CLOCK_BYTES, echo) == 0);
    }
}

static void data_round_trip(bytes_t in) {
    uint16_t frame_low;
    uint32_t offset;
    bytes_t body;
    const int used = native_data_decode(in, &frame_low, &offset, &body);
    if (used < 0) {
        return;
    }
    CLAIM((size_t)used == in.size && body.size == in.size - NATIVE_DATA_HEAD_BYTES && body.size > 0);
    CLAIM(body.data == in.data + NATIVE_DATA_HEAD_BYTES);
    uint8_t out[NATIVE_DATA_HEAD_BYTES];
    native_data_encode_head(frame_low, offset, out);
    CLAIM(memcmp(out, in.data, sizeof out) == 0);
}

static void pairs_round_trip(bytes_t in) {
    native_pair_t pairs[NATIVE_PAIRS_MAX];
    memset(pairs, POISON, sizeof pairs);
    size_t count = 0;
    uint32_t lost = 0;
    const int used = native_pairs_decode(in, pairs, &count, &lost);
    CLAIM(untouched(pairs + count, (NATIVE_PAIRS_MAX - count) * sizeof pairs[0]));
    if (used < 0) {
        CLAIM(count == 0 && lost == 0);
        return;
    }
    uint8_t out[CPX_DATA_MAX];
    CLAIM(native_pairs_encode(pairs, count, lost, (bytes_mut_t){out, sizeof out}) == (size_t)used);
    CLAIM(memcmp(out, in.data, 3) == 0 &&
          memcmp(out + 4, in.data + 4, (size_t)used - 4 - NATIVE_CHECK_BYTES) == 0);
}

/// Writes the check behind the first `covered` bytes.
static bool seal(uint8_t *message, size_t size, size_t covered) {
    if (size < covered + NATIVE_CHECK_BYTES) {
        return false;
    }
    store32_le(message + covered, crc32_zlib(0, (bytes_t){message, covered}));
    return true;
}

static void sealed_round_trips(bytes_t in) {
    uint8_t message[CPX_DATA_MAX];
    if (in.size < 3 || in.size > sizeof message) {
        return;
    }
    const bytes_t made = {message, in.size};
    memcpy(message, in.data, in.size);
    if (seal(message, in.size, NATIVE_FRAME_SHORT_BYTES - NATIVE_CHECK_BYTES)) {
        native_frame_round_trip(made);
    }
    if (seal(message, in.size, NATIVE_FRAME_CLOCK_BYTES - NATIVE_CHECK_BYTES)) {
        clock_round_trip(made);
    }
    if (seal(message, in.size, NATIVE_FRAME_BYTES - NATIVE_CHECK_BYTES)) {
        clock_round_trip(made);
    }
    memcpy(message, in.data, in.size);
    if (seal(message, in.size, NATIVE_STATUS_BYTES - NATIVE_CHECK_BYTES)) {
        native_status_round_trip(made);
    }
    memcpy(message, in.data, in.size);
    if (seal(message, in.size, NATIVE_LOG_BYTES - NATIVE_CHECK_BYTES)) {
        native_log_round_trip(made);
    }
    memcpy(message, in.data, in.size);
    if (seal(message, in.size, NATIVE_PAIRS_HEAD_BYTES + (size_t)in.data[2] * NATIVE_PAIR_BYTES)) {
        pairs_round_trip(made);
    }
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const bytes_t in = {data, size};
    image_stock_round_trip(in);
    native_frame_round_trip(in);
    native_status_round_trip(in);
    native_log_round_trip(in);
    native_stream_round_trip(in);
    native_camera_round_trip(in);
    native_reply_round_trip(in);
    data_round_trip(in);
    pairs_round_trip(in);
    sealed_round_trips(in);
    return 0;
}
