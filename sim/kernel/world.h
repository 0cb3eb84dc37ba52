/// The kernel's own state: what one robot is made of, and how its parts call each other.
///
/// After every event of a node (boot, deadline, receive, end of a transmission) node_poll asks each of its
/// idle ports, in the order of their numbers, for something to send, and then sets its timer. When a byte or
/// a window ends, its receiver comes first, then the sender is asked for the next.
#ifndef SPINDECK_SIM_WORLD_H
#define SPINDECK_SIM_WORLD_H

#include "events.h"
#include "kernel.h"
#include "oscillator.h"
#include "ring.h"
#include "stamp_clock.h"
#include "trace.h"
#include "wire.h"

#include <pthread.h>

enum {
    UART_QUEUE_BYTES = 2048,                ///< delayed on one UART; more are lost and counted as overflowed
    UART_HELD_BYTES = 256,                  ///< longest unit that can be reordered or duplicated
    SPI_SIDE_BYTES = NANOCOCKPIT_FRAME_MAX, ///< the most that one side sends in a window
    TCP_SEGMENT_BYTES = 1440,
    TCP_TO_ESP32_SEGMENTS = 16,
    TCP_SPARE_SEGMENTS = 8, ///< to the host, beyond those that fill the window: for short ones
    TCP_TRIES_MAX = 64,     ///< of one segment
    HOST_OUT_BYTES = 65536, ///< written by the host and not yet on the wire
    NETWORK_COMMAND_BYTES = 128,
    GAP8_RESET_NS = 100000000, ///< NETWORK_RESET_GAP8
    TRUTH_MAX = 65536,
    CAPTURES_MAX = 64, ///< of one robot, before they go into the truth
};

/// Every robot has these sources of events, each at most once in the queue.
enum {
    SOURCE_TIMER = 0,     ///< by mcu_t: boot while it is off, then its deadline
    SOURCE_LINE = 3,      ///< by line index: end of a byte
    SOURCE_QUEUE = 8,     ///< by wire_t, UARTs: first delayed byte
    SOURCE_SPI = 12,      ///< end of a window, or of a stall
    SOURCE_TCP_LINK = 13, ///< by direction: the segment has left, or the link may move again
    SOURCE_TCP_HEAD = 15, ///< by direction: the oldest segment arrives
    SOURCE_CAMERA = 17,
    SOURCE_NETWORK = 18,
    SOURCE_STORAGE = 19, ///< the operation ends
    SOURCE_COUNT = 20,
};

/// An app and the four verbs, so that something else than the native code can take its place: an image that
/// an emulator runs, which counts its time from the exact local time.
typedef struct {
    int (*init)(void *app, const void *config, instant_t now, int64_t local_ns);
    int (*receive)(void *app, int port, bytes_t in, instant_t now, int64_t local_ns);
    size_t (*transmit)(void *app, int port, bytes_mut_t out, instant_t now, int64_t local_ns);
    uint64_t (*deadline)(void *app, int64_t local_ns);
    int64_t (*byte_ps)(void *app, int port);                          ///< NULL: as configured
    void (*reset_stamp)(void *app, uint64_t to_us, int64_t local_ns); ///< NULL: it need not know
    void (*window)(void *app, int64_t local_ns); ///< SPI's, begun by the slave alone; NULL: likewise
    /// A UART's byte has left, and the ports are asked next; NULL: likewise.
    void (*sent)(void *app, int port, int64_t local_ns);
} node_verbs_t;

extern const node_verbs_t native_verbs[MCU_COUNT];

typedef struct {
    const node_verbs_t *verbs;
    void *app;
    const void *config;
    oscillator_t oscillator;
    stamp_clock_t stamp;
    bool up;
    uint32_t boots;
    int64_t read_ns;      ///< true time of the last reading
    int64_t local_ns;     ///< that reading
    instant_t instant;    ///< likewise
    uint64_t deadline_us; ///< for which the timer is set
} node_t;

/// The STM32's card, and the answer to the operation under way.
typedef struct {
    storage_function_t function; ///< NULL: there is none
    void *context;
    bool busy;
    uint8_t operation;
    size_t size; ///< of the answer
    uint8_t answer[STORAGE_ANSWER_MAX];
} storage_t;

/// The app of a node that runs an image.
typedef struct {
    emulator_t *emulator;
    mcu_t mcu;
    const clock_config_t *clock;
    const storage_t *storage;
} emulated_t;

/// One sender's end of a UART.
typedef struct {
    int sender; ///< mcu_t, or -1: the host
    int port;
    int wire;        ///< wire_t, or -1: goes nowhere
    int64_t byte_ps; ///< on the sender's clock
    bool busy;       ///< `byte` is on the line
    bool in_run;     ///< the last one ended just now
    uint8_t byte;
    int64_t start_ns; ///< of the run, on the sender's clock
    size_t bytes;     ///< of the run, so far
} line_t;

enum {
    LINE_UART1 = 0,
    LINE_UART2_STM32 = 1,
    LINE_UART2_ESP32 = 2,
    LINE_HOST = 3,
    LINE_UART1_GAP8 = 4,
    LINE_COUNT = 5,
};

/// A UART's faults at work: the unit that is on the line, and what is delayed.
typedef struct {
    bool engaged; ///< the present unit is not simply passed on
    bool lost;
    bool holding; ///< `held` takes the present unit: it comes after the next one
    bool copying; ///< `held` takes a copy of it: it comes twice
    bool ready;   ///< `held` is a whole unit that waits for the end of the present one
    int64_t delay_ns;
    uint16_t held_size;
    uint8_t held[UART_HELD_BYTES];
    uint32_t head, fill;
    int64_t last_ns; ///< arrival of the last byte in the queue
    int64_t arrival_ns[UART_QUEUE_BYTES];
    uint8_t bytes[UART_QUEUE_BYTES];
} uart_queue_t;

enum { UART_WIRES = 4 }; ///< the first of wire_t

typedef struct {
    bool under_way;
    size_t master_size; ///< committed by the GAP8; 0: nothing
    size_t slave_size;  ///< committed by the ESP32; 0: not ready; 4: ready, nothing to say
    uint8_t master[SPI_SIDE_BYTES];
    uint8_t slave[SPI_SIDE_BYTES];
} spi_t;

typedef struct {
    int64_t arrival_ns; ///< INT64_MAX while on the link
    uint16_t size;
    uint16_t taken; ///< by the receiver
    uint8_t bytes[TCP_SEGMENT_BYTES];
} segment_t;

/// One direction of the TCP connection: a link that carries one segment at a time, and the segments behind
/// it.
typedef struct {
    segment_t *segments;
    uint32_t capacity, head, fill;
    uint32_t under_way; ///< bytes
    bool on_link;       ///< the last segment has not left yet
    int64_t last_ns;    ///< arrival of the segment before: TCP keeps the order
} tcp_pipe_t;

enum { TO_HOST = 0, TO_ESP32 = 1 };

typedef struct {
    int64_t end_local_ns; ///< of the capture under way, GAP8
    bool ended;           ///< at end of frame; its interrupt is to come
    bool failed;
    bool jpeg;
    uint32_t completed; ///< since the GAP8 booted
    uint32_t next;      ///< image
    uint32_t count;     ///< images
    bytes_t *raw;
    bytes_t *jpegs;
    uint64_t fail, hang; ///< thresholds
    frame_truth_t truth; ///< of the capture that has ended
    random_t random;
} camera_t;

typedef struct recorder recorder_t; ///< calls.h

/// A frame_truth_t, and when it was known.
typedef struct {
    int64_t known_ns;
    frame_truth_t truth;
} capture_t;

/// Robots share nothing while they run: each has its own time and its own events.
typedef struct {
    uint32_t index;
    robot_config_t config;
    int64_t now_ns;
    events_t events;
    uint64_t handled;
    trace_t *trace; ///< the kernel's; while robots run side by side, only its mode is looked at
    emulator_report_t report;
    capture_t captures[CAPTURES_MAX]; ///< not yet in the kernel's truth
    uint32_t captured, captures_kept;
    node_t nodes[MCU_COUNT];
    recorder_t *recorders[MCU_COUNT]; ///< NULL: its calls are not recorded
    carrier_t carriers[WIRE_COUNT];
    line_t lines[LINE_COUNT];
    spi_t spi;
    tcp_pipe_t pipes[2];
    camera_t camera;
    storage_t storage;
    ring_t host_in; ///< what the host can read
    ring_t host_out;
    bool network_up;
    uint8_t network_mode;
    bool host_waits; ///< wants to connect
    bool connected;
    trace_wire_t traces[WIRE_COUNT];
    size_t memory;
    uart_queue_t queues[UART_WIRES];
    stm32_t stm32;
    gap8_t gap8;
    esp32_t esp32;
    emulated_t emulated[MCU_COUNT];
} robot_t;

struct kernel {
    uint64_t seed;
    int64_t now_ns; ///< between two calls, every robot's
    robot_t **robots;
    uint32_t robot_count;
    trace_t trace;
    const robot_t *failed; ///< whose image ended the run; NULL: none has
    frame_truth_t *truth;  ///< ring of TRUTH_MAX
    uint32_t truth_head, truth_fill;
    uint64_t truth_lost;
    pthread_mutex_t truth_lock; ///< while robots run
    uint32_t threads;
};

static inline void robot_at(robot_t *r, uint32_t source, int64_t time_ns) {
    events_set(&r->events, source, time_ns > r->now_ns ? time_ns : r->now_ns);
}
static inline void robot_not(robot_t *r, uint32_t source) {
    events_clear(&r->events, source);
}

/// NULL if there is no such robot.
static inline robot_t *robot_of(const kernel_t *k, int robot) {
    return robot >= 0 && (uint32_t)robot < k->robot_count ? k->robots[robot] : NULL;
}

// node.c
int64_t node_local_ns(const robot_t *r, node_t *node);
instant_t node_instant(const robot_t *r, node_t *node);
/// 0 and nothing when it is off.
int node_receive(robot_t *r, mcu_t mcu, int port, bytes_t in);
size_t node_transmit(robot_t *r, mcu_t mcu, int port, bytes_mut_t out);
void node_poll(robot_t *r, mcu_t mcu);
/// Sets the timer by the app's deadline; one that has passed has been polled already and waits for the next
/// event.
void node_set_timer(robot_t *r, mcu_t mcu);
void node_timer(robot_t *r, mcu_t mcu);
void node_off(robot_t *r, mcu_t mcu, int64_t off_ns);

// emulated.c
void emulated_free(robot_t *r);

// uart.c
void uart_init(robot_t *r);
void uart_poll(robot_t *r, int line);
void uart_byte_end(robot_t *r, int line);
void uart_queue_due(robot_t *r, int wire);
void uart_deliver(robot_t *r, int wire, uint8_t byte);
void uart_off(robot_t *r, mcu_t mcu);

// spi.c
void spi_poll(robot_t *r, mcu_t asker);
void spi_due(robot_t *r);
void spi_off(robot_t *r, mcu_t mcu);

// tcp.c
bool tcp_init(robot_t *r);
void tcp_poll(robot_t *r, int direction);
void tcp_link_due(robot_t *r, int direction);
void tcp_head_due(robot_t *r, int direction);
/// Offers to the ESP32 what has arrived and was not taken.
void tcp_offer(robot_t *r);
void tcp_cut(robot_t *r);

// network.c
void network_poll(robot_t *r);
void network_due(robot_t *r);
/// Tells the ESP32 of a waiting host, if the network is up.
void network_connect(robot_t *r);
void network_disconnect(robot_t *r);
void network_off(robot_t *r);

// storage.c
void storage_poll(robot_t *r);
void storage_due(robot_t *r);
void storage_off(robot_t *r);

// camera.c
void camera_poll(robot_t *r);
void camera_due(robot_t *r);
void camera_off(robot_t *r);

#endif
