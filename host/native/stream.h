/// A received byte stream, split in batches: packets, garbage, stamp messages, and image bodies that are
/// copied once, straight into the caller's memory.
///
/// A TCP connection carries no magic and no check, so a header is believed when it is plausible
/// (length 2..1022, source and destination in 1..4). A plausible header with a wrong version or an unknown
/// function is believed only if another plausible header lies behind its packet. When a header is not
/// plausible, the search begins one byte behind the start of the packet before it (its length may have been
/// wrong), and ends where an image header or a native message starts, or three plausible headers in a row.
/// Nothing is released before that. What is found depends on the bytes alone, never on how reads have cut
/// them. Memory is bounded by this struct.
#ifndef SPINDECK_HOST_STREAM_H
#define SPINDECK_HOST_STREAM_H

#include "../../firmware/core/cpx_link.h"
#include "../../firmware/core/cpx_uart.h"
#include "../../firmware/core/image.h"
#include "../../firmware/core/nanocockpit.h"
#include "../../firmware/core/paper.h"
#include "../../firmware/core/uart1.h"

/// How packets are framed.
enum { STREAM_TCP = 0, STREAM_CPX_UART = 1, STREAM_STAMPS = 2 };

enum {
    STREAM_LOOKAHEAD = 8188,     ///< two packets and a header: no decision looks further
    STREAM_WINDOW_BYTES = 16376, ///< twice that: what reads have cut, put together again
    STREAM_EVENTS = 32,          ///< reported by one call
    STREAM_DATA_BYTES = 8192,    ///< packet data reported by one call
    STREAM_GARBAGE_MAX = 65536,  ///< garbage is reported at least this often
    STREAM_FUNCTIONS = 16,       ///< packets are counted by function up to here
};

/// How the length of a packet counts, on TCP: with its route or without.
enum { STREAM_CPX = 1, STREAM_NANOCOCKPIT = 2 };

/// stream_frame_t.dialect
enum { DIALECT_STOCK = 0, DIALECT_NATIVE = 1, DIALECT_PAPER = 2, DIALECT_NANOCOCKPIT = 3 };

/// stream_event_t.kind
enum {
    STREAM_BODY_NEEDED = 1, ///< stream_t.open has begun: set `body` to open.size bytes, then go on
    STREAM_FRAME = 2,       ///< stream_t.closed is complete
    STREAM_LOST = 3,        ///< stream_t.closed never will be: `cause`
    STREAM_PACKET = 4,
    STREAM_NATIVE = 5, ///< a whole native message other than frame and data
    STREAM_GARBAGE = 6,
    STREAM_STAMP = 7,
    STREAM_ANNOUNCED =
        8, ///< a stock header packet says that the robot speaks native; once per run of stock frames
};

/// stream_event_t.cause
enum {
    LOST_CUT_SHORT = 1,    ///< not native: the next frame began before this one was complete
    LOST_OVERRUN = 2,      ///< a piece reaches beyond the announced size
    LOST_MISSING_DATA = 3, ///< native: pieces did not come
    LOST_GARBAGE =
        4, ///< not native: garbage in the middle of it; nothing says how much of the body that cost
    LOST_DISCONNECTED = 5, ///< the stream ended
};

typedef struct {
    uint8_t kind;
    uint8_t cause;
    cpx_route_t route;       ///< of a packet or native message
    uint64_t offset;         ///< in the stream: of a packet's header, or of the first byte of garbage
    uint32_t size;           ///< bytes of data, of garbage, of the body needed
    uint32_t data_at;        ///< data of a packet or native message: stream_t.data[data_at]
    uart1_message_t message; ///< STREAM_STAMP
} stream_event_t;

typedef struct {
    uint8_t dialect;
    uint16_t width;
    uint16_t height;
    uint8_t depth;
    uint8_t type; ///< IMAGE_RAW or IMAGE_JPEG
    uint32_t size;
    uint32_t received;     ///< bytes of the body
    uint32_t headless;     ///< native: stream_t.headless_frames when it closed
    native_frame_t header; ///< native only
    paper_header_t paper;  ///< paper only
    nanocockpit_metadata_t nanocockpit;
    uint32_t check;        ///< NanoCockpit: of the whole buffer, 0: none
    uint32_t check_so_far; ///< NanoCockpit: CRC-32 of what stands before the pixels
} stream_frame_t;

/// The caller's. Events, data and `closed` are valid until the next call.
typedef struct {
    uint8_t framing;
    uint8_t *body; ///< memory for the body of `open`; the caller's, until the frame is closed
    uint32_t event_count;
    stream_event_t events[STREAM_EVENTS];
    uint32_t data_fill;
    uint8_t data[STREAM_DATA_BYTES];
    stream_frame_t open;
    stream_frame_t closed;
    uint32_t place; ///< in the body of `open`: where the next piece belongs
    bool in_frame;  ///< `open` is under way
    bool has_hole;  ///< a native piece of `open` is missing
    bool strays;    ///< a stock frame was lost: what follows, until a header, is the rest of it
    bool doubtful;  ///< the packet just taken contradicts what was announced: its length may be wrong
    bool announced;
    bool begin_waits; ///< the packet at `at` has begun `open` and was not used up
    uint8_t rule;     ///< STREAM_CPX or STREAM_NANOCOCKPIT
    bool rule_set;    ///< and stays so
    bool resuming;    ///< the last call returned true
    bool in_window;   ///< `at` and `last` are places in the window, not in the caller's bytes
    bool hunting;     ///< for a place to start again
    size_t at;        ///< what is judged next
    size_t last;      ///< start of the packet before it
    size_t window_fill;
    size_t window_old;     ///< bytes of the window that came in an earlier call
    uint64_t base;         ///< place in the stream of window[0], or of the caller's first byte
    uint64_t garbage_from; ///< while hunting
    uint64_t hunt_from;    ///< while hunting: start of the packet before the garbage
    uint8_t window[STREAM_WINDOW_BYTES];
    uint16_t joined_fill; ///< native packet that a router has split for UART
    uint8_t joined[CPX_DATA_MAX];
    uint32_t joined_damage;   ///< faults on the line when it began
    uint16_t stray_frame_low; ///< of native data without a header, and whether there was any
    bool has_stray_frame;
    cpx_uart_t uart;
    uint32_t line_garbage; ///< reported so far; not TCP
    uart1_rx_t stamps;
    uint64_t bytes;
    uint64_t packets[STREAM_FUNCTIONS];
    uint64_t bad_version;
    uint64_t unknown_function;
    uint64_t garbage_bytes;
    uint64_t stray_packets;   ///< pieces of images that have no frame to go to
    uint32_t headless_frames; ///< native frames of which data came and no header
    uint64_t bad_messages;    ///< native messages that cannot be decoded
} stream_t;

void stream_init(stream_t *self, uint8_t framing);

/// Before the first bytes: the length rule is known. Otherwise it is recognised.
void stream_set_rule(stream_t *self, uint8_t rule);

/// Takes `size` bytes. True: there is more in them; look at the events, give the memory asked for, and call
/// again with the same bytes. False: all are taken, look at the events. `now_us` only serves CPX over UART:
/// time on the line, less what bytes in the middle of a packet have waited for the caller.
bool stream_push(stream_t *self, const uint8_t *in, size_t size, uint64_t now_us);

/// The stream has ended: judges what is left. True as above. Afterwards only stream_init.
bool stream_finish(stream_t *self);

/// CPX over UART: what this end of the line has to send, credits and the packet given to cpx_uart_send.
size_t stream_transmit(stream_t *self, uint8_t *out, size_t size, uint64_t now_us);

#endif
