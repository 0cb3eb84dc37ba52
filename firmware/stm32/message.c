#include "parts.h"

enum { TICK_US = 1000, MM = 1000 };

/// Where the robot is at an uptime, and how fast it goes: to and fro along x.
typedef struct {
    pose_t pose;
    float vx_m_s;
} motion_t;

static motion_t motion(const stm32_config_t *config, uint64_t up_us) {
    const uint32_t half_us = STM32_SWAY_US / 2;
    const uint32_t phase_us = (uint32_t)(up_us % STM32_SWAY_US);
    const bool forth = phase_us < half_us;
    const uint32_t gone_us = forth ? phase_us : STM32_SWAY_US - phase_us;
    const float speed_m_s = config->sway_m / ((float)half_us * 1e-6F);
    motion_t now = {.pose = config->pose, .vx_m_s = forth ? speed_m_s : -speed_m_s};
    now.pose.x_m += config->sway_m * ((float)gone_us / (float)half_us - 0.5F);
    if (now.pose.qx == 0 && now.pose.qy == 0 && now.pose.qz == 0 && now.pose.qw == 0) {
        now.pose.qw = 1;
    }
    return now;
}

/// In thousandths, as near as 16 bits come.
static int16_t thousandths(float value) {
    const float scaled = value * (float)MM;
    if (!(scaled > (float)INT16_MIN)) {
        return INT16_MIN;
    }
    return scaled < (float)INT16_MAX ? (int16_t)scaled : INT16_MAX;
}

static nanocockpit_state_t state(const stm32_config_t *config, instant_t now) {
    const motion_t moves = motion(config, now.up_us);
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
        const paper_stamp_t stamp = {now.stamp_us, motion(config, now.up_us).pose};
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
