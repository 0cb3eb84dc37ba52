/// The messages of the dataset paper's firmware (IMRCLab, branches cvmrs of 2023, arXiv 2303.03898): the time
/// message with the pose, the image header that carries both, and the camera settings. Its image stream is
/// the stock one but for the longer header. Layouts: docs/PROTOCOL.md, "Paper".
#ifndef SPINDECK_CORE_PAPER_H
#define SPINDECK_CORE_PAPER_H

#include "image.h"

enum {
    PAPER_STAMP_BYTES = 40,
    PAPER_STAMP_START = 0xBC,
    PAPER_STAMP_PAYLOAD = 37, ///< command, time and pose: what the check byte covers
    PAPER_STAMP_COMMAND = 1,
    PAPER_HEADER_BYTES = 43, ///< IMAGE_STOCK_BYTES, u32, pose
    PAPER_CAMERA_BYTES = 8,
    PAPER_CAMERA_COMMAND = 0,
    PAPER_CAMERA_LINES_MIN = 2,   ///< shorter exposures are made so long
    PAPER_CAMERA_LINES_MAX = 532, ///< and longer ones so short
};

/// Of the robot in the world. A unit quaternion; all zero: the GAP8 had not heard from the STM32 yet.
typedef struct {
    float x_m;
    float y_m;
    float z_m;
    float qx;
    float qy;
    float qz;
    float qw;
} pose_t;

/// STM32 -> GAP8 over UART1, 100 a second: 3.47 ms on the wire.
typedef struct {
    uint64_t stm32_us; ///< stamp clock, read before the first byte leaves
    pose_t pose;       ///< likewise
} paper_stamp_t;

/// In the place of the stock header.
typedef struct {
    image_stock_t image;
    uint32_t frame_stm32_ms; ///< STM32 stamp clock, ms, as the GAP8 has worked it out; wraps
    pose_t pose;             ///< of the last time message, not moved on to the frame
} paper_header_t;

/// STM32 or host -> GAP8, CPX_APP. Nothing answers it.
typedef struct {
    uint8_t auto_exposure;   ///< 0 or 1
    uint8_t analog_gain;     ///< 1, 2, 4, 8
    uint8_t digital_gain;    ///< 1/64
    uint16_t exposure_lines; ///< cut to PAPER_CAMERA_LINES_MIN.._MAX
    uint8_t burst;           ///< 1..3 images back to back
    uint8_t encoding;        ///< IMAGE_RAW or IMAGE_JPEG
} paper_camera_t;

/// Encoders write exactly the size in the name. They cannot fail. Floats go as their four bytes.
void paper_stamp_encode(const paper_stamp_t *stamp, uint8_t out[40]);
void paper_header_encode(const paper_header_t *header, uint8_t out[43]);
void paper_camera_encode(const paper_camera_t *camera, uint8_t out[8]);

/// PAPER_STAMP_BYTES, or ERR_SHORT, ERR_START, ERR_CHECK; *stamp is untouched on error. The check byte is the
/// XOR of the payload alone, so that one damaged message in 256 passes.
int paper_stamp_decode(bytes_t in, paper_stamp_t *stamp);

/// One CPX packet's data, of exactly that size: otherwise ERR_LENGTH. The first eleven bytes are judged as
/// image_stock_decode does; time and pose are not judged, they are bytes of somebody's estimator.
int paper_header_decode(bytes_t in, paper_header_t *header);

/// Likewise: ERR_LENGTH, ERR_START. Ranges are the receiver's.
int paper_camera_decode(bytes_t in, paper_camera_t *camera);

#endif
