/// Each image message that decodes encodes to the same bytes (spare bytes as 0); a refusal leaves the output
/// alone.
#include "claim.h"

#include "firmware/core/image.h"

/// Decodes `in` as one type of message and claims what the first line says. `spare` to `spare_end` is not
/// judged.
#define ROUND_TRIP(type, bytes, spare, spare_end)                                                            \
    static void type##_round_trip(bytes_t in) {                                                              \
        type##_t read;                                                                                       \
        memset(&read, POISON, sizeof read);                                                                  \
        const int used = type##_decode(in, &read);                                                           \
        if (used < 0) {                                                                                      \
            CLAIM(untouched(&read, sizeof read));                                                            \
            return;                                                                                          \
        }                                                                                                    \
        CLAIM(used >= (bytes) && (size_t)used <= in.size);                                                   \
        uint8_t out[bytes];                                                                                  \
        type##_encode(&read, out);                                                                           \
        CLAIM(memcmp(out, in.data, spare) == 0);                                                             \
        CLAIM(memcmp(out + (spare_end), in.data + (spare_end), (bytes) - (spare_end)) == 0);                 \
    }

ROUND_TRIP(image_stock, IMAGE_STOCK_BYTES, 0, 0)
ROUND_TRIP(native_frame, NATIVE_FRAME_BYTES, 2, 4) // the length of the header may be larger
ROUND_TRIP(native_status, NATIVE_STATUS_BYTES, 2, 4)
ROUND_TRIP(native_stream, NATIVE_STREAM_BYTES, 3, 4)
ROUND_TRIP(native_camera, NATIVE_CAMERA_BYTES, 7, 8)
ROUND_TRIP(native_reply, NATIVE_REPLY_BYTES, 0, 0)

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
    CLAIM(memcmp(out, in.data, 3) == 0 && memcmp(out + 4, in.data + 4, (size_t)used - 4) == 0);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    const bytes_t in = {data, size};
    image_stock_round_trip(in);
    native_frame_round_trip(in);
    native_status_round_trip(in);
    native_stream_round_trip(in);
    native_camera_round_trip(in);
    native_reply_round_trip(in);
    data_round_trip(in);
    pairs_round_trip(in);
    return 0;
}
