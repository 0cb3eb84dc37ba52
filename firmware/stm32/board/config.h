/// What this image is told before it starts: the app's settings, and those of the clock that stamps.
///
/// The simulator writes it into the image (symbol board_config), so the layout is the same on the host and on
/// the target.
#ifndef SPINDECK_STM32_BOARD_CONFIG_H
#define SPINDECK_STM32_BOARD_CONFIG_H

#include "../app.h"

typedef struct {
    stm32_config_t app;
    uint64_t stamp_start_us; ///< first reading of the stamp clock
    uint8_t stamp_bits;      ///< its width: it wraps at 2^bits us; 0 means 64
    uint8_t stamp_divider;   ///< 85: 1 MHz; 84: 84/85 MHz, as crazyflie-firmware before its fix of 2026
    uint8_t storage;         ///< 1: the simulator's mailbox for a card is there (registers.h); 0: no card
    uint8_t reserved[5];
} stm32_board_config_t;

_Static_assert(sizeof(stm32_config_t) == 160, "the same on every compiler");
_Static_assert(offsetof(stm32_board_config_t, stamp_start_us) == 160, "likewise");
_Static_assert(offsetof(stm32_board_config_t, stamp_bits) == 168, "likewise");
_Static_assert(sizeof(stm32_board_config_t) == 176, "likewise");

#endif
