#include "calls.h"

#include <stdlib.h>
#include <string.h>

static bool grow(void **memory, size_t *capacity, size_t needed, size_t item) {
    if (needed <= *capacity) {
        return true;
    }
    size_t larger = needed < 128 ? 256 : 2 * needed;
    void *moved = realloc(*memory, larger * item);
    if (moved != NULL) {
        *memory = moved;
        *capacity = larger;
    }
    return moved != NULL;
}

static void record(recorder_t *self, call_t call, bytes_t bytes) {
    void *calls = self->calls;
    void *data = self->data;
    self->failed = self->failed ||
                   !grow(&calls, &self->call_capacity, self->call_count + 1, sizeof *self->calls) ||
                   !grow(&data, &self->capacity, self->size + bytes.size, 1);
    self->calls = calls;
    self->data = data;
    if (self->failed) {
        return;
    }
    call.offset = self->size;
    call.length = (uint32_t)bytes.size;
    if (bytes.size != 0) {
        memcpy(self->data + self->size, bytes.data, bytes.size);
    }
    self->size += bytes.size;
    self->calls[self->call_count++] = call;
}

static int init(void *app, const void *config, instant_t now, int64_t local_ns) {
    recorder_t *self = app;
    int result = self->verbs->init(self->app, config, now, local_ns);
    record(self, (call_t){.verb = CALL_INIT, .now = now, .result = (uint64_t)(int64_t)result},
           (bytes_t){config, self->config_size});
    return result;
}

static int receive(void *app, int port, bytes_t in, instant_t now, int64_t local_ns) {
    recorder_t *self = app;
    int result = self->verbs->receive(self->app, port, in, now, local_ns);
    record(self,
           (call_t){
               .verb = CALL_RECEIVE, .port = (uint8_t)port, .now = now, .result = (uint64_t)(int64_t)result},
           in);
    return result;
}

static size_t transmit(void *app, int port, bytes_mut_t out, instant_t now, int64_t local_ns) {
    recorder_t *self = app;
    size_t result = self->verbs->transmit(self->app, port, out, now, local_ns);
    record(self,
           (call_t){.verb = CALL_TRANSMIT,
                    .port = (uint8_t)port,
                    .room = (uint32_t)out.size,
                    .now = now,
                    .result = result},
           (bytes_t){out.data, result});
    return result;
}

static uint64_t deadline(void *app, int64_t local_ns) {
    recorder_t *self = app;
    uint64_t result = self->verbs->deadline(self->app, local_ns);
    record(self, (call_t){.verb = CALL_DEADLINE, .result = result}, (bytes_t){NULL, 0});
    return result;
}

static int64_t byte_ps(void *app, int port) {
    recorder_t *self = app;
    return self->verbs->byte_ps(self->app, port);
}

static void reset_stamp(void *app, uint64_t to_us, int64_t local_ns) {
    recorder_t *self = app;
    self->verbs->reset_stamp(self->app, to_us, local_ns);
}

static void window(void *app, int64_t local_ns) {
    recorder_t *self = app;
    self->verbs->window(self->app, local_ns);
}

static void sent(void *app, int port, int64_t local_ns) {
    recorder_t *self = app;
    self->verbs->sent(self->app, port, local_ns);
}

int kernel_record_calls(kernel_t *k, int robot, mcu_t mcu) {
    static const size_t config_sizes[MCU_COUNT] = {sizeof(stm32_config_t), sizeof(gap8_config_t),
                                                   sizeof(esp32_config_t)};
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT || r->recorders[mcu] != NULL) {
        return KERNEL_ERR_CONFIG;
    }
    node_t *node = &r->nodes[mcu];
    recorder_t *self = calloc(1, sizeof *self);
    if (self == NULL) {
        return KERNEL_ERR_MEMORY;
    }
    self->verbs = node->verbs;
    self->app = node->app;
    self->config_size = config_sizes[mcu];
    r->recorders[mcu] = self;
    self->recording = (node_verbs_t){
        .init = init,
        .receive = receive,
        .transmit = transmit,
        .deadline = deadline,
        .byte_ps = node->verbs->byte_ps == NULL ? NULL : byte_ps,
        .reset_stamp = node->verbs->reset_stamp == NULL ? NULL : reset_stamp,
        .window = node->verbs->window == NULL ? NULL : window,
        .sent = node->verbs->sent == NULL ? NULL : sent,
    };
    node->verbs = &self->recording;
    node->app = self;
    return 0;
}

void calls_free(recorder_t *self) {
    if (self != NULL) {
        free(self->calls);
        free(self->data);
        free(self);
    }
}

static const recorder_t *recorder_of(const kernel_t *k, int robot, mcu_t mcu) {
    const robot_t *r = robot_of(k, robot);
    return r != NULL && (unsigned)mcu < MCU_COUNT ? r->recorders[mcu] : NULL;
}

const call_t *kernel_calls(const kernel_t *k, int robot, mcu_t mcu, size_t *count) {
    const recorder_t *self = recorder_of(k, robot, mcu);
    *count = self == NULL || self->failed ? 0 : self->call_count;
    return *count == 0 ? NULL : self->calls;
}

const uint8_t *kernel_calls_data(const kernel_t *k, int robot, mcu_t mcu, size_t *size) {
    const recorder_t *self = recorder_of(k, robot, mcu);
    *size = self == NULL || self->failed ? 0 : self->size;
    return *size == 0 ? NULL : self->data;
}
