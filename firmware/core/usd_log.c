#include "usd_log.h"

#include "checks.h"

enum { PIECE_BYTES = 64 };

static void push(usd_log_t *self, bytes_t in) {
    const uint32_t tail = (self->head + self->fill) % self->ring_bytes;
    const uint32_t room = self->ring_bytes - tail;
    const size_t first = in.size < room ? in.size : room;
    memcpy(self->ring + tail, in.data, first);
    memcpy(self->ring, in.data + first, in.size - first);
    self->fill += (uint32_t)in.size;
    self->fill_max = self->fill > self->fill_max ? self->fill : self->fill_max;
    self->bytes += (uint32_t)in.size;
    self->crc = crc32_zlib(self->crc, in);
}

/// The header is made anew whenever a part of it is wanted: it needs no room in the ring.
static void begin_header(usd_log_t *self) {
    uint8_t piece[PIECE_BYTES];
    for (size_t size = PIECE_BYTES; size == PIECE_BYTES; self->bytes += (uint32_t)size) {
        size = usd_header_encode(self->config, self->bytes, (bytes_mut_t){piece, sizeof piece});
        self->crc = crc32_zlib(self->crc, (bytes_t){piece, size});
    }
    self->header_bytes = self->bytes;
    self->status_crc = self->crc;
}

void usd_log_begin(usd_log_t *self, const usd_config_t *config, uint8_t *ring, const usd_counters_t *counters,
                   uint64_t stamp_us) {
    memset(self, 0, sizeof *self);
    self->config = config;
    self->counters = *counters;
    self->limit = UINT32_MAX;
    self->ring = ring;
    self->ring_bytes = config->ring_bytes;
    begin_header(self);
    usd_log_status(self, stamp_us);
}

bool usd_log_row(usd_log_t *self, const usd_block_t *block, uint64_t stamp_us, const void *values) {
    uint8_t row[USD_ROW_BYTES_MAX];
    const size_t size = usd_row_encode(self->config->table, block, stamp_us, values, row);
    self->counters.requested++;
    self->full = self->full || (uint64_t)self->bytes + size + USD_LOG_LIMIT_BYTES > self->limit;
    if (self->full || size + USD_LOG_END_BYTES > self->ring_bytes - self->fill) {
        self->counters.dropped++;
        return false;
    }
    self->counters.accepted++;
    push(self, (bytes_t){row, size});
    self->status_crc = crc32_zlib(self->status_crc, (bytes_t){row, size});
    return true;
}

void usd_log_missed(usd_log_t *self, uint32_t rows) {
    self->counters.requested += rows;
    self->counters.dropped += rows;
}

void usd_log_status(usd_log_t *self, uint64_t stamp_us) {
    uint8_t row[USD_STATUS_BYTES];
    usd_status_encode(self->config->table, &self->counters, stamp_us, self->status_crc, row);
    push(self, (bytes_t){row, sizeof row});
    self->status_crc = 0;
    self->made = (usd_mark_point_t){
        .bytes = self->bytes,
        .crc = self->crc,
        .accepted = self->counters.accepted,
    };
}

void usd_log_end(usd_log_t *self, uint64_t stamp_us) {
    uint8_t crc[USD_FILE_CRC_BYTES];
    usd_log_status(self, stamp_us);
    store32_le(crc, self->crc);
    push(self, (bytes_t){crc, sizeof crc});
}

size_t usd_log_peek(const usd_log_t *self, bytes_mut_t out) {
    size_t size = 0;
    if (self->written < self->header_bytes) {
        // The encoder goes on with nothing behind the header.
        size = usd_header_encode(self->config, self->written, out);
    }
    const uint32_t room = self->ring_bytes - self->head;
    const size_t rest = out.size - size < self->fill ? out.size - size : self->fill;
    const size_t first = rest < room ? rest : room;
    memcpy(out.data + size, self->ring + self->head, first);
    memcpy(out.data + size + first, self->ring, rest - first);
    return size + rest;
}

void usd_log_taken(usd_log_t *self, uint32_t bytes) {
    const uint32_t header =
        self->written < self->header_bytes ? self->header_bytes - self->written : 0; // what is left of it
    const uint32_t rows = bytes > header ? bytes - header : 0;
    self->written += bytes;
    self->head = (self->head + rows) % self->ring_bytes;
    self->fill -= rows;
    if (self->written >= self->made.bytes) {
        self->safe = self->made;
    }
}

uint32_t usd_log_safe(const usd_log_t *self) {
    return self->safe.bytes;
}

void usd_log_cut(usd_log_t *self) {
    self->counters.dropped += self->counters.accepted - self->safe.accepted;
    self->counters.accepted = self->safe.accepted;
    self->bytes = self->safe.bytes;
    self->written = self->safe.bytes;
    self->crc = self->safe.crc;
    self->status_crc = 0;
    self->made = self->safe;
    self->head = 0;
    self->fill = 0;
}
