/// The host's splitter finds the same in a stream however reads have cut it, ends what it begins, writes
/// bodies only where it was told, and accounts for every byte. The first byte of the input chooses the
/// framing and the cuts.
#include "claim.h"

#include "firmware/core/checks.h"
#include "host/native/stream.h"

typedef struct {
    stream_t stream;
    uint64_t garbage_bytes;
    uint32_t crc; ///< of all that was reported, but for garbage, of which only the sum is given
    uint8_t *body;
} reader_t;

static void note(reader_t *self, const void *memory, size_t size) {
    self->crc = crc32_zlib(self->crc, (bytes_t){memory, size});
}

static void close_frame(reader_t *self, bool whole) {
    const stream_frame_t *frame = &self->stream.closed;
    CLAIM(self->body != NULL && frame->received <= frame->size);
    CLAIM(!whole || frame->received == frame->size);
    note(self, &frame->size, sizeof frame->size);
    note(self, &frame->received, sizeof frame->received);
    if (whole) {
        note(self, self->body, frame->size);
    }
    free(self->body);
    self->body = NULL;
}

static void look(reader_t *self) {
    stream_t *stream = &self->stream;
    CLAIM(stream->event_count <= STREAM_EVENTS && stream->data_fill <= STREAM_DATA_BYTES);
    for (uint32_t i = 0; i < stream->event_count; i++) {
        const stream_event_t *event = &stream->events[i];
        if (event->kind == STREAM_GARBAGE) {
            CLAIM(event->size > 0 && event->offset + event->size <= stream->bytes);
            self->garbage_bytes += event->size;
            continue;
        }
        note(self, &event->kind, sizeof event->kind);
        note(self, &event->cause, sizeof event->cause);
        switch (event->kind) {
        case STREAM_BODY_NEEDED:
            CLAIM(self->body == NULL && event->size == stream->open.size);
            CLAIM(event->size >= 1 && event->size <= IMAGE_BODY_MAX);
            self->body = calloc(event->size, 1);
            stream->body = self->body;
            break;
        case STREAM_FRAME:
        case STREAM_LOST:
            close_frame(self, event->kind == STREAM_FRAME);
            break;
        case STREAM_PACKET:
        case STREAM_NATIVE:
            CLAIM(event->data_at <= stream->data_fill && event->size <= stream->data_fill - event->data_at);
            note(self, stream->data + event->data_at, event->size);
            break;
        case STREAM_STAMP:
            note(self, &event->message.stamp.sequence, sizeof event->message.stamp.sequence);
            note(self, &event->message.stamp.stm32_us, sizeof event->message.stamp.stm32_us);
            note(self, &event->message.paper.stm32_us, sizeof event->message.paper.stm32_us);
            note(self, &event->message.state.stm32_time, sizeof event->message.state.stm32_time);
            break;
        default:
            CLAIM(event->kind == STREAM_ANNOUNCED);
        }
    }
}

/// Reads all of `in`, `cut` bytes at a time.
static void read_all(reader_t *self, uint8_t framing, bytes_t in, size_t cut) {
    *self = (reader_t){0};
    stream_init(&self->stream, framing);
    for (size_t at = 0; at < in.size; at += cut) {
        const size_t size = in.size - at < cut ? in.size - at : cut;
        size_t calls = 0;
        bool more = true;
        while (more) {
            more = stream_push(&self->stream, in.data + at, size, 0);
            look(self);
            CLAIM(++calls <= size + 2 * STREAM_WINDOW_BYTES);
        }
    }
    CLAIM(self->stream.bytes == in.size);
    for (size_t calls = 0; stream_finish(&self->stream); calls++) {
        look(self);
        CLAIM(calls <= 2 * STREAM_WINDOW_BYTES);
    }
    look(self);
    CLAIM(self->body == NULL);
    CLAIM(self->garbage_bytes == self->stream.garbage_bytes);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    static reader_t whole;
    static reader_t in_pieces;
    if (size == 0) {
        return 0;
    }
    const uint8_t framing = data[0] % 3;
    const bytes_t in = {data + 1, size - 1};
    read_all(&whole, framing, in, in.size + 1);
    read_all(&in_pieces, framing, in, 1U + data[0] / 3U);
    CLAIM(whole.crc == in_pieces.crc);
    CLAIM(whole.garbage_bytes == in_pieces.garbage_bytes);
    CLAIM(whole.stream.stray_packets == in_pieces.stream.stray_packets);
    return 0;
}
