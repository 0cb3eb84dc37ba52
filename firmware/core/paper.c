#include "paper.h"

#include "checks.h"

enum { PAYLOAD_AT = 2, TIME_AT = 3, POSE_AT = 11, CHECK_AT = 39, HEADER_POSE_AT = 15, FLOAT_BYTES = 4 };

static void pose_encode(const pose_t *pose, uint8_t *out) {
    const float values[] = {pose->x_m, pose->y_m, pose->z_m, pose->qx, pose->qy, pose->qz, pose->qw};
    for (size_t i = 0; i < sizeof values / sizeof values[0]; i++) {
        store_float_le(out + i * FLOAT_BYTES, values[i]);
    }
}

static pose_t pose_decode(const uint8_t *in) {
    return (pose_t){
        .x_m = load_float_le(in),
        .y_m = load_float_le(in + 4),
        .z_m = load_float_le(in + 8),
        .qx = load_float_le(in + 12),
        .qy = load_float_le(in + 16),
        .qz = load_float_le(in + 20),
        .qw = load_float_le(in + 24),
    };
}

static uint8_t payload_check(const uint8_t *message) {
    return xor8((bytes_t){message + PAYLOAD_AT, PAPER_STAMP_PAYLOAD});
}

void paper_stamp_encode(const paper_stamp_t *stamp, uint8_t out[40]) {
    out[0] = PAPER_STAMP_START;
    out[1] = PAPER_STAMP_PAYLOAD;
    out[2] = PAPER_STAMP_COMMAND;
    store64_le(out + TIME_AT, stamp->stm32_us);
    pose_encode(&stamp->pose, out + POSE_AT);
    out[CHECK_AT] = payload_check(out);
}

int paper_stamp_decode(bytes_t in, paper_stamp_t *stamp) {
    static const uint8_t start[] = {PAPER_STAMP_START, PAPER_STAMP_PAYLOAD, PAPER_STAMP_COMMAND};
    for (size_t i = 0; i < sizeof start && i < in.size; i++) {
        if (in.data[i] != start[i]) {
            return ERR_START;
        }
    }
    if (in.size < PAPER_STAMP_BYTES) {
        return ERR_SHORT;
    }
    if (in.data[CHECK_AT] != payload_check(in.data)) {
        return ERR_CHECK;
    }
    *stamp =
        (paper_stamp_t){.stm32_us = load64_le(in.data + TIME_AT), .pose = pose_decode(in.data + POSE_AT)};
    return PAPER_STAMP_BYTES;
}

void paper_header_encode(const paper_header_t *header, uint8_t out[43]) {
    image_stock_encode(&header->image, out);
    store32_le(out + IMAGE_STOCK_BYTES, header->frame_stm32_ms);
    pose_encode(&header->pose, out + HEADER_POSE_AT);
}

int paper_header_decode(bytes_t in, paper_header_t *header) {
    if (in.size != PAPER_HEADER_BYTES) {
        return ERR_LENGTH;
    }
    image_stock_t image;
    const int error = image_stock_decode((bytes_t){in.data, IMAGE_STOCK_BYTES}, &image);
    if (error < 0) {
        return error;
    }
    *header = (paper_header_t){
        .image = image,
        .frame_stm32_ms = load32_le(in.data + IMAGE_STOCK_BYTES),
        .pose = pose_decode(in.data + HEADER_POSE_AT),
    };
    return PAPER_HEADER_BYTES;
}

void paper_camera_encode(const paper_camera_t *camera, uint8_t out[8]) {
    out[0] = PAPER_CAMERA_COMMAND;
    out[1] = camera->auto_exposure;
    out[2] = camera->analog_gain;
    out[3] = camera->digital_gain;
    store16_le(out + 4, camera->exposure_lines);
    out[6] = camera->burst;
    out[7] = camera->encoding;
}

int paper_camera_decode(bytes_t in, paper_camera_t *camera) {
    if (in.size != PAPER_CAMERA_BYTES) {
        return ERR_LENGTH;
    }
    if (in.data[0] != PAPER_CAMERA_COMMAND) {
        return ERR_START;
    }
    *camera = (paper_camera_t){
        .auto_exposure = in.data[1],
        .analog_gain = in.data[2],
        .digital_gain = in.data[3],
        .exposure_lines = load16_le(in.data + 4),
        .burst = in.data[6],
        .encoding = in.data[7],
    };
    return PAPER_CAMERA_BYTES;
}
