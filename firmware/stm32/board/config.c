#include "board.h"

#ifndef STM32_STAMP_DIVIDER
#define STM32_STAMP_DIVIDER 85
#endif

_Static_assert(STM32_STAMP_DIVIDER == 84 || STM32_STAMP_DIVIDER == 85, "see config.h");

const volatile stm32_board_config_t board_config __attribute__((section(".board_config"))) = {
    .app = {.wifi_mode = 1, .wifi_ssid = "spindeck"},
    .stamp_divider = STM32_STAMP_DIVIDER,
};
