#include "world.h"

#include <stdatomic.h>

static void handle(robot_t *r, uint32_t source) {
    if (source < SOURCE_LINE) {
        node_timer(r, (mcu_t)source);
    } else if (source < SOURCE_QUEUE) {
        uart_byte_end(r, (int)source - SOURCE_LINE);
    } else if (source < SOURCE_SPI) {
        uart_queue_due(r, (int)source - SOURCE_QUEUE);
    } else if (source == SOURCE_SPI) {
        spi_due(r);
    } else if (source < SOURCE_TCP_HEAD) {
        tcp_link_due(r, (int)source - SOURCE_TCP_LINK);
    } else if (source < SOURCE_CAMERA) {
        tcp_head_due(r, (int)source - SOURCE_TCP_HEAD);
    } else if (source == SOURCE_CAMERA) {
        camera_due(r);
    } else if (source == SOURCE_NETWORK) {
        network_due(r);
    } else {
        storage_due(r);
    }
}

static void step(robot_t *r) {
    r->now_ns = events_next_ns(&r->events);
    r->handled++;
    handle(r, events_pop(&r->events));
}

/// False when it is over for it.
static bool goes_on(const robot_t *r) {
    return !r->report.failed && !r->trace->failed;
}

static void put_truth(kernel_t *k, const frame_truth_t *truth) {
    if (k->truth_fill == TRUTH_MAX) {
        k->truth_head = (k->truth_head + 1) % TRUTH_MAX;
        k->truth_fill--;
        k->truth_lost++;
    }
    k->truth[(k->truth_head + k->truth_fill++) % TRUTH_MAX] = *truth;
}

/// Of one with more captures than are kept for one call: they come before the others'.
static void make_room(kernel_t *k, robot_t *r) {
    pthread_mutex_lock(&k->truth_lock);
    for (uint32_t i = 0; i < r->captured; i++) {
        put_truth(k, &r->captures[i].truth);
    }
    pthread_mutex_unlock(&k->truth_lock);
    r->captured = 0;
}

/// The captures of all robots, in the order in which they were known.
static void keep_truth(kernel_t *k) {
    for (;;) {
        robot_t *first = NULL;
        for (uint32_t i = 0; i < k->robot_count; i++) {
            robot_t *r = k->robots[i];
            if (r->captures_kept < r->captured &&
                (first == NULL ||
                 r->captures[r->captures_kept].known_ns < first->captures[first->captures_kept].known_ns)) {
                first = r;
            }
        }
        if (first == NULL) {
            break;
        }
        put_truth(k, &first->captures[first->captures_kept++].truth);
    }
    for (uint32_t i = 0; i < k->robot_count; i++) {
        robot_t *r = k->robots[i];
        r->captured = r->captures_kept = 0;
    }
}

/// Until then, or until its host can read so much; SIZE_MAX: never.
static void run_robot(kernel_t *k, robot_t *r, int64_t until_ns, size_t bytes) {
    while (goes_on(r) && r->host_in.fill < bytes && events_next_ns(&r->events) <= until_ns) {
        step(r);
        if (r->captured == CAPTURES_MAX) {
            make_room(k, r);
        }
    }
}

/// Robots that are still to run.
typedef struct {
    kernel_t *kernel;
    const robot_t *but;
    int64_t end_ns;
    atomic_uint next;
} queue_t;

static void *run_next_ones(void *argument) {
    queue_t *queue = argument;
    kernel_t *k = queue->kernel;
    for (;;) {
        const uint32_t i = atomic_fetch_add(&queue->next, 1);
        if (i >= k->robot_count) {
            return NULL;
        }
        if (k->robots[i] != queue->but) {
            run_robot(k, k->robots[i], queue->end_ns, SIZE_MAX);
        }
    }
}

/// Robots to which something happens by then.
static uint32_t busy(const kernel_t *k, int64_t end_ns) {
    uint32_t count = 0;
    for (uint32_t i = 0; i < k->robot_count; i++) {
        count += events_next_ns(&k->robots[i]->events) <= end_ns;
    }
    return count;
}

/// Each in one go, so that what it needs of the host's caches is loaded once, and not for each byte: the
/// watched one first, which may end it for all. Returns when it ended.
static int64_t run_each(kernel_t *k, int64_t end_ns, robot_t *watched, size_t bytes) {
    if (watched != NULL) {
        run_robot(k, watched, end_ns, bytes);
        end_ns = watched->host_in.fill >= bytes || !goes_on(watched) ? watched->now_ns : end_ns;
    }
    queue_t queue = {.kernel = k, .but = watched, .end_ns = end_ns};
    pthread_t helpers[KERNEL_THREADS_MAX];
    uint32_t count = 0;
    const uint32_t wanted = busy(k, end_ns);
    while (count + 1 < k->threads && count + 1 < wanted &&
           pthread_create(&helpers[count], NULL, run_next_ones, &queue) == 0) {
        count++;
    }
    run_next_ones(&queue);
    while (count > 0) {
        pthread_join(helpers[--count], NULL);
    }
    return end_ns;
}

/// All by turns, so that a full trace has its runs in the order in which they ended.
static int64_t run_in_order(kernel_t *k, int64_t end_ns, const robot_t *watched, size_t bytes) {
    for (;;) {
        robot_t *next = NULL;
        int64_t next_ns = end_ns;
        for (uint32_t i = 0; i < k->robot_count; i++) {
            int64_t its_ns = events_next_ns(&k->robots[i]->events);
            if (its_ns < next_ns || (next == NULL && its_ns == next_ns)) {
                next = k->robots[i];
                next_ns = its_ns;
            }
        }
        if (next == NULL) {
            return end_ns;
        }
        step(next);
        if (next->captured != 0) {
            keep_truth(k);
        }
        if (!goes_on(next) || (watched != NULL && watched->host_in.fill >= bytes)) {
            return next->now_ns;
        }
    }
}

/// The first in time whose image has failed, NULL if none has.
static const robot_t *failed(const kernel_t *k) {
    const robot_t *first = NULL;
    for (uint32_t i = 0; i < k->robot_count; i++) {
        const robot_t *r = k->robots[i];
        if (r->report.failed && (first == NULL || r->now_ns < first->now_ns)) {
            first = r;
        }
    }
    return first;
}

static void arrive(kernel_t *k, int64_t now_ns) {
    k->now_ns = now_ns;
    for (uint32_t i = 0; i < k->robot_count; i++) {
        if (k->robots[i]->now_ns < now_ns) { // after a failure others may be further on
            k->robots[i]->now_ns = now_ns;
        }
    }
}

void kernel_set_threads(kernel_t *k, uint32_t threads) {
    k->threads = threads < KERNEL_THREADS_MAX ? threads : KERNEL_THREADS_MAX;
}

int kernel_run(kernel_t *k, int64_t until_ns, int robot, size_t bytes) {
    if (until_ns < k->now_ns) {
        return KERNEL_ERR_TIME;
    }
    robot_t *watched = robot_of(k, robot);
    if (k->failed == NULL && !(watched != NULL && watched->host_in.fill >= bytes)) {
        const int64_t came_ns = k->trace.mode == TRACE_FULL ? run_in_order(k, until_ns, watched, bytes)
                                                            : run_each(k, until_ns, watched, bytes);
        keep_truth(k);
        k->failed = failed(k);
        arrive(k, k->failed == NULL ? came_ns : k->failed->now_ns);
    }
    if (k->failed != NULL) {
        return KERNEL_ERR_IMAGE;
    }
    if (k->trace.failed) {
        return KERNEL_ERR_MEMORY;
    }
    return watched != NULL && watched->host_in.fill >= bytes ? KERNEL_BYTES : KERNEL_UNTIL;
}
