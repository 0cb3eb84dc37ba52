#include "motion.h"

enum { MM = 1000, ROOT_STEPS = 4 };

static const float PI = 3.14159265F;
static const float DEGREES = 57.2957795F; // in a radian

motion_t motion_at(const pose_t *middle, float sway_m, uint64_t up_us) {
    const uint32_t half_us = STM32_SWAY_US / 2;
    const uint32_t phase_us = (uint32_t)(up_us % STM32_SWAY_US);
    const bool forth = phase_us < half_us;
    const uint32_t gone_us = forth ? phase_us : STM32_SWAY_US - phase_us;
    const float speed_m_s = sway_m / ((float)half_us * 1e-6F);
    motion_t now = {.pose = *middle, .vx_m_s = forth ? speed_m_s : -speed_m_s};
    now.pose.x_m += sway_m * ((float)gone_us / (float)half_us - 0.5F);
    if (now.pose.qx == 0 && now.pose.qy == 0 && now.pose.qz == 0 && now.pose.qw == 0) {
        now.pose.qw = 1;
    }
    return now;
}

// There is no libm on the target, and the host must compute the same: only what every float unit does alike.

/// Of 0 to 1: Newton's steps, from a guess that halves the exponent.
static float root(float value) {
    if (!(value > 0)) {
        return 0;
    }
    uint32_t bits;
    float guess;
    memcpy(&bits, &value, sizeof bits);
    bits = (bits >> 1) + 0x1FBD1DF5U;
    memcpy(&guess, &bits, sizeof guess);
    for (int i = 0; i < ROOT_STEPS; i++) {
        guess = 0.5F * (guess + value / guess);
    }
    return guess;
}

/// Abramowitz and Stegun, 4.4.49: to 1e-5 for 0 to 1.
static float arc_tangent(float t) {
    const float s = t * t;
    return t * (0.9998660F + s * (-0.3302995F + s * (0.1801410F + s * (-0.0851330F + s * 0.0208351F))));
}

static float magnitude(float value) {
    return value < 0 ? -value : value;
}

static float angle(float y, float x) {
    const float far = magnitude(x) > magnitude(y) ? magnitude(x) : magnitude(y);
    const float near = magnitude(x) > magnitude(y) ? magnitude(y) : magnitude(x);
    if (!(far > 0)) {
        return 0;
    }
    float turn = arc_tangent(near / far);
    turn = magnitude(y) > magnitude(x) ? PI / 2 - turn : turn;
    turn = x < 0 ? PI - turn : turn;
    return y < 0 ? -turn : turn;
}

attitude_t attitude_of(const pose_t *pose) {
    const float x = pose->qx, y = pose->qy, z = pose->qz, w = pose->qw;
    const float sine = 2 * (w * y - x * z);
    return (attitude_t){
        .roll_deg = DEGREES * angle(2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        .pitch_deg = -DEGREES * angle(sine, root(1 - sine * sine)),
        .yaw_deg = DEGREES * angle(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
    };
}

int16_t thousandths(float value) {
    const float scaled = value * (float)MM;
    if (!(scaled > (float)INT16_MIN)) {
        return INT16_MIN;
    }
    return scaled < (float)INT16_MAX ? (int16_t)scaled : INT16_MAX;
}
