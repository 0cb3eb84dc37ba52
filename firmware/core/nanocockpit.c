#include "nanocockpit.h"

#include "checks.h"

#include <string.h>

enum {
    SIGN_BYTES = 4,
    CHECK_BYTES = 4,
    SIZE_AT = 2, // of a BEGIN
    CHECK_AT = 6,
    STATE_AT = 16, // of the metadata
    RANGES_AT = 48,
    REPLY_AT = 120,
    INFERENCE_AT = 128,
    GREY = 0,
    QUAT_BITS = 9,
    QUAT_MASK = (1 << QUAT_BITS) - 1,
};

static float magnitude(float value) {
    return value < 0 ? -value : value;
}

uint32_t nanocockpit_quat(const float xyzw[4]) {
    uint32_t largest = 0;
    for (uint32_t i = 1; i < 4; i++) {
        if (magnitude(xyzw[i]) > magnitude(xyzw[largest])) {
            largest = i;
        }
    }
    // No other component of a unit quaternion exceeds 1 / sqrt(2).
    const float scale = (float)QUAT_MASK * 1.41421356F;
    uint32_t packed = largest;
    for (uint32_t i = 0; i < 4; i++) {
        if (i == largest) {
            continue;
        }
        const bool negative = (xyzw[i] < 0) != (xyzw[largest] < 0);
        const float scaled = magnitude(xyzw[i]) * scale + 0.5F;
        const uint32_t rounded = scaled < (float)QUAT_MASK ? (uint32_t)scaled : (uint32_t)QUAT_MASK;
        packed = packed << (QUAT_BITS + 1) | (negative ? 1U << QUAT_BITS : 0U) | rounded;
    }
    return packed;
}

uint32_t nanocockpit_check(uint32_t crc, bytes_t in) {
    const uint32_t whole = crc32_zlib(crc, in);
    return whole == 0 ? UINT32_MAX : whole;
}

static void state_store(const nanocockpit_state_t *state, uint8_t out[32]) {
    const int16_t motion[] = {state->x_mm,     state->y_mm,     state->z_mm,
                              state->vx_mm_s,  state->vy_mm_s,  state->vz_mm_s,
                              state->ax_mm_s2, state->ay_mm_s2, state->az_mm_s2};
    store32_le(out, state->stm32_time);
    for (size_t i = 0; i < sizeof motion / sizeof motion[0]; i++) {
        store16_le(out + 4 + 2 * i, (uint16_t)motion[i]);
    }
    store32_le(out + 22, state->quat);
    store16_le(out + 26, (uint16_t)state->roll_mrad_s);
    store16_le(out + 28, (uint16_t)state->pitch_mrad_s);
    store16_le(out + 30, (uint16_t)state->yaw_mrad_s);
}

static int16_t load_signed(const uint8_t in[2]) {
    return (int16_t)load16_le(in);
}

static nanocockpit_state_t state_load(const uint8_t in[32]) {
    return (nanocockpit_state_t){
        .stm32_time = load32_le(in),
        .x_mm = load_signed(in + 4),
        .y_mm = load_signed(in + 6),
        .z_mm = load_signed(in + 8),
        .vx_mm_s = load_signed(in + 10),
        .vy_mm_s = load_signed(in + 12),
        .vz_mm_s = load_signed(in + 14),
        .ax_mm_s2 = load_signed(in + 16),
        .ay_mm_s2 = load_signed(in + 18),
        .az_mm_s2 = load_signed(in + 20),
        .quat = load32_le(in + 22),
        .roll_mrad_s = load_signed(in + 26),
        .pitch_mrad_s = load_signed(in + 28),
        .yaw_mrad_s = load_signed(in + 30),
    };
}

void nanocockpit_state_encode(const nanocockpit_state_t *state, uint8_t out[40]) {
    memcpy(out, "!STA", SIGN_BYTES);
    state_store(state, out + SIGN_BYTES);
    const bytes_t covered = {out, NANOCOCKPIT_STATE_BYTES - CHECK_BYTES};
    store32_le(out + covered.size, crc32_zlib(0, covered));
}

int nanocockpit_uart_decode(bytes_t in, nanocockpit_state_t *state) {
    static const struct {
        char sign[SIGN_BYTES + 1];
        uint8_t size;
    } messages[] = {
        {"!STA", NANOCOCKPIT_STATE_BYTES},
        {"!RNG", NANOCOCKPIT_NOISE_BYTES},
        {"!TOF", NANOCOCKPIT_RANGES_BYTES},
    };
    const size_t seen = in.size < SIGN_BYTES ? in.size : SIGN_BYTES;
    if (seen == 0) {
        return ERR_SHORT;
    }
    for (size_t i = 0; i < sizeof messages / sizeof messages[0]; i++) {
        if (memcmp(in.data, messages[i].sign, seen) != 0) {
            continue;
        }
        const size_t size = messages[i].size;
        if (in.size < size) {
            return ERR_SHORT;
        }
        const bytes_t covered = {in.data, size - CHECK_BYTES};
        if (load32_le(in.data + covered.size) != crc32_zlib(0, covered)) {
            return ERR_CHECK;
        }
        if (size == NANOCOCKPIT_STATE_BYTES) {
            *state = state_load(in.data + SIGN_BYTES);
        }
        return (int)size;
    }
    return ERR_START;
}

void nanocockpit_link_header(const cpx_route_t *route, size_t data_size, uint8_t out[4]) {
    store16_le(out, (uint16_t)(data_size < NANOCOCKPIT_DATA_MAX ? data_size : NANOCOCKPIT_DATA_MAX));
    cpx_route_encode(route, out + 2);
}

int nanocockpit_link_decode(bytes_t in, cpx_packet_t *packet) {
    if (in.size < CPX_LINK_HEADER_BYTES) {
        return ERR_SHORT;
    }
    const size_t size = load16_le(in.data);
    if (size > NANOCOCKPIT_DATA_MAX) {
        return ERR_LENGTH;
    }
    if (in.size < CPX_LINK_HEADER_BYTES + size) {
        return ERR_SHORT;
    }
    cpx_route_decode(in.data + 2, &packet->route);
    packet->data = (bytes_t){in.data + CPX_LINK_HEADER_BYTES, size};
    return (int)(CPX_LINK_HEADER_BYTES + size);
}

void nanocockpit_begin_encode(const nanocockpit_begin_t *begin, uint8_t out[12]) {
    out[0] = NANOCOCKPIT_BEGIN;
    out[1] = begin->type;
    store32_le(out + SIZE_AT, begin->size);
    store32_le(out + CHECK_AT, begin->check);
    store16_le(out + 10, 0);
}

void nanocockpit_more_encode(uint8_t out[4]) {
    store32_le(out, NANOCOCKPIT_MORE);
}

static int head_check(bytes_t in, uint8_t command, size_t size) {
    if (in.size > 0 && in.data[0] != command) {
        return ERR_START;
    }
    return in.size < size ? ERR_SHORT : (int)size;
}

int nanocockpit_begin_decode(bytes_t in, nanocockpit_begin_t *begin) {
    const int result = head_check(in, NANOCOCKPIT_BEGIN, NANOCOCKPIT_BEGIN_BYTES);
    if (result > 0) {
        *begin = (nanocockpit_begin_t){
            .type = in.data[1],
            .size = load32_le(in.data + SIZE_AT),
            .check = load32_le(in.data + CHECK_AT),
        };
    }
    return result;
}

int nanocockpit_more_decode(bytes_t in) {
    return head_check(in, NANOCOCKPIT_MORE, NANOCOCKPIT_MORE_BYTES);
}

void nanocockpit_metadata_encode(const nanocockpit_metadata_t *metadata, uint8_t out[148]) {
    memset(out, 0, NANOCOCKPIT_METADATA_BYTES);
    out[0] = NANOCOCKPIT_METADATA_VERSION;
    store16_le(out + 1, metadata->width);
    store16_le(out + 3, metadata->height);
    out[5] = metadata->depth;
    out[6] = GREY;
    out[7] = metadata->frame_id;
    store32_le(out + 8, metadata->frame_gap8_us);
    store32_le(out + 12, metadata->state_gap8_us);
    state_store(&metadata->state, out + STATE_AT);
    store32_le(out + RANGES_AT, metadata->ranges_gap8_us);
    out[RANGES_AT + 4] = metadata->ranges_count;
    memcpy(out + RANGES_AT + 8, metadata->ranges, sizeof metadata->ranges);
    store32_le(out + REPLY_AT, metadata->reply_frame_gap8_us);
    store32_le(out + REPLY_AT + 4, metadata->reply_gap8_us);
    store32_le(out + INFERENCE_AT, metadata->inference_stm32_time);
    for (size_t i = 0; i < 4; i++) {
        store_float_le(out + INFERENCE_AT + 4 + 4 * i, metadata->inference[i]);
    }
}

int nanocockpit_metadata_decode(bytes_t in, nanocockpit_metadata_t *metadata) {
    if (in.size > 0 && in.data[0] != NANOCOCKPIT_METADATA_VERSION) {
        return ERR_START;
    }
    if (in.size < NANOCOCKPIT_METADATA_BYTES) {
        return ERR_SHORT;
    }
    nanocockpit_metadata_t read = {
        .width = load16_le(in.data + 1),
        .height = load16_le(in.data + 3),
        .depth = in.data[5],
        .frame_id = in.data[7],
        .frame_gap8_us = load32_le(in.data + 8),
        .state_gap8_us = load32_le(in.data + 12),
        .state = state_load(in.data + STATE_AT),
        .ranges_gap8_us = load32_le(in.data + RANGES_AT),
        .ranges_count = in.data[RANGES_AT + 4],
        .reply_frame_gap8_us = load32_le(in.data + REPLY_AT),
        .reply_gap8_us = load32_le(in.data + REPLY_AT + 4),
        .inference_stm32_time = load32_le(in.data + INFERENCE_AT),
    };
    const bool sides =
        read.width >= 1 && read.width <= IMAGE_SIDE_MAX && read.height >= 1 && read.height <= IMAGE_SIDE_MAX;
    if (!sides || read.depth < 1 || read.depth > 4 || in.data[6] != GREY) {
        return ERR_VALUE;
    }
    memcpy(read.ranges, in.data + RANGES_AT + 8, sizeof read.ranges);
    for (size_t i = 0; i < 4; i++) {
        read.inference[i] = load_float_le(in.data + INFERENCE_AT + 4 + 4 * i);
    }
    *metadata = read;
    return NANOCOCKPIT_METADATA_BYTES;
}

void nanocockpit_reply_encode(const nanocockpit_reply_t *reply, uint8_t out[25]) {
    memset(out, 0, NANOCOCKPIT_REPLY_BYTES);
    store32_le(out, reply->frame_gap8_us);
    out[4] = reply->frame_id;
}

int nanocockpit_reply_decode(bytes_t in, nanocockpit_reply_t *reply) {
    if (in.size != NANOCOCKPIT_REPLY_BYTES) {
        return ERR_LENGTH;
    }
    *reply = (nanocockpit_reply_t){.frame_gap8_us = load32_le(in.data), .frame_id = in.data[4]};
    return NANOCOCKPIT_REPLY_BYTES;
}
