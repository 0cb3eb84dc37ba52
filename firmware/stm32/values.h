/// What config.txt can name: the STM32's variables and events, and their values at one moment.
#ifndef SPINDECK_STM32_VALUES_H
#define SPINDECK_STM32_VALUES_H

#include "../core/usd_config.h"
#include "motion.h"

/// Events, by their place in the table.
enum {
    STM32_EST_POSE = 0,     ///< a pose came from outside: locSrv has it
    STM32_EST_POSITION = 1, ///< a position, likewise
    STM32_EST_GYROSCOPE = 2,
    STM32_EST_ACCELERATION = 3,
    STM32_BEACON = 4, ///< a beacon came
};

/// Units are those of the Crazyflie's log.
typedef struct {
    float x_m, y_m, z_m;
    float vx_m_s, vy_m_s, vz_m_s;
    float qx, qy, qz, qw;
    attitude_t attitude;
    float gyro_deg_s[3];
    float acc_g[3];
    float vbat_v;
    pose_t external; ///< the last that came
    uint32_t quat;   ///< compressed
    int16_t x_mm, y_mm, z_mm;
    int16_t vx_mm_s, vy_mm_s, vz_mm_s;
    uint16_t vbat_mv;
    uint8_t source;     ///< of an estPosition: 0, motion capture
    uint32_t requested; ///< rows of this log
    uint32_t accepted;
    uint32_t dropped;
    uint32_t write_errors;
    uint32_t stall_us;
    uint32_t syncs;
    uint32_t session;
    uint32_t card_errors;     ///< since boot
    uint8_t log_state;        ///< log_state_t
    uint32_t beacon_sequence; ///< of the last that came
    uint32_t beacon_us;       ///< the host's clock in it, its low 32 bits ...
    uint16_t beacon_us_high;  ///< ... and 16 more: 8.9 years
} stm32_values_t;

usd_table_t stm32_table(void);

#endif
