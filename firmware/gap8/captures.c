#include "parts.h"

enum { CAPTURE_LATE_US = 20 }; ///< after it was due: later is not regular

void gap8_captures_set(gap8_t *self, const native_camera_t *camera, uint64_t now_us) {
    self->camera_next = *camera;
    self->capture_waits = false;
    self->capture_anew = true;
    const uint64_t next_us = now_us + camera->frame_period_us;
    if (self->capture_next_us > next_us) {
        self->capture_next_us = next_us;
    }
}

void gap8_captures_begin(gap8_t *self, uint64_t now_us) {
    self->capture_next_us = now_us;
    self->capture_waits = false;
    self->capture_anew = true;
}

void gap8_captures_expire(gap8_t *self, uint64_t now_us) {
    if (self->capturing >= 0 && now_us >= self->capture_timeout_us) {
        self->captures_failed++;
        self->slots[self->capturing].state = SLOT_FREE;
        self->capturing = -1;
    }
}

static uint8_t free_slots(const gap8_t *self) {
    uint8_t count = 0;
    for (int i = 0; i < GAP8_SLOTS; i++) {
        if (self->slots[i].state == SLOT_FREE) {
            count++;
        }
    }
    return count;
}

/// There are slots for the next burst.
static bool burst_fits(const gap8_t *self) {
    return free_slots(self) >= (gap8_takes_turns(self) ? GAP8_SLOTS : self->camera_next.burst);
}

static int8_t free_slot(const gap8_t *self) {
    int8_t slot = 0;
    while (slot < GAP8_SLOTS - 1 && self->slots[slot].state != SLOT_FREE) {
        slot++;
    }
    return slot;
}

/// Starts the next burst if it is due and has its slots.
static bool begin_burst(gap8_t *self, uint64_t now_us) {
    if (now_us < self->capture_next_us) {
        return false;
    }
    const uint32_t period_us = self->camera_next.frame_period_us;
    const uint64_t periods = period_us == 0 ? 0 : (now_us - self->capture_next_us) / period_us + 1;
    const bool fits = burst_fits(self);
    const uint64_t late_us = now_us - self->capture_next_us;
    self->capture_regular =
        period_us > 0 && self->camera_next.burst == 1 && late_us <= CAPTURE_LATE_US && !self->capture_anew;
    self->capture_next_us += periods * period_us;
    if (fits) {
        self->camera = self->camera_next;
        self->burst_left = self->camera.burst;
        self->capture_waits = false;
        self->capture_anew = false;
    } else if (period_us > 0) {
        self->captures_late += (uint32_t)periods * self->camera_next.burst;
    } else if (!self->capture_waits) {
        self->captures_late += self->camera_next.burst;
        self->capture_waits = true;
    }
    return fits;
}

/// A long exposure is no failure.
static uint64_t timeout_us(const gap8_t *self) {
    const uint64_t lines = (uint64_t)self->config.height + self->camera.exposure_lines;
    return GAP8_CAMERA_TIMEOUT_US + 2 * lines * self->config.line_time_ns / 1000;
}

size_t gap8_captures_command(gap8_t *self, bytes_mut_t out, uint64_t now_us) {
    if (out.size < GAP8_CAMERA_COMMAND_BYTES || !gap8_runs(self) || self->capturing >= 0) {
        return 0;
    }
    if (self->burst_left == 0 && !begin_burst(self, now_us)) {
        return 0;
    }
    const int8_t slot = free_slot(self);
    self->burst_left--;
    self->slots[slot].state = SLOT_CAPTURING;
    self->capturing = slot;
    self->capture_timeout_us = now_us + timeout_us(self);
    out.data[0] = (uint8_t)slot;
    out.data[1] = self->camera.encoding;
    out.data[2] = self->camera.auto_exposure;
    out.data[3] = self->camera.analog_gain;
    out.data[4] = self->camera.digital_gain;
    out.data[5] = 0;
    store16_le(out.data + 6, self->camera.exposure_lines);
    return GAP8_CAMERA_COMMAND_BYTES;
}

static bool body_ok(const gap8_t *self, bytes_t body) {
    if (self->camera.encoding == IMAGE_RAW) {
        return body.size == (size_t)self->config.width * self->config.height;
    }
    return body.size > 0 && body.size <= IMAGE_BODY_MAX;
}

void gap8_captures_end(gap8_t *self, bytes_t body, uint64_t stamp_us) {
    if (self->capturing < 0) {
        return; // too late, and counted so
    }
    const uint8_t number = (uint8_t)self->capturing;
    gap8_slot_t *slot = &self->slots[number];
    self->capturing = -1;
    slot->state = SLOT_FREE;
    if (!body_ok(self, body)) {
        self->captures_failed++;
        return;
    }
    slot->body = body;
    slot->header = (native_frame_t){
        .frame = self->frame++,
        .width = self->config.width,
        .height = self->config.height,
        .depth = 1,
        .encoding = self->camera.encoding,
        .body_bytes = (uint32_t)body.size,
        .analog_gain = self->camera.analog_gain,
        .digital_gain = self->camera.digital_gain,
        .burst = self->camera.burst,
        .exposure_lines = self->camera.exposure_lines,
        .line_time_ns = self->config.line_time_ns,
    };
    gap8_times_set(self, stamp_us, slot);
    if (!gap8_runs(self)) {
        self->frames_unsent++;
        return;
    }
    slot->state = SLOT_READY;
    self->order[self->order_fill++] = number;
}

uint64_t gap8_captures_deadline(const gap8_t *self) {
    if (self->capturing >= 0) {
        return self->capture_timeout_us;
    }
    if (!gap8_runs(self) || (self->capture_waits && !burst_fits(self))) {
        return NEVER_US;
    }
    return self->burst_left > 0 ? 0 : self->capture_next_us;
}
