#include "parts.h"

enum {
    PARAM_PORT = 2,
    PARAM_MISC = 3, ///< channel
    PARAM_SET_BY_NAME = 0,
    PARAM_U8 = 8,
    LOG_PORT = 5,
    LOCALIZATION_PORT = 6,
    LOCALIZATION_POSITION = 0, ///< channel
    LOCALIZATION_GENERIC = 1,  ///< likewise
    LOCALIZATION_POSE = 8,
    POSITION_BYTES = 12,
    POSE_BYTES = 28,
    APP_PORT = 13,
    NO_SUCH = 2, ///< errno.h of the Crazyflie: ENOENT
    UNFIT = 22,  ///< EINVAL
};

static bool is_finite(float value) {
    return value - value == 0;
}

/// False, and no event, for coordinates that are no numbers.
static bool take_pose(stm32_t *self, bytes_t in, uint16_t event, instant_t now) {
    float values[] = {0, 0, 0, 0, 0, 0, 1};
    for (size_t i = 0; 4 * i < in.size; i++) {
        values[i] = load_float_le(in.data + 4 * i);
        if (!is_finite(values[i])) {
            return false;
        }
    }
    const pose_t pose = {values[0], values[1], values[2], values[3], values[4], values[5], values[6]};
    stm32_heard_position(self, &pose, event, now);
    return true;
}

static bool localize(stm32_t *self, uint8_t channel, bytes_t in, instant_t now) {
    if (channel == LOCALIZATION_POSITION && in.size == POSITION_BYTES) {
        return take_pose(self, in, STM32_EST_POSITION, now);
    }
    return channel == LOCALIZATION_GENERIC && in.size == 1 + POSE_BYTES && in.data[0] == LOCALIZATION_POSE &&
           take_pose(self, (bytes_t){in.data + 1, POSE_BYTES}, STM32_EST_POSE, now);
}

static bool hear_beacon(stm32_t *self, bytes_t in, instant_t now) {
    if (beacon_decode(in, &self->beacon) < 0) {
        return false;
    }
    stm32_log_event(self, STM32_BEACON, now);
    return true;
}

/// u8 0, group, 0, name, 0, u8 type, value; the answer has an error in the type's place. There is one
/// parameter: usd.logging.
static bool set_parameter(stm32_t *self, bytes_t packet) {
    static const uint8_t LOGGING[] = "usd\0logging";
    const bytes_t in = {packet.data + 1, packet.size - 1};
    if (in.size < 2 || in.data[0] != PARAM_SET_BY_NAME) {
        return false;
    }
    size_t names = 1;
    for (int ends = 0; ends < 2 && names < in.size; names++) {
        ends += in.data[names] == 0;
    }
    if (names == in.size) {
        return false; // there is no value
    }
    const bool known = names == 1 + sizeof LOGGING && memcmp(in.data + 1, LOGGING, sizeof LOGGING) == 0;
    const bool fits = in.size == names + 2 && in.data[names] == PARAM_U8;
    if (known && fits) {
        stm32_log_set(&self->log, in.data[names + 1] != 0);
    }
    uint8_t answer[CPX_DATA_UART_MAX];
    const size_t size = 1 + names;
    if (size + 1 > sizeof answer) {
        return false;
    }
    memcpy(answer, packet.data, size);
    answer[size] = known ? (fits ? 0 : UNFIT) : NO_SUCH;
    stm32_send(self, CPX_HOST, CPX_CRTP, (bytes_t){answer, size + 1});
    return true;
}

static bool subscribe(stm32_t *self, bytes_t in, instant_t now) {
    uint8_t answer[CRTP_LOG_PACKET_MAX];
    const size_t size = crtp_log_receive(&self->telemetry, &self->table, in, now.up_us, answer);
    if (size > 0) {
        stm32_send(self, CPX_HOST, CPX_CRTP, (bytes_t){answer, size});
    }
    return size > 0;
}

void stm32_telemetry(stm32_t *self, instant_t now) {
    const stm32_values_t values = stm32_values_at(self, now.up_us);
    uint8_t packet[CRTP_LOG_PACKET_MAX];
    const size_t size = crtp_log_values(&self->telemetry, &self->table, now.up_us, &values, packet);
    stm32_send(self, CPX_HOST, CPX_CRTP, (bytes_t){packet, size});
}

bool stm32_crtp(stm32_t *self, bytes_t in, instant_t now) {
    const uint8_t port = in.data[0] >> 4;
    const uint8_t channel = in.data[0] & 3U;
    switch (port) {
    case PARAM_PORT:
        return channel == PARAM_MISC && set_parameter(self, in);
    case LOG_PORT:
        return subscribe(self, in, now);
    case LOCALIZATION_PORT:
        return localize(self, channel, (bytes_t){in.data + 1, in.size - 1}, now);
    case APP_PORT:
        return hear_beacon(self, in, now);
    default:
        return false;
    }
}
