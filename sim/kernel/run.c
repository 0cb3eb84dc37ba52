#include "world.h"

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
        if (k->truth_fill == TRUTH_MAX) {
            k->truth_head = (k->truth_head + 1) % TRUTH_MAX;
            k->truth_fill--;
            k->truth_lost++;
        }
        k->truth[(k->truth_head + k->truth_fill++) % TRUTH_MAX] =
            first->captures[first->captures_kept++].truth;
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
            keep_truth(k);
        }
    }
}

/// One robot after the other, so that what it needs of the host's caches is loaded once, and not for each
/// byte: the watched one first, which may end it for all. Returns when it ended.
static int64_t run_one_by_one(kernel_t *k, int64_t end_ns, robot_t *watched, size_t bytes) {
    if (watched != NULL) {
        run_robot(k, watched, end_ns, bytes);
        end_ns = watched->host_in.fill >= bytes ? watched->now_ns : end_ns;
    }
    for (uint32_t i = 0; i < k->robot_count; i++) {
        if (k->robots[i] != watched) {
            run_robot(k, k->robots[i], end_ns, SIZE_MAX);
        }
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
        k->robots[i]->now_ns = now_ns;
    }
}

int kernel_run(kernel_t *k, int64_t until_ns, int robot, size_t bytes) {
    if (until_ns < k->now_ns) {
        return KERNEL_ERR_TIME;
    }
    robot_t *watched = robot_of(k, robot);
    if (k->failed == NULL && !(watched != NULL && watched->host_in.fill >= bytes)) {
        const int64_t came_ns = k->trace.mode == TRACE_FULL ? run_in_order(k, until_ns, watched, bytes)
                                                            : run_one_by_one(k, until_ns, watched, bytes);
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
