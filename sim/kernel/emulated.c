#include "world.h"

static int emulated_init(void *app, const void *config, instant_t now, int64_t local_ns) {
    emulated_t *self = app;
    (void)now;
    return emulator_power_up(self->emulator, (bytes_t){config, 0}, local_ns);
}

static int emulated_receive(void *app, int port, bytes_t in, instant_t now, int64_t local_ns) {
    (void)now;
    return emulator_receive(((emulated_t *)app)->emulator, port, in, local_ns);
}

static size_t emulated_transmit(void *app, int port, bytes_mut_t out, instant_t now, int64_t local_ns) {
    (void)now;
    return emulator_transmit(((emulated_t *)app)->emulator, port, out, local_ns);
}

static uint64_t emulated_deadline(void *app, int64_t local_ns) {
    return emulator_deadline(((emulated_t *)app)->emulator, local_ns);
}

static int64_t emulated_byte_ps(void *app, int port) {
    return emulator_byte_ps(((emulated_t *)app)->emulator, port);
}

static void emulated_reset_stamp(void *app, uint64_t to_us, int64_t local_ns) {
    emulator_reset_stamp(((emulated_t *)app)->emulator, to_us, local_ns);
}

static const node_verbs_t emulated_verbs = {emulated_init,     emulated_receive, emulated_transmit,
                                            emulated_deadline, emulated_byte_ps, emulated_reset_stamp};

int kernel_emulate(kernel_t *k, int robot, mcu_t mcu, const unicorn_api_t *api, const image_t *image) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT || image->mcu != (int)mcu || !emulator_models((int)mcu) ||
        r->nodes[mcu].boots != 0 || r->emulated[mcu].emulator != NULL) {
        return KERNEL_ERR_CONFIG;
    }
    emulator_t *emulator = emulator_new(api, image, robot, &k->report);
    if (emulator == NULL) {
        return KERNEL_ERR_MEMORY;
    }
    r->memory += emulator_bytes(emulator);
    r->emulated[mcu] = (emulated_t){.emulator = emulator};
    r->nodes[mcu].verbs = &emulated_verbs;
    r->nodes[mcu].app = &r->emulated[mcu];
    return k->report.failed ? KERNEL_ERR_IMAGE : 0;
}

void emulated_free(robot_t *r) {
    for (int mcu = 0; mcu < MCU_COUNT; mcu++) {
        emulator_free(r->emulated[mcu].emulator);
    }
}

const char *kernel_fault(const kernel_t *k) {
    return k->report.text;
}
