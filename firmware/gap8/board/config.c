#include "board.h"

// The AI-deck's camera at ten frames a second, once somebody is there to see them.
const volatile gap8_board_config_t board_config __attribute__((section(".board_config"))) = {
    .app =
        {
            .width = 324,
            .height = 244,
            .line_time_ns = 125333,
            .echo_period_us = 1000000,
            .camera =
                {
                    .analog_gain = 1,
                    .digital_gain = 64,
                    .burst = 1,
                    .encoding = IMAGE_RAW,
                    .exposure_lines = 100,
                    .frame_period_us = 100000,
                },
        },
};
