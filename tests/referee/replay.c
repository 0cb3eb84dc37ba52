#include "replay.h"

#include "../../sim/kernel/kernel.h"

#if defined(APP_STM32)
#define VERB(name) stm32_##name
typedef stm32_t app_t;
typedef stm32_config_t app_config_t;
typedef stm32_port_t port_t;
#elif defined(APP_GAP8)
#define VERB(name) gap8_##name
typedef gap8_t app_t;
typedef gap8_config_t app_config_t;
typedef gap8_port_t port_t;
#else
#define VERB(name) esp32_##name
typedef esp32_t app_t;
typedef esp32_config_t app_config_t;
typedef esp32_port_t port_t;
#endif

/// As tests/referee/recording.py writes it: u32 calls, the calls, the bytes that they point into.
extern const uint8_t recording[];

enum { CALL_BYTES = 28, HEAD_BYTES = 9, ROOM_MAX = STORAGE_REQUEST_MAX, UNSET = 0xA5 };

typedef struct {
    uint8_t verb;
    uint8_t port;
    uint32_t offset;
    uint32_t size; ///< of the bytes at the offset; of a transmit: the room
    instant_t now;
} recorded_t;

static app_t app;
static uint8_t room[ROOM_MAX];

static recorded_t recorded(const uint8_t in[CALL_BYTES]) {
    return (recorded_t){
        .verb = in[0],
        .port = in[1],
        .offset = load32_le(in + 4),
        .size = load32_le(in + 8),
        .now = {load64_le(in + 12), load64_le(in + 20)},
    };
}

static void write_byte(uint8_t byte) {
    machine_write((bytes_t){&byte, 1});
}

static void write_result(const recorded_t *call, uint64_t result) {
    uint8_t head[HEAD_BYTES] = {(uint8_t)(call->verb << 4 | call->port)};
    store64_le(head + 1, result);
    machine_write((bytes_t){head, sizeof head});
}

/// False when the call cannot be made.
static bool make(const recorded_t *call, bytes_t in) {
    switch (call->verb) {
    case CALL_INIT: {
        app_config_t config;
        if (in.size != sizeof config) {
            return false;
        }
        memcpy(&config, in.data, sizeof config);
        memset(&app, UNSET, sizeof app); // as memory is after power-up: anything
        write_result(call, (uint64_t)(int64_t)VERB(init)(&app, &config, call->now));
        return true;
    }
    case CALL_RECEIVE:
        write_result(call, (uint64_t)(int64_t)VERB(receive)(&app, (port_t)call->port, in, call->now));
        return true;
    case CALL_TRANSMIT: {
        if (call->size > sizeof room) {
            return false;
        }
        const size_t size =
            VERB(transmit)(&app, (port_t)call->port, (bytes_mut_t){room, call->size}, call->now);
        write_result(call, size);
        machine_write((bytes_t){room, size});
        return true;
    }
    case CALL_DEADLINE:
        write_result(call, VERB(deadline)(&app));
        return true;
    default:
        return false;
    }
}

void replay(void) {
    const uint32_t count = load32_le(recording);
    const uint8_t *data = recording + 4 + (size_t)count * CALL_BYTES;
    for (uint32_t i = 0; i < count; i++) {
        const recorded_t call = recorded(recording + 4 + (size_t)i * CALL_BYTES);
        // A view of the recording, so that a camera's body stays valid as it does in its buffer.
        if (!make(&call, (bytes_t){data + call.offset, call.size})) {
            write_byte(REPLAY_REFUSED);
            return;
        }
    }
    write_byte(REPLAY_END);
}
