#include "parts.h"

enum { TICK_US = 1000 };

static nanocockpit_state_t state(const stm32_config_t *config, instant_t now) {
    const motion_t moves = motion_at(&config->pose, config->sway_m, now.up_us);
    const pose_t *pose = &moves.pose;
    const float xyzw[] = {pose->qx, pose->qy, pose->qz, pose->qw};
    const bool ticks = config->stamp_format == STM32_NANOCOCKPIT;
    return (nanocockpit_state_t){
        .stm32_time = (uint32_t)(ticks ? now.up_us / TICK_US : now.stamp_us),
        .x_mm = thousandths(pose->x_m),
        .y_mm = thousandths(pose->y_m),
        .z_mm = thousandths(pose->z_m),
        .vx_mm_s = thousandths(moves.vx_m_s),
        .quat = nanocockpit_quat(xyzw),
    };
}

uint8_t stm32_message(stm32_t *self, instant_t now) {
    const stm32_config_t *config = &self->config;
    switch (config->stamp_format) {
    case STM32_PAPER: {
        const paper_stamp_t stamp = {now.stamp_us, motion_at(&config->pose, config->sway_m, now.up_us).pose};
        paper_stamp_encode(&stamp, self->stamp);
        return PAPER_STAMP_BYTES;
    }
    case STM32_NANOCOCKPIT:
    case STM32_NANOCOCKPIT_US: {
        const nanocockpit_state_t now_state = state(config, now);
        nanocockpit_state_encode(&now_state, self->stamp);
        return NANOCOCKPIT_STATE_BYTES;
    }
    default: {
        const stamp_t stamp = {self->stamp_sequence, now.stamp_us, self->epoch};
        stamp_encode(&stamp, self->stamp);
        return STAMP_BYTES;
    }
    }
}
