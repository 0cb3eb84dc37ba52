/// Records of what left each sender: runs of back-to-back bytes, or only a hash of them.
///
/// A run is recorded when it ends; until then its bytes are kept with the wire, since runs of several wires
/// overlap. The hash takes each byte when it leaves, and the run's record (local start, true start, byte
/// time, length, each as eight bytes, little-endian) when it ends.
#ifndef SPINDECK_SIM_TRACE_H
#define SPINDECK_SIM_TRACE_H

#include "kernel.h"

typedef struct {
    int mode;
    bool failed; ///< out of memory: what came since is missing
    trace_run_t *runs;
    size_t run_count, run_capacity;
    uint8_t *data;
    size_t size, capacity;
} trace_t;

typedef struct {
    bool open;
    trace_run_t run;
    uint64_t hash;
    uint8_t *bytes; ///< of the open run; FULL only
    size_t capacity;
} trace_wire_t;

/// Starts anew in this mode: nothing recorded.
void trace_start(trace_t *self, int mode);
void trace_wire_start(trace_wire_t *wire);
void trace_free(trace_t *self);

/// Called through these when tracing is on, and not at all when it is off.
void trace_begin(trace_wire_t *wire, const trace_run_t *run);
void trace_bytes(trace_t *self, trace_wire_t *wire, bytes_t bytes);
void trace_end(trace_t *self, trace_wire_t *wire);

#endif
