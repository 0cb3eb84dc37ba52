/// The image stream, GAP8 -> host: the stock messages, and the native ones that are sent only when asked for.
///
/// Stock: an 11-byte header packet, then the body in packets of at most CPX_DATA_MAX bytes; no counter, no
/// time, no check. Native: each packet says frame and offset, each frame carries its times, counters and a
/// CRC-32 of its body, and what carries times or counters has a CRC-32 of its own: SPI has none. Both go as
/// CPX_APP from CPX_GAP8 to CPX_HOST. Firmware that speaks native announces it in the reserved bit of the
/// route of its stock header packets, where no known viewer looks; it sends native only to a host that has
/// asked (NATIVE_STREAM), until that host disconnects. Layouts: docs/PROTOCOL.md, "Image stream". Each native
/// message is one CPX packet with last_packet set. UART2 carries 98 bytes of data, so there the ESP32 cuts
/// longer ones: last_packet is clear in all pieces but the last, and the receiver joins them again by it.
/// Stock packets are cut likewise and need no joining: their receiver counts bytes.
#ifndef SPINDECK_CORE_IMAGE_H
#define SPINDECK_CORE_IMAGE_H

#include "stamp.h"

enum {
    IMAGE_STOCK_MAGIC = 0xBC,
    IMAGE_STOCK_BYTES = 11,
    IMAGE_RAW = 0,
    IMAGE_JPEG = 1,
    IMAGE_SIDE_MAX = 1024,        ///< pixels; the sensor has 324
    IMAGE_BODY_MAX = 1024 * 1024, ///< bytes; anything larger is a damaged header
    NATIVE_MAGIC = 0x4E,
    NATIVE_FRAME_BYTES = 144,
    NATIVE_FRAME_CLOCK_BYTES = 128, ///< of robots that say nothing about echoes: read, never written
    NATIVE_FRAME_SHORT_BYTES = 104, ///< nor about their clock: likewise
    NATIVE_DATA_HEAD_BYTES = 8,
    NATIVE_DATA_BODY_MAX = 1012, ///< CPX_DATA_MAX - NATIVE_DATA_HEAD_BYTES
    NATIVE_PAIRS_HEAD_BYTES = 8,
    NATIVE_PAIR_BYTES = 21,
    NATIVE_PAIRS_MAX = 48, ///< pairs in one packet
    NATIVE_STREAM_BYTES = 6,
    NATIVE_CAMERA_BYTES = 14,
    NATIVE_REPLY_BYTES = 4,
    NATIVE_STATUS_BYTES = 64,
    NATIVE_CHECK_BYTES = 4, ///< crc32_zlib of all before it: ends a frame, pairs or status message
};

/// The second byte of every native message.
enum {
    NATIVE_FRAME = 1,   ///< GAP8 -> host: starts a frame
    NATIVE_DATA = 2,    ///< GAP8 -> host: a piece of its body
    NATIVE_PAIRS = 3,   ///< GAP8 -> host: stamp messages with their time of arrival
    NATIVE_STATUS = 4,  ///< ESP32 -> host: its counters, once a second
    NATIVE_REPLY = 5,   ///< answer to a request
    NATIVE_LOG = 6,     ///< STM32 -> host: the log on its card, once a second (native_log.h)
    NATIVE_STREAM = 16, ///< host -> GAP8, ESP32 and STM32: stock or native
    NATIVE_CAMERA = 17, ///< host or STM32 -> GAP8: camera settings
};

/// native_frame_t.flags. The first two say which fields mean anything; the rest are the clock tracker's.
enum {
    FRAME_HAS_ESTIMATE = 1,   ///< frame_stm32_us is set
    FRAME_HAS_BOUND = 2,      ///< bound_us is set
    FRAME_COLD = 4,           ///< the first second, or the clocks' rates are not known yet
    FRAME_HOLDOVER = 8,       ///< no stamp for 0.25 s: the estimate runs on the last rate
    FRAME_QUARANTINE = 16,    ///< the last stamps contradict the ones before
    FRAME_STUCK = 32,         ///< the STM32's time stands still
    FRAME_EPOCH_NEW = 64,     ///< the epoch, not the first, is less than 1 s old
    FRAME_BEFORE_EPOCH = 128, ///< the frame is older than the epoch
    FRAME_QUANTISED = 256,    ///< the GAP8's stamp clock counts in steps of more than 1 us
    FRAME_REFUSED = 512,      ///< there is a reason why no estimate is given
};

typedef struct {
    uint16_t width;  ///< pixels
    uint16_t height; ///< pixels
    uint8_t depth;   ///< bytes per pixel
    uint8_t type;    ///< IMAGE_RAW or IMAGE_JPEG
    uint32_t size;   ///< bytes of the body
} image_stock_t;

/// All counters count from the boot of their MCU and wrap at 2^32.
typedef struct {
    uint32_t frame; ///< +1 for each frame that the camera completed, sent or not
    uint16_t width;
    uint16_t height;
    uint8_t depth;
    uint8_t encoding; ///< IMAGE_RAW or IMAGE_JPEG
    uint16_t flags;
    uint32_t body_bytes;
    uint32_t body_crc32;     ///< crc32_zlib of the body
    uint64_t frame_gap8_us;  ///< GAP8 stamp clock, raw, at end of frame
    uint64_t frame_stm32_us; ///< estimate of the STM32 stamp clock at end of frame
    uint32_t bound_us;       ///< of the estimate, either side, 99 %; latency_us is in it
    uint8_t epoch;           ///< of the STM32 clock
    uint8_t analog_gain;     ///< 1, 2, 4, 8
    uint8_t digital_gain;    ///< 1/64
    uint8_t burst;           ///< images of the burst that this frame belongs to
    uint32_t exposure_lines;
    uint32_t line_time_ns;   ///< GAP8 time
    uint32_t stamp_sequence; ///< of the last stamp before the frame
    uint32_t stamp_age_us;   ///< frame_gap8_us - its arrival; UINT32_MAX: none yet
    uint32_t stamps_received;
    uint32_t stamps_missed;   ///< gaps in the sequence
    uint32_t stamps_bad;      ///< CRC or garbage on UART1
    uint32_t pairs_lost;      ///< received and not reported, for want of room
    uint32_t captures_failed; ///< the camera said so, or never answered
    uint32_t captures_late;   ///< not started: no free buffer
    uint32_t frames_unsent;   ///< captured and not sent: nobody connected, or given up
    uint32_t spi_errors;
    uint32_t packets_dropped;  ///< by the GAP8, for want of room
    uint32_t window_us;        ///< what the estimate is from: stamps of so long
    uint32_t window_stamps;    ///< and so many; 0: nothing is said, here and below
    uint32_t delay_us;         ///< their mean delay above the smallest
    int32_t skew_ppb;          ///< of the STM32's stamp clock against the GAP8's
    uint32_t latency_us;       ///< part of bound_us: how late the end of frame was read is known so well
    uint32_t minimum_delay_us; ///< of a message on UART1, beyond its time on the wire, one way
    uint32_t minimum_delay_error_us; ///< of that, either side: it may all be on one way
    uint32_t echoes;                 ///< that it is from; 0: nothing is said
} native_frame_t;

typedef struct {
    uint32_t sequence;
    uint64_t stm32_us;
    uint64_t gap8_us; ///< GAP8 stamp clock at the last stop bit of the message
    uint8_t epoch;
} native_pair_t;

typedef struct {
    uint64_t up_us; ///< ESP32
    uint32_t frames_forwarded;
    uint32_t frames_dropped; ///< whole, because the TCP connection was too slow
    uint32_t frames_cut;     ///< the GAP8 began a new one before the last was complete
    uint32_t packets_forwarded;
    uint32_t packets_dropped; ///< other than images, for want of room
    uint32_t packets_unroutable;
    uint32_t uart_bad_check;
    uint32_t uart_bad_length;
    uint32_t uart_garbage_bytes;
    uint32_t uart_gaps;
    uint32_t spi_errors;
    uint32_t tcp_skipped_bytes;
} native_status_t; ///< 2 + 2 (spare) + 8 + 12 * 4 + NATIVE_CHECK_BYTES = NATIVE_STATUS_BYTES

typedef struct {
    uint8_t dialect; ///< 0 stock, 1 native
    uint16_t
        data_max; ///< longest CPX data that the host wants, NATIVE_FRAME_BYTES..CPX_DATA_MAX; 0: CPX_DATA_MAX
} native_stream_t;

typedef struct {
    uint8_t auto_exposure;    ///< 0 or 1
    uint8_t analog_gain;      ///< 1, 2, 4, 8
    uint8_t digital_gain;     ///< 1/64, 1..255
    uint8_t burst;            ///< 1..3 images back to back
    uint8_t encoding;         ///< IMAGE_RAW or IMAGE_JPEG
    uint16_t exposure_lines;  ///< 2..65535
    uint32_t frame_period_us; ///< from burst to burst; 0: as fast as it goes; at most 10 s
} native_camera_t;

typedef struct {
    uint8_t request; ///< NATIVE_STREAM or NATIVE_CAMERA
    uint8_t status;  ///< 0 done; n: the n-th field of the request is out of range, nothing was changed
} native_reply_t;

/// Encoders write exactly the size in the name. They cannot fail.
void image_stock_encode(const image_stock_t *header, uint8_t out[11]);
void native_frame_encode(const native_frame_t *frame, uint8_t out[144]);
void native_data_encode_head(uint32_t frame, uint32_t offset, uint8_t out[8]);
void native_status_encode(const native_status_t *status, uint8_t out[64]);
void native_stream_encode(const native_stream_t *stream, uint8_t out[6]);
void native_camera_encode(const native_camera_t *camera, uint8_t out[14]);
void native_reply_encode(const native_reply_t *reply, uint8_t out[4]);

/// Writes `count` (1..NATIVE_PAIRS_MAX) pairs and returns the size, or 0 when `out` is too small or count is
/// not in range. `lost` is native_frame_t.pairs_lost at that moment.
size_t native_pairs_encode(const native_pair_t *pairs, size_t count, uint32_t lost, bytes_mut_t out);

/// Decoders take one CPX packet's data and return the bytes used, or a negative ERR_*; the output is
/// untouched on error. Longer input than needed is allowed for messages (they may grow), not for the stock
/// header, which is ERR_LENGTH unless exactly 11 bytes. Stock: ERR_VALUE unless 1 <= sides <= IMAGE_SIDE_MAX,
/// depth 1..4, type 0 or 1, 1 <= size <= IMAGE_BODY_MAX, and for raw size = width * height * depth. Native
/// frame: likewise; one of less than NATIVE_FRAME_BYTES says nothing about echoes, of less than
/// NATIVE_FRAME_CLOCK_BYTES nor about the clock. Native frame, pairs and
/// status: ERR_CHECK when a CRC-32 of theirs does not match.
int image_stock_decode(bytes_t in, image_stock_t *header);
int native_frame_decode(bytes_t in, native_frame_t *frame);
/// `frame_low` gets the low 16 bits of the frame number; `body` views `in` and is never empty.
int native_data_decode(bytes_t in, uint16_t *frame_low, uint32_t *offset, bytes_t *body);
int native_pairs_decode(bytes_t in, native_pair_t pairs[48], size_t *count, uint32_t *lost);
int native_status_decode(bytes_t in, native_status_t *status);
int native_stream_decode(bytes_t in, native_stream_t *stream);
/// ERR_SHORT, ERR_START only: ranges are native_camera_check's, so that the reply can name the field.
int native_camera_decode(bytes_t in, native_camera_t *camera);
/// 0, or the 1-based place of the first field of native_camera_t that is out of range.
uint8_t native_camera_check(const native_camera_t *camera);
int native_reply_decode(bytes_t in, native_reply_t *reply);

#endif
