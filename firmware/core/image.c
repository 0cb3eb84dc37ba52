#include "image.h"

#include "checks.h"

enum {
    PERIOD_MAX_US = 10000000,
    DATA_MIN = NATIVE_FRAME_BYTES,
    FRAME_CHECK_AT = NATIVE_FRAME_SHORT_BYTES - NATIVE_CHECK_BYTES,
    CLOCK_CHECK_AT = NATIVE_FRAME_CLOCK_BYTES - NATIVE_CHECK_BYTES,
    ECHO_CHECK_AT = NATIVE_FRAME_BYTES - NATIVE_CHECK_BYTES,
};

/// What every picture must satisfy, stock or native: 0 or ERR_VALUE.
static int picture_check(uint16_t width, uint16_t height, uint8_t depth, uint8_t encoding, uint32_t size) {
    const bool sides = width >= 1 && width <= IMAGE_SIDE_MAX && height >= 1 && height <= IMAGE_SIDE_MAX;
    if (!sides || depth < 1 || depth > 4 || encoding > IMAGE_JPEG || size < 1 || size > IMAGE_BODY_MAX) {
        return ERR_VALUE;
    }
    return encoding == IMAGE_RAW && size != (uint32_t)width * height * depth ? ERR_VALUE : 0;
}

/// Is this a native message of that kind, of at least `size` bytes? 0, ERR_START or ERR_SHORT.
static int native_check(bytes_t in, uint8_t kind, size_t size) {
    if ((in.size > 0 && in.data[0] != NATIVE_MAGIC) || (in.size > 1 && in.data[1] != kind)) {
        return ERR_START;
    }
    return in.size < size ? ERR_SHORT : 0;
}

static void native_start(uint8_t out[4], uint8_t kind, uint16_t third) {
    out[0] = NATIVE_MAGIC;
    out[1] = kind;
    store16_le(out + 2, third);
}

static void native_seal(uint8_t *out, size_t size) {
    store32_le(out + size, crc32_zlib(0, (bytes_t){out, size}));
}

/// The `size` bytes before the check are as they were sent. `in` holds both.
static bool native_sealed(bytes_t in, size_t size) {
    return load32_le(in.data + size) == crc32_zlib(0, (bytes_t){in.data, size});
}

void image_stock_encode(const image_stock_t *header, uint8_t out[11]) {
    out[0] = IMAGE_STOCK_MAGIC;
    store16_le(out + 1, header->width);
    store16_le(out + 3, header->height);
    out[5] = header->depth;
    out[6] = header->type;
    store32_le(out + 7, header->size);
}

int image_stock_decode(bytes_t in, image_stock_t *header) {
    if (in.size != IMAGE_STOCK_BYTES) {
        return ERR_LENGTH;
    }
    if (in.data[0] != IMAGE_STOCK_MAGIC) {
        return ERR_START;
    }
    const image_stock_t read = {
        .width = load16_le(in.data + 1),
        .height = load16_le(in.data + 3),
        .depth = in.data[5],
        .type = in.data[6],
        .size = load32_le(in.data + 7),
    };
    const int error = picture_check(read.width, read.height, read.depth, read.type, read.size);
    if (error < 0) {
        return error;
    }
    *header = read;
    return IMAGE_STOCK_BYTES;
}

void native_frame_encode(const native_frame_t *frame, uint8_t out[144]) {
    native_start(out, NATIVE_FRAME, NATIVE_FRAME_BYTES);
    store32_le(out + 4, frame->frame);
    store16_le(out + 8, frame->width);
    store16_le(out + 10, frame->height);
    out[12] = frame->depth;
    out[13] = frame->encoding;
    store16_le(out + 14, frame->flags);
    store32_le(out + 16, frame->body_bytes);
    store32_le(out + 20, frame->body_crc32);
    store64_le(out + 24, frame->frame_gap8_us);
    store64_le(out + 32, frame->frame_stm32_us);
    store32_le(out + 40, frame->bound_us);
    out[44] = frame->epoch;
    out[45] = frame->analog_gain;
    out[46] = frame->digital_gain;
    out[47] = frame->burst;
    store32_le(out + 48, frame->exposure_lines);
    store32_le(out + 52, frame->line_time_ns);
    store32_le(out + 56, frame->stamp_sequence);
    store32_le(out + 60, frame->stamp_age_us);
    store32_le(out + 64, frame->stamps_received);
    store32_le(out + 68, frame->stamps_missed);
    store32_le(out + 72, frame->stamps_bad);
    store32_le(out + 76, frame->pairs_lost);
    store32_le(out + 80, frame->captures_failed);
    store32_le(out + 84, frame->captures_late);
    store32_le(out + 88, frame->frames_unsent);
    store32_le(out + 92, frame->spi_errors);
    store32_le(out + 96, frame->packets_dropped);
    native_seal(out, FRAME_CHECK_AT);
    store32_le(out + 104, frame->window_us);
    store32_le(out + 108, frame->window_stamps);
    store32_le(out + 112, frame->delay_us);
    store32_le(out + 116, (uint32_t)frame->skew_ppb);
    store32_le(out + 120, frame->latency_us);
    native_seal(out, CLOCK_CHECK_AT);
    store32_le(out + 128, frame->minimum_delay_us);
    store32_le(out + 132, frame->minimum_delay_error_us);
    store32_le(out + 136, frame->echoes);
    native_seal(out, ECHO_CHECK_AT);
}

int native_frame_decode(bytes_t in, native_frame_t *frame) {
    const int error = native_check(in, NATIVE_FRAME, NATIVE_FRAME_SHORT_BYTES);
    if (error < 0) {
        return error;
    }
    const uint16_t header_bytes = load16_le(in.data + 2);
    if (header_bytes < NATIVE_FRAME_SHORT_BYTES || header_bytes > in.size) {
        return ERR_LENGTH;
    }
    const bool has_clock = header_bytes >= NATIVE_FRAME_CLOCK_BYTES;
    const bool has_echo = header_bytes >= NATIVE_FRAME_BYTES;
    if (!native_sealed(in, FRAME_CHECK_AT) || (has_clock && !native_sealed(in, CLOCK_CHECK_AT)) ||
        (has_echo && !native_sealed(in, ECHO_CHECK_AT))) {
        return ERR_CHECK;
    }
    native_frame_t read = {
        .frame = load32_le(in.data + 4),
        .width = load16_le(in.data + 8),
        .height = load16_le(in.data + 10),
        .depth = in.data[12],
        .encoding = in.data[13],
        .flags = load16_le(in.data + 14),
        .body_bytes = load32_le(in.data + 16),
        .body_crc32 = load32_le(in.data + 20),
        .frame_gap8_us = load64_le(in.data + 24),
        .frame_stm32_us = load64_le(in.data + 32),
        .bound_us = load32_le(in.data + 40),
        .epoch = in.data[44],
        .analog_gain = in.data[45],
        .digital_gain = in.data[46],
        .burst = in.data[47],
        .exposure_lines = load32_le(in.data + 48),
        .line_time_ns = load32_le(in.data + 52),
        .stamp_sequence = load32_le(in.data + 56),
        .stamp_age_us = load32_le(in.data + 60),
        .stamps_received = load32_le(in.data + 64),
        .stamps_missed = load32_le(in.data + 68),
        .stamps_bad = load32_le(in.data + 72),
        .pairs_lost = load32_le(in.data + 76),
        .captures_failed = load32_le(in.data + 80),
        .captures_late = load32_le(in.data + 84),
        .frames_unsent = load32_le(in.data + 88),
        .spi_errors = load32_le(in.data + 92),
        .packets_dropped = load32_le(in.data + 96),
    };
    const int refused = picture_check(read.width, read.height, read.depth, read.encoding, read.body_bytes);
    if (refused < 0) {
        return refused;
    }
    if (has_clock) {
        read.window_us = load32_le(in.data + 104);
        read.window_stamps = load32_le(in.data + 108);
        read.delay_us = load32_le(in.data + 112);
        read.skew_ppb = (int32_t)load32_le(in.data + 116);
        read.latency_us = load32_le(in.data + 120);
    }
    if (has_echo) {
        read.minimum_delay_us = load32_le(in.data + 128);
        read.minimum_delay_error_us = load32_le(in.data + 132);
        read.echoes = load32_le(in.data + 136);
    }
    *frame = read;
    return header_bytes;
}

void native_data_encode_head(uint32_t frame, uint32_t offset, uint8_t out[8]) {
    native_start(out, NATIVE_DATA, (uint16_t)frame);
    store32_le(out + 4, offset);
}

int native_data_decode(bytes_t in, uint16_t *frame_low, uint32_t *offset, bytes_t *body) {
    const int error = native_check(in, NATIVE_DATA, NATIVE_DATA_HEAD_BYTES + 1);
    if (error < 0) {
        return error;
    }
    *frame_low = load16_le(in.data + 2);
    *offset = load32_le(in.data + 4);
    *body = (bytes_t){in.data + NATIVE_DATA_HEAD_BYTES, in.size - NATIVE_DATA_HEAD_BYTES};
    return (int)in.size;
}

size_t native_pairs_encode(const native_pair_t *pairs, size_t count, uint32_t lost, bytes_mut_t out) {
    const size_t size = NATIVE_PAIRS_HEAD_BYTES + count * NATIVE_PAIR_BYTES;
    if (count < 1 || count > NATIVE_PAIRS_MAX || out.size < size + NATIVE_CHECK_BYTES) {
        return 0;
    }
    native_start(out.data, NATIVE_PAIRS, (uint16_t)count);
    store32_le(out.data + 4, lost);
    uint8_t *at = out.data + NATIVE_PAIRS_HEAD_BYTES;
    for (size_t i = 0; i < count; i++, at += NATIVE_PAIR_BYTES) {
        store32_le(at, pairs[i].sequence);
        store64_le(at + 4, pairs[i].stm32_us);
        store64_le(at + 12, pairs[i].gap8_us);
        at[20] = pairs[i].epoch;
    }
    native_seal(out.data, size);
    return size + NATIVE_CHECK_BYTES;
}

int native_pairs_decode(bytes_t in, native_pair_t pairs[48], size_t *count, uint32_t *lost) {
    const int error = native_check(in, NATIVE_PAIRS, NATIVE_PAIRS_HEAD_BYTES);
    if (error < 0) {
        return error;
    }
    const uint8_t stated = in.data[2];
    if (stated < 1 || stated > NATIVE_PAIRS_MAX) {
        return ERR_VALUE;
    }
    const size_t size = NATIVE_PAIRS_HEAD_BYTES + (size_t)stated * NATIVE_PAIR_BYTES;
    if (in.size < size + NATIVE_CHECK_BYTES) {
        return ERR_SHORT;
    }
    if (!native_sealed(in, size)) {
        return ERR_CHECK;
    }
    const uint8_t *at = in.data + NATIVE_PAIRS_HEAD_BYTES;
    for (size_t i = 0; i < stated; i++, at += NATIVE_PAIR_BYTES) {
        pairs[i] = (native_pair_t){
            .sequence = load32_le(at),
            .stm32_us = load64_le(at + 4),
            .gap8_us = load64_le(at + 12),
            .epoch = at[20],
        };
    }
    *count = stated;
    *lost = load32_le(in.data + 4);
    return (int)(size + NATIVE_CHECK_BYTES);
}

void native_status_encode(const native_status_t *status, uint8_t out[64]) {
    native_start(out, NATIVE_STATUS, 0);
    store64_le(out + 4, status->up_us);
    store32_le(out + 12, status->frames_forwarded);
    store32_le(out + 16, status->frames_dropped);
    store32_le(out + 20, status->frames_cut);
    store32_le(out + 24, status->packets_forwarded);
    store32_le(out + 28, status->packets_dropped);
    store32_le(out + 32, status->packets_unroutable);
    store32_le(out + 36, status->uart_bad_check);
    store32_le(out + 40, status->uart_bad_length);
    store32_le(out + 44, status->uart_garbage_bytes);
    store32_le(out + 48, status->uart_gaps);
    store32_le(out + 52, status->spi_errors);
    store32_le(out + 56, status->tcp_skipped_bytes);
    native_seal(out, NATIVE_STATUS_BYTES - NATIVE_CHECK_BYTES);
}

int native_status_decode(bytes_t in, native_status_t *status) {
    const int error = native_check(in, NATIVE_STATUS, NATIVE_STATUS_BYTES);
    if (error < 0) {
        return error;
    }
    if (!native_sealed(in, NATIVE_STATUS_BYTES - NATIVE_CHECK_BYTES)) {
        return ERR_CHECK;
    }
    *status = (native_status_t){
        .up_us = load64_le(in.data + 4),
        .frames_forwarded = load32_le(in.data + 12),
        .frames_dropped = load32_le(in.data + 16),
        .frames_cut = load32_le(in.data + 20),
        .packets_forwarded = load32_le(in.data + 24),
        .packets_dropped = load32_le(in.data + 28),
        .packets_unroutable = load32_le(in.data + 32),
        .uart_bad_check = load32_le(in.data + 36),
        .uart_bad_length = load32_le(in.data + 40),
        .uart_garbage_bytes = load32_le(in.data + 44),
        .uart_gaps = load32_le(in.data + 48),
        .spi_errors = load32_le(in.data + 52),
        .tcp_skipped_bytes = load32_le(in.data + 56),
    };
    return NATIVE_STATUS_BYTES;
}

void native_stream_encode(const native_stream_t *stream, uint8_t out[6]) {
    native_start(out, NATIVE_STREAM, stream->dialect);
    store16_le(out + 4, stream->data_max);
}

int native_stream_decode(bytes_t in, native_stream_t *stream) {
    const int error = native_check(in, NATIVE_STREAM, NATIVE_STREAM_BYTES);
    if (error < 0) {
        return error;
    }
    const native_stream_t read = {.dialect = in.data[2], .data_max = load16_le(in.data + 4)};
    const bool data_max_ok =
        read.data_max == 0 || (read.data_max >= DATA_MIN && read.data_max <= CPX_DATA_MAX);
    if (read.dialect > 1 || !data_max_ok) {
        return ERR_VALUE;
    }
    *stream = read;
    return NATIVE_STREAM_BYTES;
}

void native_camera_encode(const native_camera_t *camera, uint8_t out[14]) {
    native_start(out, NATIVE_CAMERA, 0);
    out[2] = camera->auto_exposure;
    out[3] = camera->analog_gain;
    out[4] = camera->digital_gain;
    out[5] = camera->burst;
    out[6] = camera->encoding;
    out[7] = 0;
    store16_le(out + 8, camera->exposure_lines);
    store32_le(out + 10, camera->frame_period_us);
}

int native_camera_decode(bytes_t in, native_camera_t *camera) {
    const int error = native_check(in, NATIVE_CAMERA, NATIVE_CAMERA_BYTES);
    if (error < 0) {
        return error;
    }
    *camera = (native_camera_t){
        .auto_exposure = in.data[2],
        .analog_gain = in.data[3],
        .digital_gain = in.data[4],
        .burst = in.data[5],
        .encoding = in.data[6],
        .exposure_lines = load16_le(in.data + 8),
        .frame_period_us = load32_le(in.data + 10),
    };
    return NATIVE_CAMERA_BYTES;
}

uint8_t native_camera_check(const native_camera_t *camera) {
    const uint8_t gain = camera->analog_gain;
    const bool in_range[] = {
        camera->auto_exposure <= 1,
        gain == 1 || gain == 2 || gain == 4 || gain == 8,
        camera->digital_gain >= 1,
        camera->burst >= 1 && camera->burst <= 3,
        camera->encoding <= IMAGE_JPEG,
        camera->exposure_lines >= 2,
        camera->frame_period_us <= PERIOD_MAX_US,
    };
    for (uint8_t i = 0; i < sizeof in_range; i++) {
        if (!in_range[i]) {
            return (uint8_t)(i + 1);
        }
    }
    return 0;
}

void native_reply_encode(const native_reply_t *reply, uint8_t out[4]) {
    out[0] = NATIVE_MAGIC;
    out[1] = NATIVE_REPLY;
    out[2] = reply->request;
    out[3] = reply->status;
}

int native_reply_decode(bytes_t in, native_reply_t *reply) {
    const int error = native_check(in, NATIVE_REPLY, NATIVE_REPLY_BYTES);
    if (error < 0) {
        return error;
    }
    *reply = (native_reply_t){.request = in.data[2], .status = in.data[3]};
    return NATIVE_REPLY_BYTES;
}
