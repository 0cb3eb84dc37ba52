#include "parts.h"

enum {
    IMU_PERIOD_US = 1000,
    BATTERY_FULL_MV = 4200,
    BATTERY_EMPTY_MV = 3000,
    BATTERY_US_PER_MV = 500000, ///< ten minutes
};

static uint16_t battery_mv(uint64_t up_us) {
    const uint64_t used_mv = up_us / BATTERY_US_PER_MV;
    return used_mv < BATTERY_FULL_MV - BATTERY_EMPTY_MV ? (uint16_t)(BATTERY_FULL_MV - used_mv)
                                                        : BATTERY_EMPTY_MV;
}

stm32_values_t stm32_values_at(const stm32_t *self, uint64_t up_us) {
    const motion_t moves = motion_at(&self->config.pose, self->config.sway_m, up_us);
    const pose_t *pose = &moves.pose;
    const usd_counters_t *counters = &self->log.log.counters;
    const uint16_t vbat_mv = battery_mv(up_us);
    const float xyzw[] = {pose->qx, pose->qy, pose->qz, pose->qw};
    return (stm32_values_t){
        .x_m = pose->x_m,
        .y_m = pose->y_m,
        .z_m = pose->z_m,
        .vx_m_s = moves.vx_m_s,
        .qx = pose->qx,
        .qy = pose->qy,
        .qz = pose->qz,
        .qw = pose->qw,
        .attitude = self->attitude,
        .acc_g = {0, 0, 1},
        .vbat_v = (float)vbat_mv * 1e-3F,
        .external = self->external,
        .quat = nanocockpit_quat(xyzw),
        .x_mm = thousandths(pose->x_m),
        .y_mm = thousandths(pose->y_m),
        .z_mm = thousandths(pose->z_m),
        .vx_mm_s = thousandths(moves.vx_m_s),
        .vbat_mv = vbat_mv,
        .requested = counters->requested,
        .accepted = counters->accepted,
        .dropped = counters->dropped,
        .write_errors = counters->errors,
        .stall_us = counters->stall_us,
        .syncs = counters->syncs,
        .session = counters->session,
        .card_errors = self->log.errors,
        .log_state = (uint8_t)self->log.status,
        .beacon_sequence = self->beacon.sequence,
        .beacon_us = (uint32_t)self->beacon.host_us,
        .beacon_us_high = (uint16_t)(self->beacon.host_us >> 32),
    };
}

void stm32_log_event(stm32_t *self, uint16_t event, instant_t now) {
    if (stm32_log_wants(&self->log, event)) {
        const stm32_values_t values = stm32_values_at(self, now.up_us);
        stm32_log_row(&self->log, event, now, &values);
    }
}

static bool logs_imu(const stm32_t *self) {
    return stm32_log_wants(&self->log, STM32_EST_GYROSCOPE) ||
           stm32_log_wants(&self->log, STM32_EST_ACCELERATION);
}

void stm32_heard_position(stm32_t *self, const pose_t *pose, uint16_t event, instant_t now) {
    self->external = *pose;
    stm32_log_event(self, event, now);
}

/// Samples that came before there was a log are gone.
static void skip_past(stm32_t *self, uint64_t now_us) {
    if (now_us > self->imu_next_us) {
        self->imu_next_us = next_on_grid(self->imu_next_us, IMU_PERIOD_US, now_us - 1);
    }
    if (now_us > self->mocap_next_us) {
        self->mocap_next_us = next_on_grid(self->mocap_next_us, self->config.mocap_period_us, now_us - 1);
    }
    self->sampled_file = self->log.files;
}

void stm32_log_rows(stm32_t *self, instant_t now) {
    if (self->sampled_file != self->log.files) {
        skip_past(self, now.up_us);
    }
    if (stm32_log_due(&self->log, now.up_us)) {
        stm32_log_event(self, USD_CONFIG_FIXED, now);
    }
    if (logs_imu(self) && now.up_us >= self->imu_next_us) {
        self->imu_next_us = next_on_grid(self->imu_next_us, IMU_PERIOD_US, now.up_us);
        stm32_log_event(self, STM32_EST_GYROSCOPE, now);
        stm32_log_event(self, STM32_EST_ACCELERATION, now);
    }
    if (now.up_us >= self->mocap_next_us) {
        self->mocap_next_us = next_on_grid(self->mocap_next_us, self->config.mocap_period_us, now.up_us);
        const motion_t moves = motion_at(&self->config.pose, self->config.sway_m, now.up_us);
        stm32_heard_position(self, &moves.pose, STM32_EST_POSE, now);
    }
}

uint64_t stm32_rows_deadline(const stm32_t *self) {
    uint64_t deadline_us = stm32_log_deadline(&self->log);
    if (!stm32_log_runs(&self->log)) {
        return deadline_us;
    }
    deadline_us = self->mocap_next_us < deadline_us ? self->mocap_next_us : deadline_us;
    return logs_imu(self) && self->imu_next_us < deadline_us ? self->imu_next_us : deadline_us;
}
