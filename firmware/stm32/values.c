#include "values.h"

#define VARIABLE(named, letter, field)                                                                       \
    {.name = named, .type = letter, .offset = offsetof(stm32_values_t, field)}

static const usd_variable_t VARIABLES[] = {
    VARIABLE("stateEstimate.x", 'f', x_m),
    VARIABLE("stateEstimate.y", 'f', y_m),
    VARIABLE("stateEstimate.z", 'f', z_m),
    VARIABLE("stateEstimate.vx", 'f', vx_m_s),
    VARIABLE("stateEstimate.vy", 'f', vy_m_s),
    VARIABLE("stateEstimate.vz", 'f', vz_m_s),
    VARIABLE("stateEstimate.qx", 'f', qx),
    VARIABLE("stateEstimate.qy", 'f', qy),
    VARIABLE("stateEstimate.qz", 'f', qz),
    VARIABLE("stateEstimate.qw", 'f', qw),
    VARIABLE("stateEstimate.roll", 'f', attitude.roll_deg),
    VARIABLE("stateEstimate.pitch", 'f', attitude.pitch_deg),
    VARIABLE("stateEstimate.yaw", 'f', attitude.yaw_deg),
    VARIABLE("stateEstimateZ.x", 'h', x_mm),
    VARIABLE("stateEstimateZ.y", 'h', y_mm),
    VARIABLE("stateEstimateZ.z", 'h', z_mm),
    VARIABLE("stateEstimateZ.vx", 'h', vx_mm_s),
    VARIABLE("stateEstimateZ.vy", 'h', vy_mm_s),
    VARIABLE("stateEstimateZ.vz", 'h', vz_mm_s),
    VARIABLE("stateEstimateZ.quat", 'I', quat),
    VARIABLE("gyro.x", 'f', gyro_deg_s[0]),
    VARIABLE("gyro.y", 'f', gyro_deg_s[1]),
    VARIABLE("gyro.z", 'f', gyro_deg_s[2]),
    VARIABLE("acc.x", 'f', acc_g[0]),
    VARIABLE("acc.y", 'f', acc_g[1]),
    VARIABLE("acc.z", 'f', acc_g[2]),
    VARIABLE("locSrv.x", 'f', external.x_m),
    VARIABLE("locSrv.y", 'f', external.y_m),
    VARIABLE("locSrv.z", 'f', external.z_m),
    VARIABLE("locSrv.qx", 'f', external.qx),
    VARIABLE("locSrv.qy", 'f', external.qy),
    VARIABLE("locSrv.qz", 'f', external.qz),
    VARIABLE("locSrv.qw", 'f', external.qw),
    VARIABLE("pm.vbat", 'f', vbat_v),
    VARIABLE("pm.vbatMV", 'H', vbat_mv),
    VARIABLE("usd.eventsRequested", 'I', requested),
    VARIABLE("usd.eventsAccepted", 'I', accepted),
    VARIABLE("usd.eventsDropped", 'I', dropped),
    VARIABLE("usd.writeError", 'I', write_errors),
    VARIABLE("usd.stallUs", 'I', stall_us),
    VARIABLE("usd.syncs", 'I', syncs),
    VARIABLE("usd.session", 'I', session),
    VARIABLE("usd.cardErrors", 'I', card_errors),
    VARIABLE("usd.state", 'B', log_state),
};

static const usd_event_t EVENTS[] = {
    [STM32_EST_POSE] = {.name = "estPose"},
    [STM32_EST_POSITION] = {.name = "estPosition",
                            .payload_count = 1,
                            .payload = {VARIABLE("source", 'B', source)}},
    [STM32_EST_GYROSCOPE] = {.name = "estGyroscope"},
    [STM32_EST_ACCELERATION] = {.name = "estAcceleration"},
    [STM32_BEACON] = {.name = "beacon",
                      .payload_count = 3,
                      .payload = {VARIABLE("sequence", 'I', beacon_sequence),
                                  VARIABLE("hostUs", 'I', beacon_us),
                                  VARIABLE("hostUsHigh", 'H', beacon_us_high)}},
};

usd_table_t stm32_table(void) {
    return (usd_table_t){
        .variables = VARIABLES,
        .events = EVENTS,
        .variable_count = sizeof VARIABLES / sizeof VARIABLES[0],
        .event_count = sizeof EVENTS / sizeof EVENTS[0],
    };
}
