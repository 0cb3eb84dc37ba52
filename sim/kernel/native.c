#include "world.h"

#define NATIVE_VERBS(mcu)                                                                                    \
    static int mcu##_native_init(void *app, const void *config, instant_t now, int64_t local_ns) {           \
        (void)local_ns;                                                                                      \
        return mcu##_init(app, config, now);                                                                 \
    }                                                                                                        \
    static int mcu##_native_receive(void *app, int port, bytes_t in, instant_t now, int64_t local_ns) {      \
        (void)local_ns;                                                                                      \
        return mcu##_receive(app, (mcu##_port_t)port, in, now);                                              \
    }                                                                                                        \
    static size_t mcu##_native_transmit(void *app, int port, bytes_mut_t out, instant_t now,                 \
                                        int64_t local_ns) {                                                  \
        (void)local_ns;                                                                                      \
        return mcu##_transmit(app, (mcu##_port_t)port, out, now);                                            \
    }                                                                                                        \
    static uint64_t mcu##_native_deadline(void *app, int64_t local_ns) {                                     \
        (void)local_ns;                                                                                      \
        return mcu##_deadline(app);                                                                          \
    }

NATIVE_VERBS(stm32)
NATIVE_VERBS(gap8)
NATIVE_VERBS(esp32)

#define NATIVE_TABLE(mcu)                                                                                    \
    {mcu##_native_init,                                                                                      \
     mcu##_native_receive,                                                                                   \
     mcu##_native_transmit,                                                                                  \
     mcu##_native_deadline,                                                                                  \
     NULL,                                                                                                   \
     NULL,                                                                                                   \
     NULL,                                                                                                   \
     NULL}

const node_verbs_t native_verbs[MCU_COUNT] = {NATIVE_TABLE(stm32), NATIVE_TABLE(gap8), NATIVE_TABLE(esp32)};
