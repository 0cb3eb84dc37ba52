/// The two halves of the GAP8's app, private to it: captures.c fills slots, frames.c empties them.
#ifndef SPINDECK_GAP8_PARTS_H
#define SPINDECK_GAP8_PARTS_H

#include "app.h"

/// Frames have somewhere to go.
static inline bool gap8_runs(const gap8_t *self) {
    return self->config.width > 0 && (self->client || self->config.stream_always);
}

/// Settings that have passed native_camera_check, from the next burst on.
void gap8_captures_set(gap8_t *self, const native_camera_t *camera, uint64_t now_us);

/// The first burst is due now.
void gap8_captures_begin(gap8_t *self, uint64_t now_us);

/// Gives up a capture that has taken too long.
void gap8_captures_expire(gap8_t *self, uint64_t now_us);

/// The next command for the camera, or 0.
size_t gap8_captures_command(gap8_t *self, bytes_mut_t out, uint64_t now_us);

/// The capture under way has ended; an empty or impossible body is a failure.
void gap8_captures_end(gap8_t *self, bytes_t body, uint64_t stamp_us);

uint64_t gap8_captures_deadline(const gap8_t *self);

/// The next packet (CPX over SPI) of the frame being sent, or of the oldest that waits, or 0.
/// `out` takes CPX_LINK_FRAME_MAX.
size_t gap8_frames_packet(gap8_t *self, bytes_mut_t out);

/// Gives up all frames, sent in part or not at all.
void gap8_frames_drop(gap8_t *self);

#endif
