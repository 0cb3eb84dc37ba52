#include "parts.h"

enum {
    /// More stamps missed in a row than in 1000 s: the STM32 has started anew, nothing was missed.
    STAMP_GAP_MAX = 100000,
    MS_US = 1000,
    PAPER_STAMP_US = 3472, ///< 40 bytes at 115200 Bd
};

/// Of the messages on UART1, by gap8_firmware_t.
static uint8_t listens_for(uint8_t firmware) {
    switch (firmware) {
    case GAP8_PAPER:
        return UART1_PAPER;
    case GAP8_NANOCOCKPIT:
        return UART1_NANOCOCKPIT;
    default:
        return UART1_STAMP | UART1_ECHO;
    }
}

void gap8_times_init(gap8_t *self) {
    uart1_rx_init(&self->stamp_rx, listens_for(self->config.firmware));
    const clock_known_t known = {
        .tick_ns = self->config.stamp_tick_ns,
        .delay_ns = CLOCK_STAMP_WIRE_NS,
        .latency_us = self->config.frame_latency_us,
    };
    clock_track_init(&self->clock, &known);
}

static void add_pair(gap8_t *self, const stamp_t *stamp, uint64_t gap8_us) {
    if (self->pairs_fill == GAP8_PAIRS_MAX) {
        self->pairs_head = (uint16_t)((self->pairs_head + 1) % GAP8_PAIRS_MAX);
        self->pairs_fill--;
        self->pairs_lost++;
    }
    self->pairs[(self->pairs_head + self->pairs_fill) % GAP8_PAIRS_MAX] = (native_pair_t){
        .sequence = stamp->sequence, .stm32_us = stamp->stm32_us, .gap8_us = gap8_us, .epoch = stamp->epoch};
    self->pairs_fill++;
}

static void take_stamp(gap8_t *self, const stamp_t *stamp, uint64_t stamp_us) {
    const uint32_t gap = stamp->sequence - self->stamp_last.sequence - 1;
    if (self->stamp_valid && gap <= STAMP_GAP_MAX) {
        self->stamps_missed += gap;
    }
    self->stamp_last = *stamp;
    clock_track_take(&self->clock, stamp->stm32_us, stamp_us, stamp->epoch);
    add_pair(self, stamp, stamp_us);
}

static void take(gap8_t *self, const uart1_message_t *message, instant_t now) {
    switch (message->kind) {
    case UART1_STAMP:
        take_stamp(self, &message->stamp, now.stamp_us);
        gap8_echo_ask(self, now.up_us);
        break;
    case UART1_ECHO:
        gap8_echo_take(self, &message->echo, now.stamp_us);
        return;
    case UART1_PAPER:
        self->paper_last = message->paper;
        break;
    default:
        if (message->size != NANOCOCKPIT_STATE_BYTES) {
            return;
        }
        self->state_last = message->state;
        break;
    }
    self->stamp_valid = true;
    self->stamp_last_gap8_us = now.stamp_us;
}

void gap8_times_receive(gap8_t *self, bytes_t in, instant_t now) {
    for (size_t i = 0; i < in.size; i++) {
        uart1_message_t message;
        uart1_rx_put(&self->stamp_rx, in.data[i]);
        while (uart1_rx_take(&self->stamp_rx, &message)) {
            take(self, &message, now);
        }
    }
}

/// Since the last message on UART1, across a wrap of the stamp clock.
static uint64_t elapsed_us(const gap8_t *self, uint64_t gap8_us) {
    const uint8_t bits = self->config.stamp_bits;
    const uint64_t wrap_mask = bits == 0 || bits == 64 ? UINT64_MAX : ((uint64_t)1 << bits) - 1;
    return (gap8_us - self->stamp_last_gap8_us) & wrap_mask;
}

static uint32_t stamp_age_us(const gap8_t *self, uint64_t gap8_us) {
    if (!self->stamp_valid) {
        return UINT32_MAX;
    }
    const uint64_t age_us = elapsed_us(self, gap8_us);
    return age_us < UINT32_MAX ? (uint32_t)age_us : UINT32_MAX - 1;
}

/// What the clock tracker says.
static void set_native(gap8_t *self, uint64_t frame_gap8_us, native_frame_t *header) {
    clock_time_t time;
    clock_track_stamp(&self->clock, frame_gap8_us, self->capture_regular, &time);
    header->flags = time.flags;
    header->frame_gap8_us = frame_gap8_us;
    header->frame_stm32_us = time.stm32_us;
    header->bound_us = time.bound_us;
    header->epoch = time.epoch;
    header->stamp_sequence = self->stamp_last.sequence;
    header->stamp_age_us = stamp_age_us(self, frame_gap8_us);
    header->window_us = time.window_us;
    header->window_stamps = time.window_count;
    header->delay_us = time.mean_us;
    header->skew_ppb = time.skew_ppb;
    header->latency_us = time.latency_us;
    gap8_echo_set(self, header);
}

/// From the middle of exposure of the middle row to the end of frame.
static uint64_t middle_us(const native_frame_t *frame) {
    return ((uint64_t)frame->height + frame->exposure_lines) * frame->line_time_ns / 2 / MS_US;
}

/// Before the first message all that is known of the STM32 is 0, and so is its time of arrival: what comes
/// out then is the GAP8's own time.
static uint32_t paper_ms(const gap8_t *self, uint64_t frame_gap8_us, const native_frame_t *frame) {
    const uint8_t right = self->config.paper;
    const bool floored = (right & GAP8_PAPER_UNFLOORED) == 0;
    uint64_t time_us = self->paper_last.stm32_us;
    if (floored) {
        time_us -= time_us % MS_US;
    }
    time_us += elapsed_us(self, frame_gap8_us);
    if ((right & GAP8_PAPER_FIRST_BYTE) != 0 && self->stamp_valid) {
        time_us += PAPER_STAMP_US;
    }
    if ((right & GAP8_PAPER_MIDDLE) != 0) {
        time_us -= middle_us(frame);
    }
    return (uint32_t)((time_us + (floored ? 0 : MS_US / 2)) / MS_US);
}

void gap8_times_set(gap8_t *self, uint64_t stamp_us, gap8_slot_t *slot) {
    const native_frame_t *frame = &slot->header;
    const image_stock_t image = {frame->width, frame->height, frame->depth, frame->encoding,
                                 frame->body_bytes};
    switch (self->config.firmware) {
    case GAP8_PAPER:
        slot->paper = (paper_header_t){image, paper_ms(self, stamp_us, frame), self->paper_last.pose};
        break;
    case GAP8_NANOCOCKPIT:
        slot->metadata = (nanocockpit_metadata_t){
            .width = frame->width,
            .height = frame->height,
            .depth = frame->depth,
            .frame_id = (uint8_t)(frame->frame + self->captures_late + self->captures_failed),
            .frame_gap8_us = (uint32_t)stamp_us,
        };
        break;
    default:
        set_native(self, stamp_us, &slot->header);
        break;
    }
}
