/// A recording of one node's verb calls: kernel_record_calls. It stands between the kernel and the node's own
/// verbs and passes everything on unchanged, whoever answers.
#ifndef SPINDECK_SIM_CALLS_H
#define SPINDECK_SIM_CALLS_H

#include "world.h"

struct recorder {
    node_verbs_t recording;    ///< what the kernel calls
    const node_verbs_t *verbs; ///< the node's own
    void *app;
    size_t config_size;
    bool failed; ///< out of memory: what came since is missing
    call_t *calls;
    size_t call_count, call_capacity;
    uint8_t *data;
    size_t size, capacity;
};

void calls_free(recorder_t *self);

#endif
