#include "board.h"

/// The largest raw frame of the HM01B0.
enum { BODY_MAX = 324 * 324 };

static uint8_t bodies[GAP8_SLOTS][BODY_MAX] __attribute__((aligned(4)));
static uint8_t slot; ///< of the last command

void camera_init(void) {
    interrupt_enable(IRQ_CAMERA);
}

void camera_start(const uint8_t command[GAP8_CAMERA_COMMAND_BYTES]) {
    slot = command[0];
    memory_barrier();
    CAMERA->command[0] = load32_le(command);
    CAMERA->command[1] = load32_le(command + 4);
    CAMERA->address = (uint32_t)(uintptr_t)bodies[slot];
    CAMERA->size = sizeof bodies[slot];
    CAMERA->start = 1;
    memory_barrier();
}

bytes_t camera_take(void) {
    const bytes_t body = {bodies[slot], CAMERA->length};
    CAMERA->taken = 1;
    interrupt_clear(IRQ_CAMERA);
    return body;
}
