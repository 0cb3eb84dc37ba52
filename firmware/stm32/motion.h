/// How the simulated robot flies: to and fro along x, at the height and heading of its configuration. There
/// are no sensors behind this app: what it says of itself, on UART1 and in its log, comes from here.
#ifndef SPINDECK_STM32_MOTION_H
#define SPINDECK_STM32_MOTION_H

#include "../core/paper.h"

enum { STM32_SWAY_US = 4000000 }; ///< there and back

typedef struct {
    pose_t pose;
    float vx_m_s;
} motion_t;

/// At an uptime. `sway_m` is how far it goes; a quaternion of zeros is no rotation.
motion_t motion_at(const pose_t *middle, float sway_m, uint64_t up_us);

/// As the Crazyflie logs it: degrees, the pitch with the other sign. Within 0.001 degrees.
typedef struct {
    float roll_deg;
    float pitch_deg;
    float yaw_deg;
} attitude_t;

attitude_t attitude_of(const pose_t *pose);

/// In thousandths, as near as 16 bits come.
int16_t thousandths(float value);

#endif
