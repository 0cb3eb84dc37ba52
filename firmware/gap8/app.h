/// The GAP8's part: camera frames and the STM32's time in, a stamped image stream out.
///
/// The four verbs are called as in stm32/app.h, but that bytes from UART1 need no gap8_transmit but that of
/// UART1 before gap8_deadline has come: they change only what is said of frames. The camera is a port:
/// gap8_transmit on it gives a command to capture into one of GAP8_SLOTS buffers, gap8_receive on it brings
/// the finished body. Bodies are never copied: the bytes given to gap8_receive stay valid until the next
/// command for the same slot. A command while a capture is under way (it took too long:
/// GAP8_CAMERA_TIMEOUT_US) replaces it.
///
/// The images of a burst are taken back to back, so a burst starts when there are slots for all of it; one
/// that is due and cannot start is counted in captures_late: with a frame period it is left out, without one
/// it waits.
#ifndef SPINDECK_GAP8_APP_H
#define SPINDECK_GAP8_APP_H

#include "../core/clock.h"
#include "../core/cpx_link.h"
#include "../core/echo.h"
#include "../core/image.h"
#include "../core/uart1.h"

typedef enum {
    GAP8_PORT_UART1 = 0, ///< stamp messages from the STM32, and echoes
    GAP8_PORT_SPI = 1,   ///< to and from the ESP32, this side is master
    GAP8_PORT_CAMERA = 2,
    GAP8_PORT_COUNT = 3,
} gap8_port_t;

enum {
    GAP8_SLOTS = 3,
    GAP8_PAIRS_MAX = 512,      ///< kept between two frames; more are counted as lost
    GAP8_QUEUE_PACKETS = 4,    ///< small replies waiting for SPI
    GAP8_QUEUE_DATA = 64,      ///< longest small reply
    GAP8_ECHO_HALF = 32,       ///< the smallest delay is of the newest so many echoes, or up to twice as many
    GAP8_ECHO_UNANSWERED = 16, ///< questions in a row without a good answer: what was found is forgotten
    GAP8_CAMERA_TIMEOUT_US =
        500000, ///< a capture that takes this longer than twice its exposure and readout has failed
    GAP8_CAMERA_COMMAND_BYTES =
        8, ///< slot, encoding, auto exposure, analog gain, digital gain, 0, u16 exposure lines
};

/// gap8_config_t.firmware: as which one it behaves.
typedef enum {
    GAP8_NATIVE = 0,
    GAP8_STOCK = 1, ///< the stock streamer: no announcement, no native requests
    GAP8_PAPER = 2,
    GAP8_NANOCOCKPIT = 3,
} gap8_firmware_t;

/// gap8_config_t.paper: what the paper's firmware does, set right. The tick of 1 ms is its board's.
enum {
    GAP8_PAPER_UNFLOORED = 1,  ///< STM32 time and elapsed time are added in us, and rounded once
    GAP8_PAPER_FIRST_BYTE = 2, ///< elapsed since the first byte of the time message, not since its last
    GAP8_PAPER_MIDDLE = 4,  ///< the time of the middle of exposure of the middle row, not of the end of frame
    GAP8_PAPER_OVERLAP = 8, ///< frames are sent, and the next burst is taken, as soon as there is room
};

typedef struct {
    uint16_t width;            ///< pixels; 0: no camera
    uint16_t height;           ///< pixels
    uint32_t line_time_ns;     ///< GAP8 time from row to row
    native_camera_t camera;    ///< settings at boot; must pass native_camera_check
    uint32_t stamp_tick_ns;    ///< step of the stamp clock; 0: 1000
    uint32_t frame_latency_us; ///< after the end of frame 99 % of frames find the stamp clock read
    uint8_t
        stamp_bits;   ///< width of the stamp clock, 32 or more, for elapsed times across its wrap; 0 means 64
    uint8_t firmware; ///< gap8_firmware_t
    uint8_t paper;    ///< GAP8_PAPER only: sum of GAP8_PAPER_ flags
    bool nanocockpit_check;  ///< GAP8_NANOCOCKPIT only: buffers go with a CRC-32; as released they do not
    bool stream_always;      ///< stream without waiting for WIFI_CLIENT_CONNECTED
    uint32_t echo_period_us; ///< GAP8_NATIVE only: ask for an echo at the first stamp after so long; 0: never
} gap8_config_t;

typedef enum { SLOT_FREE = 0, SLOT_CAPTURING, SLOT_READY, SLOT_SENDING } gap8_slot_state_t;

typedef struct {
    gap8_slot_state_t state;
    bytes_t body;
    native_frame_t header;           ///< filled at end of frame; counters at the start of sending
    paper_header_t paper;            ///< GAP8_PAPER: likewise
    nanocockpit_metadata_t metadata; ///< GAP8_NANOCOCKPIT: likewise; the state at the start of sending
} gap8_slot_t;

typedef struct {
    uint64_t next_us; ///< uptime
    uint8_t number;   ///< of the last question
    uint8_t left;     ///< bytes of it to send
    uint8_t question[5];
    bool waits;        ///< for its answer
    uint64_t asked_us; ///< stamp clock when its first byte began to leave
    uint32_t
        sum_us[2];    ///< smallest delay there and back: of the half window under way, and of the one before
    uint8_t count[2]; ///< echoes in each
    uint8_t unanswered; ///< questions since the last good answer
} gap8_echo_t;

typedef struct {
    uint8_t size;
    uint8_t route[2];
    uint8_t data[64];
} gap8_packet_t;

typedef struct {
    gap8_config_t config;
    native_camera_t camera;      ///< of the burst under way
    native_camera_t camera_next; ///< from the next burst on
    native_stream_t stream;      ///< what the host has asked for
    bool client;                 ///< a host is connected
    uart1_rx_t stamp_rx;
    bool stamp_valid;   ///< one has been received since boot
    stamp_t stamp_last; ///< the part of these three that `firmware` names
    paper_stamp_t paper_last;
    nanocockpit_state_t state_last;
    uint64_t stamp_last_gap8_us; ///< stamp clock when it came in
    clock_track_t clock;
    gap8_echo_t echo;
    native_pair_t pairs[512]; ///< ring
    uint16_t pairs_head;
    uint16_t pairs_fill;
    gap8_slot_t slots[3];
    uint8_t order[3]; ///< slots that wait to be sent, oldest first
    uint8_t order_fill;
    int8_t capturing;         ///< slot, or -1
    int8_t sending;           ///< slot, or -1
    uint8_t burst_left;       ///< captures still to start in this burst; their slots are free
    bool capture_regular;     ///< the one under way began when it was due, a frame period after another
    bool capture_anew;        ///< the next one is the first since the settings or the rhythm may have changed
    bool capture_waits;       ///< the next burst is due, and counted as late: its slots are not free
    uint64_t capture_next_us; ///< uptime of the next burst
    uint64_t capture_timeout_us;
    nanocockpit_reply_t reply_last; ///< the frame that the host has answered last
    uint32_t reply_gap8_us;         ///< and when
    bool send_native;               ///< the dialect of the frame being sent
    bool send_header_done;
    uint16_t send_data_max;   ///< longest CPX data of the frame being sent
    uint16_t send_pairs_left; ///< pairs to go before its body
    uint32_t send_offset;     ///< body bytes sent
    uint32_t send_part_end;   ///< stock JPEG: end of the part (file header, data, footer) being sent
    gap8_packet_t queue[4];
    uint8_t queue_head;
    uint8_t queue_fill;
    uint32_t frame; ///< number of the next completed frame
    uint32_t stamps_missed;
    uint32_t pairs_lost;
    uint32_t captures_failed;
    uint32_t captures_late;
    uint32_t frames_sent;
    uint32_t frames_unsent;
    uint32_t spi_errors;
    uint32_t packets_dropped;
    uint32_t packets_unknown;
    uint32_t requests_refused;
} gap8_t;

/// 0, or ERR_VALUE when the camera settings, the size or the firmware are out of range. As stm32_init.
int gap8_init(gap8_t *self, const gap8_config_t *config, instant_t now);

/// UART1: one byte or more. SPI: what the slave sent in one window (header, route, data, padding). CAMERA:
/// the body of the capture under way, empty if it failed; `now` is the end of frame. Returns the bytes taken
/// (all).
int gap8_receive(gap8_t *self, gap8_port_t port, bytes_t in, instant_t now);

/// UART1: what is to leave now, one byte or more; its first byte leaves at `now`. SPI: header, route and data
/// for one window (`out` takes CPX_LINK_FRAME_MAX, with GAP8_NANOCOCKPIT
/// NANOCOCKPIT_FRAME_MAX), or 0 when there is nothing to
/// send; a window that the slave asked for while this returns 0 is clocked with four zero bytes. CAMERA: one
/// command of GAP8_CAMERA_COMMAND_BYTES, or 0.
size_t gap8_transmit(gap8_t *self, gap8_port_t port, bytes_mut_t out, instant_t now);

uint64_t gap8_deadline(const gap8_t *self);

#endif
