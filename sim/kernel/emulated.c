#include "world.h"

#include "../../firmware/gap8/board/config.h"
#include "../../firmware/stm32/board/config.h"

#include <string.h>

_Static_assert((int)GAP8_STAMP_RTC == (int)QUANTUM_RTC && (int)GAP8_STAMP_1MS == (int)QUANTUM_1MS,
               "the GAP8's board has other numbers for them");

// Zeroed first, so that the padding is the same in every run.
static int emulated_init(void *app, const void *config, instant_t now, int64_t local_ns) {
    emulated_t *self = app;
    const clock_config_t *clock = self->clock;
    (void)now;
    if (self->mcu == MCU_STM32) {
        stm32_board_config_t board;
        memset(&board, 0, sizeof board);
        memcpy(&board.app, config, sizeof board.app);
        board.stamp_start_us = clock->stamp_start_us;
        board.stamp_bits = clock->stamp_bits;
        board.stamp_divider = clock->divider;
        board.storage = self->storage->function != NULL;
        return emulator_power_up(self->emulator, (bytes_t){(const uint8_t *)&board, sizeof board}, local_ns);
    }
    gap8_board_config_t board;
    memset(&board, 0, sizeof board);
    memcpy(&board.app, config, sizeof board.app);
    board.stamp_start_us = clock->stamp_start_us;
    board.stamp_bits = clock->stamp_bits;
    board.stamp_quantum = clock->quantum;
    return emulator_power_up(self->emulator, (bytes_t){(const uint8_t *)&board, sizeof board}, local_ns);
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

static void emulated_window(void *app, int64_t local_ns) {
    emulator_window(((emulated_t *)app)->emulator, local_ns);
}

static void emulated_sent(void *app, int port, int64_t local_ns) {
    emulator_sent(((emulated_t *)app)->emulator, port, local_ns);
}

static const node_verbs_t emulated_verbs = {emulated_init,     emulated_receive, emulated_transmit,
                                            emulated_deadline, emulated_byte_ps, emulated_reset_stamp,
                                            emulated_window,   emulated_sent};

// What the other end of each UART sends at.
static void set_wires(emulator_t *emulator, mcu_t mcu, const robot_config_t *config) {
    if (mcu == MCU_STM32) {
        emulator_set_wire(emulator, STM32_PORT_UART1, config->uart1_gap8_byte_ps);
        emulator_set_wire(emulator, STM32_PORT_UART2, config->uart2_esp32_byte_ps);
    } else {
        emulator_set_wire(emulator, GAP8_PORT_UART1, config->uart1_byte_ps);
    }
}

int kernel_emulate(kernel_t *k, int robot, mcu_t mcu, const unicorn_api_t *api, const image_t *image) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || (unsigned)mcu >= MCU_COUNT || image->mcu != (int)mcu || !emulator_models((int)mcu) ||
        r->nodes[mcu].boots != 0 || r->emulated[mcu].emulator != NULL) {
        return KERNEL_ERR_CONFIG;
    }
    emulator_t *emulator = emulator_new(api, image, robot, &r->report);
    if (emulator == NULL) {
        return KERNEL_ERR_MEMORY;
    }
    r->memory += emulator_bytes(emulator);
    set_wires(emulator, mcu, &r->config);
    r->emulated[mcu] = (emulated_t){
        .emulator = emulator, .mcu = mcu, .clock = &r->config.clocks[mcu], .storage = &r->storage};
    r->nodes[mcu].verbs = &emulated_verbs;
    r->nodes[mcu].app = &r->emulated[mcu];
    if (r->report.failed) {
        k->failed = r;
    }
    return r->report.failed ? KERNEL_ERR_IMAGE : 0;
}

static emulator_t *emulator_of(const kernel_t *k, int robot, mcu_t mcu) {
    const robot_t *r = robot_of(k, robot);
    return r == NULL || (unsigned)mcu >= MCU_COUNT ? NULL : r->emulated[mcu].emulator;
}

const uint8_t *kernel_memory(const kernel_t *k, int robot, mcu_t mcu, uint32_t address, size_t size) {
    const emulator_t *emulator = emulator_of(k, robot, mcu);
    bool booted = emulator != NULL && k->robots[robot]->nodes[mcu].boots != 0;
    return booted ? emulator_memory(emulator, address, size) : NULL;
}

int kernel_count_instructions(kernel_t *k, int robot, mcu_t mcu) {
    emulator_t *emulator = emulator_of(k, robot, mcu);
    if (emulator == NULL) {
        return KERNEL_ERR_CONFIG;
    }
    emulator_count(emulator);
    return 0;
}

uint64_t kernel_instructions(const kernel_t *k, int robot, mcu_t mcu) {
    const emulator_t *emulator = emulator_of(k, robot, mcu);
    return emulator == NULL ? 0 : emulator_instructions(emulator);
}

void emulated_free(robot_t *r) {
    for (int mcu = 0; mcu < MCU_COUNT; mcu++) {
        emulator_free(r->emulated[mcu].emulator);
    }
}

const char *kernel_fault(const kernel_t *k) {
    return k->failed == NULL ? "" : k->failed->report.text;
}
