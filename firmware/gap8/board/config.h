/// What this image is told before it starts: the app's settings, and those of the clock that stamps.
///
/// The simulator writes it into the image (symbol board_config), so the layout is the same on the host and on
/// the target.
#ifndef SPINDECK_GAP8_BOARD_CONFIG_H
#define SPINDECK_GAP8_BOARD_CONFIG_H

#include "../app.h"

/// gap8_board_config_t.stamp_quantum.
enum {
    GAP8_STAMP_1US = 0,
    GAP8_STAMP_RTC = 1, ///< of 1/32768 s
    GAP8_STAMP_1MS = 2,
};

typedef struct {
    gap8_config_t app;
    uint64_t stamp_start_us; ///< first reading of the stamp clock
    uint8_t stamp_bits;      ///< its width: it wraps at 2^bits us; 0 means 64
    uint8_t stamp_quantum;   ///< its step
    uint8_t reserved[6];
} gap8_board_config_t;

_Static_assert(sizeof(gap8_config_t) == 40, "the same on every compiler");
_Static_assert(offsetof(gap8_board_config_t, stamp_start_us) == 40, "likewise");
_Static_assert(offsetof(gap8_board_config_t, stamp_bits) == 48, "likewise");
_Static_assert(sizeof(gap8_board_config_t) == 56, "likewise");

#endif
