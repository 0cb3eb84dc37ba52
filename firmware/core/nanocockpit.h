/// The messages of NanoCockpit (IDSIA, arXiv 2601.07476): states of the STM32 over UART1, a link whose length
/// leaves out the route, and images as checked buffers that begin with 148 bytes of metadata. None of it
/// meets the stock firmware's CPX. Layouts: docs/PROTOCOL.md, "NanoCockpit".
#ifndef SPINDECK_CORE_NANOCOCKPIT_H
#define SPINDECK_CORE_NANOCOCKPIT_H

#include "cpx_link.h"
#include "image.h"

enum {
    NANOCOCKPIT_STATE_BYTES = 40,  ///< "!STA", state, CRC-32
    NANOCOCKPIT_NOISE_BYTES = 12,  ///< "!RNG", u32, CRC-32
    NANOCOCKPIT_RANGES_BYTES = 76, ///< "!TOF", 68 bytes, CRC-32
    NANOCOCKPIT_DATA_MAX = 4088,   ///< data of one packet
    NANOCOCKPIT_FRAME_MAX = 4092,  ///< its link header, and data
    NANOCOCKPIT_BEGIN_BYTES = 12,
    NANOCOCKPIT_MORE_BYTES = 4,
    NANOCOCKPIT_METADATA_BYTES = 148,
    NANOCOCKPIT_METADATA_VERSION = 10,
    NANOCOCKPIT_REPLY_BYTES = 25,
    NANOCOCKPIT_PADDING_MAX = 3, ///< bytes that the GAP8 adds to a buffer's last packet: it sends fours
};

/// The first data byte of a CPX_STREAMER packet.
enum { NANOCOCKPIT_BEGIN = 0x10, NANOCOCKPIT_MORE = 0x11 };

/// nanocockpit_begin_t.type
enum { NANOCOCKPIT_IMAGE = 0x01, NANOCOCKPIT_INFERENCE = 0xF0 };

typedef struct {
    uint32_t
        stm32_time; ///< FreeRTOS ticks of 1 ms, or the low 32 bits of the stamp clock: its firmware knows
    int16_t x_mm, y_mm, z_mm;
    int16_t vx_mm_s, vy_mm_s, vz_mm_s;
    int16_t ax_mm_s2, ay_mm_s2, az_mm_s2;
    uint32_t quat; ///< see nanocockpit_quat
    int16_t roll_mrad_s, pitch_mrad_s, yaw_mrad_s;
} nanocockpit_state_t;

/// A buffer and how much of it there is; sent in one BEGIN packet and as many MORE packets as it takes.
typedef struct {
    uint8_t type;   ///< NANOCOCKPIT_IMAGE, NANOCOCKPIT_INFERENCE
    uint32_t size;  ///< bytes of the buffer
    uint32_t check; ///< nanocockpit_check of the buffer; 0: none
} nanocockpit_begin_t;

/// What stands before the pixels in an image buffer. All times but the state's are the GAP8's stamp clock.
typedef struct {
    uint16_t width;
    uint16_t height;
    uint8_t depth;                ///< bytes per pixel
    uint8_t frame_id;             ///< the sensor's own counter
    uint32_t frame_gap8_us;       ///< end of frame
    uint32_t state_gap8_us;       ///< when `state` had come in
    nanocockpit_state_t state;    ///< the latest
    uint32_t ranges_gap8_us;      ///< when `ranges` had come in
    uint8_t ranges_count;         ///< 0, 16 or 64
    uint8_t ranges[64];           ///< of a distance sensor
    uint32_t reply_frame_gap8_us; ///< frame_gap8_us of the frame that the host has answered last
    uint32_t reply_gap8_us;       ///< when that answer had come in
    uint32_t inference_stm32_time;
    float inference[4];
} nanocockpit_metadata_t;

/// The host's answer to a frame, as a buffer of type NANOCOCKPIT_INFERENCE.
typedef struct {
    uint32_t frame_gap8_us;
    uint8_t frame_id;
} nanocockpit_reply_t;

/// A unit quaternion x, y, z, w in 32 bits: two for which component is largest, and made positive, then sign
/// and nine bits of magnitude for each of the others.
uint32_t nanocockpit_quat(const float xyzw[4]);

/// CRC-32 as zlib's, but FFFFFFFF for 0, which would mean that there is none. `crc` as crc32_zlib: give the
/// parts of a buffer to that one, and the last of them here.
uint32_t nanocockpit_check(uint32_t crc, bytes_t in);

void nanocockpit_state_encode(const nanocockpit_state_t *state, uint8_t out[40]);

/// A message on UART1: NANOCOCKPIT_STATE_BYTES and fills *state; NANOCOCKPIT_NOISE_BYTES or _RANGES_BYTES for
/// the other two, which are checked and skipped; or ERR_SHORT, ERR_START, ERR_CHECK. `*state` is untouched
/// unless it is filled.
int nanocockpit_uart_decode(bytes_t in, nanocockpit_state_t *state);

/// Its link, on SPI and on TCP: u16 length of the data alone, route, data.
void nanocockpit_link_header(const cpx_route_t *route, size_t data_size, uint8_t out[4]);
/// As cpx_link_decode, which see, with a length of up to NANOCOCKPIT_DATA_MAX. A length of 0 is idle on SPI.
int nanocockpit_link_decode(bytes_t in, cpx_packet_t *packet);

/// Heads of CPX_STREAMER packets; bytes of the buffer follow.
void nanocockpit_begin_encode(const nanocockpit_begin_t *begin, uint8_t out[12]);
void nanocockpit_more_encode(uint8_t out[4]);
/// The size of the head, or ERR_SHORT, ERR_START. Types and sizes are not judged.
int nanocockpit_begin_decode(bytes_t in, nanocockpit_begin_t *begin);
int nanocockpit_more_decode(bytes_t in);

void nanocockpit_metadata_encode(const nanocockpit_metadata_t *metadata, uint8_t out[148]);
/// NANOCOCKPIT_METADATA_BYTES, or ERR_SHORT; ERR_START for another version; ERR_VALUE unless 1 <= sides <=
/// IMAGE_SIDE_MAX, depth is 1..4 and the format is 0 (grey).
int nanocockpit_metadata_decode(bytes_t in, nanocockpit_metadata_t *metadata);

void nanocockpit_reply_encode(const nanocockpit_reply_t *reply, uint8_t out[25]);
/// NANOCOCKPIT_REPLY_BYTES, or ERR_LENGTH for any other size. The inference in it is not looked at.
int nanocockpit_reply_decode(bytes_t in, nanocockpit_reply_t *reply);

#endif
