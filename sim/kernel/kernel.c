#include "calls.h"
#include "config.h"
#include "world.h"

#include <stdlib.h>
#include <string.h>

/// Streams of random numbers: by wire_t, then by mcu_t, then the camera's.
enum { STREAM_UART1_TO_STM32 = 8, STREAM_CLOCK = 16, STREAM_CAMERA = 32 };

/// Numbers that stay when wires are added.
static const uint32_t WIRE_STREAMS[WIRE_COUNT] = {0, 1, 2, STREAM_UART1_TO_STM32, 3, 4, 5, 6};

kernel_t *kernel_new(uint64_t seed) {
    kernel_t *k = calloc(1, sizeof *k);
    frame_truth_t *truth = calloc(TRUTH_MAX, sizeof *truth);
    if (k == NULL || truth == NULL) {
        free(k);
        free(truth);
        return NULL;
    }
    k->seed = seed;
    k->truth = truth;
    pthread_mutex_init(&k->truth_lock, NULL);
    return k;
}

static void robot_free(robot_t *r) {
    for (int wire = 0; wire < WIRE_COUNT; wire++) {
        free(r->traces[wire].bytes);
    }
    for (int direction = 0; direction < 2; direction++) {
        free(r->pipes[direction].segments);
    }
    emulated_free(r);
    for (int mcu = 0; mcu < MCU_COUNT; mcu++) {
        calls_free(r->recorders[mcu]);
    }
    free(r->camera.raw);
    free(r->camera.jpegs);
    free(r->host_in.data);
    free(r->host_out.data);
    events_free(&r->events);
    free(r);
}

void kernel_free(kernel_t *k) {
    if (k == NULL) {
        return;
    }
    for (uint32_t i = 0; i < k->robot_count; i++) {
        robot_free(k->robots[i]);
    }
    free(k->robots);
    trace_free(&k->trace);
    pthread_mutex_destroy(&k->truth_lock);
    free(k->truth);
    free(k);
}

static bool ring_new(robot_t *r, ring_t *ring, size_t capacity) {
    *ring = (ring_t){.data = calloc(capacity, 1), .capacity = capacity};
    r->memory += capacity;
    return ring->data != NULL;
}

static robot_t *robot_new(const robot_config_t *config) {
    robot_t *r = calloc(1, sizeof *r);
    if (r == NULL) {
        return NULL;
    }
    r->config = *config;
    r->memory = sizeof *r;
    if (!tcp_init(r) || !ring_new(r, &r->host_in, config->host_ring_bytes) ||
        !ring_new(r, &r->host_out, HOST_OUT_BYTES)) {
        robot_free(r);
        return NULL;
    }
    return r;
}

// The apps judge their own part of the configuration.
static bool nodes_init(kernel_t *k, robot_t *r) {
    void *const apps[MCU_COUNT] = {&r->stm32, &r->gap8, &r->esp32};
    const void *const configs[MCU_COUNT] = {&r->config.stm32, &r->config.gap8, &r->config.esp32};
    for (uint32_t mcu = 0; mcu < MCU_COUNT; mcu++) {
        const clock_config_t *clock = &r->config.clocks[mcu];
        node_t *node = &r->nodes[mcu];
        int64_t boot_ns = clock->boot_ns > k->now_ns ? clock->boot_ns : k->now_ns;
        random_t random;
        random_init(&random, k->seed, r->index, STREAM_CLOCK + mcu);
        *node =
            (node_t){.verbs = &native_verbs[mcu], .app = apps[mcu], .config = configs[mcu], .read_ns = -1};
        oscillator_init(&node->oscillator, clock, boot_ns, random);
        stamp_clock_init(&node->stamp, clock);
        if (node->verbs->init(node->app, node->config, (instant_t){0, clock->stamp_start_us}, 0) != 0) {
            return false;
        }
    }
    return true;
}

int kernel_add_robot(kernel_t *k, const robot_config_t *config) {
    if (!config_ok(config) || k->robot_count >= INT16_MAX) {
        return KERNEL_ERR_CONFIG;
    }
    robot_t **robots = realloc(k->robots, (k->robot_count + 1) * sizeof *robots);
    k->robots = robots != NULL ? robots : k->robots;
    robot_t *r = robot_new(config);
    if (robots == NULL || r == NULL || !events_grow(&r->events, SOURCE_COUNT)) {
        if (r != NULL) {
            robot_free(r);
        }
        return KERNEL_ERR_MEMORY;
    }
    r->index = k->robot_count;
    r->now_ns = k->now_ns;
    r->trace = &k->trace;
    if (!nodes_init(k, r)) {
        robot_free(r);
        return KERNEL_ERR_CONFIG;
    }
    k->robots[k->robot_count++] = r;
    for (uint32_t wire = 0; wire < WIRE_COUNT; wire++) {
        random_init(&r->carriers[wire].random, k->seed, r->index, WIRE_STREAMS[wire]);
        carrier_set_faults(&r->carriers[wire], &config->wires[wire], k->now_ns);
        trace_wire_start(&r->traces[wire]);
    }
    random_init(&r->camera.random, k->seed, r->index, STREAM_CAMERA);
    r->camera.fail = random_threshold(config->camera_fail);
    r->camera.hang = random_threshold(config->camera_hang);
    uart_init(r);
    for (uint32_t mcu = 0; mcu < MCU_COUNT; mcu++) {
        robot_at(r, SOURCE_TIMER + mcu, r->nodes[mcu].oscillator.anchor_ns);
    }
    return (int)r->index;
}

static bytes_t *copied(const bytes_t *bytes, size_t count) {
    bytes_t *copy = bytes == NULL ? NULL : calloc(count, sizeof *copy);
    if (copy != NULL) {
        memcpy(copy, bytes, count * sizeof *copy);
    }
    return copy;
}

int kernel_set_images(kernel_t *k, int robot, const bytes_t *raw, const bytes_t *jpeg, size_t count) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || count == 0 || count > UINT32_MAX) {
        return KERNEL_ERR_CONFIG;
    }
    size_t pixels = (size_t)r->config.gap8.width * r->config.gap8.height;
    for (size_t i = 0; raw != NULL && i < count; i++) {
        if (raw[i].size != pixels) {
            return KERNEL_ERR_CONFIG;
        }
    }
    bytes_t *raw_copy = copied(raw, count);
    bytes_t *jpeg_copy = copied(jpeg, count);
    if ((raw != NULL && raw_copy == NULL) || (jpeg != NULL && jpeg_copy == NULL)) {
        free(raw_copy);
        free(jpeg_copy);
        return KERNEL_ERR_MEMORY;
    }
    camera_t *camera = &r->camera;
    free(camera->raw);
    free(camera->jpegs);
    r->memory -= camera->count * sizeof(bytes_t) * ((camera->raw != NULL) + (size_t)(camera->jpegs != NULL));
    r->memory += count * sizeof(bytes_t) * ((raw != NULL) + (size_t)(jpeg != NULL));
    camera->raw = raw_copy;
    camera->jpegs = jpeg_copy;
    camera->count = (uint32_t)count;
    camera->next = 0;
    return 0;
}

int64_t kernel_now_ns(const kernel_t *k) {
    return k->now_ns;
}

uint64_t kernel_events(const kernel_t *k) {
    uint64_t handled = 0;
    for (uint32_t i = 0; i < k->robot_count; i++) {
        handled += k->robots[i]->handled;
    }
    return handled;
}
