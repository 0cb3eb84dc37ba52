/// The simulated world: true time, one oscillator per MCU, wires with byte times and faults, and robots whose
/// three apps are called exactly as a board calls them (docs/DESIGN.md, "One firmware, four verbs").
///
/// True time is integer nanoseconds from 0. Events are ordered by (time, order of creation). Everything
/// random comes from one seed, and every clock and wire has its own stream of it, so that a fault added to
/// one wire leaves the draws of all others unchanged. The same calls at the same true times give the same
/// bytes. The kernel allocates memory when robots are added and when traces grow, nowhere else.
#ifndef SPINDECK_SIM_KERNEL_H
#define SPINDECK_SIM_KERNEL_H

#include "../../firmware/esp32/app.h"
#include "../../firmware/gap8/app.h"
#include "../../firmware/stm32/app.h"
#include "../emulator/emulator.h"

typedef struct kernel kernel_t;

typedef enum { MCU_STM32 = 0, MCU_GAP8 = 1, MCU_ESP32 = 2, MCU_COUNT = 3 } mcu_t;

typedef enum {
    WIRE_UART1 = 0, ///< STM32 -> GAP8
    WIRE_UART2_TO_ESP32 = 1,
    WIRE_UART2_TO_STM32 = 2,
    WIRE_UART1_TO_STM32 = 3,
    WIRE_SPI_TO_ESP32 = 4,
    WIRE_SPI_TO_GAP8 = 5,
    WIRE_TCP_TO_HOST = 6,
    WIRE_TCP_TO_ESP32 = 7,
    WIRE_COUNT = 8,
} wire_t;

typedef enum { QUANTUM_1US = 0, QUANTUM_RTC = 1, QUANTUM_1MS = 2 } quantum_t; ///< RTC: 1/32768 s, 30.5 us

/// Local time is 0 when the MCU boots; then local += integral of (1 + rate) over true time, in integers.
typedef struct {
    int64_t boot_ns;  ///< true time at which the MCU starts, >= 0
    int64_t rate_ppb; ///< local seconds per true second, less one; within +-20,000,000
    int64_t ramp_ppb; ///< warm-up: added to the rate linearly over ramp_ns, then kept
    int64_t ramp_ns;
    int64_t step_ppb;        ///< added to the rate at once ...
    int64_t step_ns;         ///< ... so long after the first power-up, at the segment that begins next
    int64_t walk_ppb;        ///< standard deviation, after one second, of a random walk of the rate
    uint64_t stamp_start_us; ///< first reading of the stamp clock
    uint8_t stamp_bits;      ///< width of the stamp clock: it wraps at 2^bits us; 0 means 64
    uint8_t quantum;         ///< quantum_t of the stamp clock
    uint8_t divider; ///< 85: right; 84: counts at 84/85 of its nominal rate, as the released firmware does
} clock_config_t;

/// A unit is what a wire carries in one go: on a UART a run of back-to-back bytes, on SPI one direction of a
/// window, on TCP a segment. Zero everywhere is a perfect wire.
typedef struct {
    int64_t latency_ns; ///< added to every unit; on SPI the larger of both directions holds up the window
    int64_t jitter_ns;  ///< mean of an exponential delay, drawn per unit, added to the latency
    double loss;        ///< probability that a unit is lost; on TCP it is sent again after tcp_rto_ns
    double duplicate;   ///< probability that a unit comes twice (UART and SPI)
    double reorder;     ///< probability that a unit comes after the next one (UART, units up to 256 bytes)
    double drop;        ///< probability that a byte is lost (on TCP: damage that its checksum missed)
    double flip;        ///< probability that one bit of a byte is inverted (likewise)
    double burst_per_s; ///< bursts begin this often; every unit that starts within one is lost
    int64_t burst_ns;   ///< mean of a burst's exponential length
    double stall_per_s; ///< the wire stands still this often
    int64_t stall_ns;   ///< for an exponential time of this mean
} wire_faults_t;

/// What the host's port is connected to.
typedef enum {
    HOST_TCP = 0,   ///< the ESP32's TCP server
    HOST_UART2 = 1, ///< UART2 in the STM32's place (esp32_config_t.host_on_uart)
    HOST_UART1 = 2, ///< listens to UART1
} host_wire_t;

typedef struct {
    clock_config_t clocks[3]; ///< by mcu_t
    wire_faults_t wires[8];   ///< by wire_t
    stm32_config_t stm32;
    gap8_config_t gap8;
    esp32_config_t esp32;
    int64_t uart1_byte_ps;       ///< STM32 time of ten bits with the real divisor
    int64_t uart1_gap8_byte_ps;  ///< GAP8 time
    int64_t uart2_stm32_byte_ps; ///< STM32 time
    int64_t uart2_esp32_byte_ps; ///< ESP32 time
    int64_t spi_byte_ps;         ///< GAP8 time of eight bits
    int64_t spi_gap_ns;          ///< true time of the handshake before each window
    int64_t tcp_byte_ps;         ///< true time
    uint32_t tcp_window_bytes;   ///< most that is under way to the host; at least one segment of 1440
    int64_t tcp_rto_ns;
    int64_t network_up_ns;    ///< from NETWORK_START to NETWORK_UP
    int64_t camera_frame_ns;  ///< GAP8 time from capture command to end of frame, less the exposure
    int64_t camera_jitter_ns; ///< mean of an exponential delay of the end-of-frame interrupt
    double camera_fail;       ///< probability that a capture fails
    double camera_hang;       ///< probability that a capture never ends
    uint8_t host_wire;        ///< host_wire_t
    uint32_t
        host_ring_bytes; ///< received and not yet read; when full, TCP's window closes, a UART loses bytes
} robot_config_t;

/// One completed capture.
typedef struct {
    int64_t true_ns;        ///< end of frame, before camera_jitter
    int64_t stm32_stamp_ns; ///< STM32 stamp clock at true_ns, not quantised; wraps like the clock; INT64_MIN
                            ///< if not up
    uint64_t gap8_stamp_us; ///< GAP8 stamp clock as handed to the app: native_frame_t.frame_gap8_us
    uint32_t frame; ///< captures completed before this one since the GAP8 booted: native_frame_t.frame
    uint32_t boot;  ///< how often the GAP8 had been reset
    uint32_t image; ///< index of the source image
    int32_t robot;
} frame_truth_t;

/// A run of back-to-back bytes as they left the sender, before any fault of the wire.
typedef struct {
    int64_t local_start_ns; ///< the sender's
    int64_t true_start_ns;
    int64_t byte_ps; ///< the sender's local time (TCP: true time)
    uint64_t offset; ///< of its bytes in the trace's data
    uint32_t length;
    int16_t robot;
    uint8_t wire; ///< wire_t
} trace_run_t;

/// What a wire has carried and what its faults did to it, in units and bytes.
typedef struct {
    uint64_t bytes; ///< sent
    uint64_t units;
    uint64_t lost; ///< units
    uint64_t duplicated;
    uint64_t reordered;
    uint64_t dropped; ///< bytes
    uint64_t flipped; ///< bytes
    uint64_t stalls;
    uint64_t overflowed; ///< bytes lost because the host did not read, or too many were delayed on a UART
} wire_counts_t;

/// One call of one of a node's four verbs.
typedef enum { CALL_INIT = 0, CALL_RECEIVE = 1, CALL_TRANSMIT = 2, CALL_DEADLINE = 3 } call_verb_t;
typedef struct {
    instant_t now;   ///< zero of CALL_DEADLINE, which has none
    uint64_t result; ///< what it returned, sign-extended
    uint64_t offset; ///< of its bytes in the calls' data: the config, what came in, what was given out
    uint32_t length; ///< of them
    uint32_t room;   ///< CALL_TRANSMIT: how much could have been given out
    uint8_t verb;    ///< call_verb_t
    uint8_t port;
} call_t;

enum { KERNEL_THREADS_MAX = 16 };
enum { TRACE_OFF = 0, TRACE_HASH = 1, TRACE_FULL = 2 };
enum {
    KERNEL_UNTIL = 0,
    KERNEL_BYTES = 1,
    KERNEL_ERR_MEMORY = -10,
    KERNEL_ERR_CONFIG = -11,
    KERNEL_ERR_TIME = -12,
    KERNEL_ERR_IMAGE = -13
};

/// NULL when out of memory.
kernel_t *kernel_new(uint64_t seed);
void kernel_free(kernel_t *self);

/// Adds a robot whose MCUs boot at their boot_ns (from now on, if that has passed). Returns its number, 0
/// first, or KERNEL_ERR_MEMORY, KERNEL_ERR_CONFIG.
int kernel_add_robot(kernel_t *self, const robot_config_t *config);

/// That MCU runs a real image from its first boot on, which has not been yet: its bytes and times are those
/// of the native app. Not the ESP32. KERNEL_ERR_IMAGE when the image does not fit, or later from kernel_run
/// when its code did what a real MCU would not survive: then the world is over, and kernel_fault says why.
/// `api` and `image`, with its bytes, must live as long as the kernel.
int kernel_emulate(kernel_t *self, int robot, mcu_t mcu, const unicorn_api_t *api, const image_t *image);
const char *kernel_fault(const kernel_t *self);
/// Counts the instructions of an MCU that runs an image, from its next boot on; how many there have been.
int kernel_count_instructions(kernel_t *self, int robot, mcu_t mcu);
uint64_t kernel_instructions(const kernel_t *self, int robot, mcu_t mcu);
/// The memory of an MCU that runs an image; NULL where it has none, before its first boot, and of native
/// ones.
const uint8_t *kernel_memory(const kernel_t *self, int robot, mcu_t mcu, uint32_t address, size_t size);

/// The camera's pictures, taken in turn: `raw` of width * height bytes each, `jpeg` any size. The arrays are
/// copied, the bytes are not: they must live as long as the kernel.
int kernel_set_images(kernel_t *self, int robot, const bytes_t *raw, const bytes_t *jpeg, size_t count);

/// The STM32's card (firmware/stm32/storage.h): gets a request, writes its answer of at most
/// STORAGE_ANSWER_MAX bytes and its size, and returns how long the operation takes, in ns. A request of 0
/// bytes: the power has gone, whatever was under way is cut now. Called from kernel_run and kernel_reboot; it
/// must not call the kernel.
typedef int64_t (*storage_function_t)(void *context, int64_t now_ns, const uint8_t *request,
                                      size_t request_size, uint8_t *answer, size_t *answer_size);

/// From now on, or of an STM32 that runs an image from its next boot on; without one, every request is
/// answered at once with STORAGE_NO_CARD. KERNEL_ERR_CONFIG: an operation is under way.
int kernel_set_storage(kernel_t *self, int robot, storage_function_t function, void *context);

/// Runs until true time `until_ns` (KERNEL_UNTIL), or until `robot`'s host can read at least `bytes`
/// (KERNEL_BYTES; robot -1: no such stop). KERNEL_ERR_TIME if until_ns is in the past. Each robot runs in one
/// go, that robot first; but with TRACE_FULL all by turns, in the order of their events. When another's image
/// fails, the rest may be further on, up to until_ns.
int kernel_run(kernel_t *self, int64_t until_ns, int robot, size_t bytes);

/// From now on kernel_run shares the robots among so many threads, at most KERNEL_THREADS_MAX; at first there
/// is none but the caller's. It changes no byte. A storage's function may be called from any of them, for
/// each robot one call at a time.
void kernel_set_threads(kernel_t *self, uint32_t threads);

int64_t kernel_now_ns(const kernel_t *self);
uint64_t kernel_events(const kernel_t *self); ///< handled so far

/// The host's end of robot's port. connect and disconnect matter on HOST_TCP only; connect waits for the
/// ESP32's network. read returns how many bytes it moved; write how many were taken (the rest does not fit
/// the wire's bounded buffer now, or nobody is connected and nobody waits to be). On HOST_UART1 what is
/// written goes nowhere and counts as taken. A connection that the robot ends is over: connect again.
void kernel_host_connect(kernel_t *self, int robot);
void kernel_host_disconnect(kernel_t *self, int robot);
bool kernel_host_connected(const kernel_t *self, int robot);
size_t kernel_host_available(const kernel_t *self, int robot);
size_t kernel_host_read(kernel_t *self, int robot, uint8_t *out, size_t size);
size_t kernel_host_write(kernel_t *self, int robot, const uint8_t *in, size_t size);

/// What goes wrong, from now on or at once. 0, or KERNEL_ERR_CONFIG: no such robot, or a value out of range;
/// then nothing has changed. An injected unit reaches the receiver now; a reboot is off_ns without power,
/// then init.
int kernel_set_faults(kernel_t *self, int robot, wire_t wire, const wire_faults_t *faults);
int kernel_stall(kernel_t *self, int robot, wire_t wire, int64_t duration_ns);
int kernel_inject(kernel_t *self, int robot, wire_t wire, const uint8_t *in, size_t size);
/// A CRTP packet comes in by the STM32's radio. KERNEL_ERR_CONFIG also for one that runs an image, without
/// one.
int kernel_radio(kernel_t *self, int robot, const uint8_t *in, size_t size);
int kernel_set_rate(kernel_t *self, int robot, mcu_t mcu, int64_t rate_ppb);
int kernel_reset_stamp_clock(kernel_t *self, int robot, mcu_t mcu, uint64_t to_us);
int kernel_reboot(kernel_t *self, int robot, mcu_t mcu, int64_t off_ns);
int kernel_set_camera_faults(kernel_t *self, int robot, double fail, double hang);

/// Readings and state, for tests and reports. The app pointers stay valid as long as the kernel; NULL of an
/// MCU that runs an image.
uint64_t kernel_local_ns(const kernel_t *self, int robot, mcu_t mcu);
uint64_t kernel_stamp_us(const kernel_t *self, int robot, mcu_t mcu);
const stm32_t *kernel_stm32(const kernel_t *self, int robot);
const gap8_t *kernel_gap8(const kernel_t *self, int robot);
const esp32_t *kernel_esp32(const kernel_t *self, int robot);
wire_counts_t kernel_wire_counts(const kernel_t *self, int robot, wire_t wire);
size_t kernel_robot_bytes(const kernel_t *self, int robot); ///< memory that this robot takes

/// Ground truth: the captures completed since the last call, at most `count`; bounded at 65536 per kernel,
/// then the oldest go and kernel_truth_lost counts them. Each robot's come oldest first; those of all do,
/// too, as long as none has 64 or more in one kernel_run, or with TRACE_FULL.
size_t kernel_read_truth(kernel_t *self, frame_truth_t *out, size_t count);
uint64_t kernel_truth_lost(const kernel_t *self);

/// Traces, off at first. HASH keeps one running 64-bit hash (FNV-1a over run records and bytes) per robot and
/// wire; FULL keeps runs, in the order in which they ended, and bytes too. Every call starts the trace anew.
/// Out of memory: kernel_run returns KERNEL_ERR_MEMORY until then. The pointers are valid until the next
/// kernel_run.
int kernel_trace(kernel_t *self, int mode);
uint64_t kernel_trace_hash(const kernel_t *self, int robot, wire_t wire);
const trace_run_t *kernel_trace_runs(const kernel_t *self, size_t *count);
const uint8_t *kernel_trace_data(const kernel_t *self, size_t *size);
/// Forgets the runs that have ended and their bytes; those under way stay whole.
void kernel_trace_forget(kernel_t *self);

/// Records all calls of this node's verbs from now on, with what they gave: enough to run the same app alone,
/// in a debugger or on another machine. Before the first kernel_run it begins with CALL_INIT. Every camera
/// body is kept: it is meant for seconds. KERNEL_ERR_CONFIG: no such node, or it is being recorded already.
/// A node that is to be emulated must be so before. Out of memory: nothing is left (a count of 0). The
/// pointers are valid until the next kernel_run.
int kernel_record_calls(kernel_t *self, int robot, mcu_t mcu);
const call_t *kernel_calls(const kernel_t *self, int robot, mcu_t mcu, size_t *count);
const uint8_t *kernel_calls_data(const kernel_t *self, int robot, mcu_t mcu, size_t *size);

#endif
