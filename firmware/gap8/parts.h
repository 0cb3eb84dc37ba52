/// The parts of the GAP8's app, private to it: times.c listens to UART1 and says when frames were taken,
/// echo.c asks for echoes there, captures.c fills slots, frames.c empties them, buffers.c does so for
/// NanoCockpit.
#ifndef SPINDECK_GAP8_PARTS_H
#define SPINDECK_GAP8_PARTS_H

#include "app.h"

/// Frames have somewhere to go.
static inline bool gap8_runs(const gap8_t *self) {
    return self->config.width > 0 && (self->client || self->config.stream_always);
}

/// The paper's firmware takes the whole of a burst before it sends any of it, and sends all of it before it
/// takes another.
static inline bool gap8_takes_turns(const gap8_t *self) {
    return self->config.firmware == GAP8_PAPER && (self->config.paper & GAP8_PAPER_OVERLAP) == 0;
}

/// Knows no time yet.
void gap8_times_init(gap8_t *self);

/// What came in on UART1; `now` is the time of its last stop bit.
void gap8_times_receive(gap8_t *self, bytes_t in, instant_t now);

/// A stamp message has just come, so that UART1 is free both ways: asks for an echo if one is due.
void gap8_echo_ask(gap8_t *self, uint64_t up_us);

/// What is left of the question.
size_t gap8_echo_transmit(gap8_t *self, bytes_mut_t out, uint64_t stamp_us);

/// An answer that has passed its check; `stamp_us` is the time of its last stop bit.
void gap8_echo_take(gap8_t *self, const echo_answer_t *answer, uint64_t stamp_us);

/// The smallest delay into the header of a frame.
void gap8_echo_set(gap8_t *self, native_frame_t *header);

/// The times of a frame that has ended now, into the slot's header of its firmware.
void gap8_times_set(gap8_t *self, uint64_t stamp_us, gap8_slot_t *slot);

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

/// The packet of NanoCockpit that begins a buffer (`begin`), or that holds its next bytes; `out` takes
/// NANOCOCKPIT_FRAME_MAX. Advances send_offset, which counts the metadata too.
size_t gap8_buffers_packet(gap8_t *self, const gap8_slot_t *slot, bool begin, bytes_mut_t out);

/// A packet for NanoCockpit's GAP8: false when it means nothing there.
bool gap8_buffers_receive(gap8_t *self, const cpx_packet_t *packet, uint64_t stamp_us);

/// Gives up all frames, sent in part or not at all.
void gap8_frames_drop(gap8_t *self);

#endif
