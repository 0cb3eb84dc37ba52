#include "world.h"

static void answer_no_card(storage_t *storage) {
    storage->answer[0] = storage->operation;
    store32_le(storage->answer + 1, (uint32_t)STORAGE_NO_CARD);
    storage->size = STORAGE_HEAD_BYTES;
}

void storage_poll(robot_t *r) {
    storage_t *storage = &r->storage;
    uint8_t request[STORAGE_REQUEST_MAX];
    const size_t size =
        node_transmit(r, MCU_STM32, STM32_PORT_STORAGE, (bytes_mut_t){request, sizeof request});
    if (size == 0) {
        return;
    }
    storage->busy = true;
    storage->operation = request[0];
    int64_t duration_ns = 0;
    if (storage->function == NULL) {
        answer_no_card(storage);
    } else {
        size_t answered = 0;
        duration_ns =
            storage->function(storage->context, r->now_ns, request, size, storage->answer, &answered);
        storage->size = answered < sizeof storage->answer ? answered : sizeof storage->answer;
    }
    robot_at(r, SOURCE_STORAGE, r->now_ns + (duration_ns > 0 ? duration_ns : 0));
}

void storage_due(robot_t *r) {
    storage_t *storage = &r->storage;
    storage->busy = false;
    node_receive(r, MCU_STM32, STM32_PORT_STORAGE, (bytes_t){storage->answer, storage->size});
    node_poll(r, MCU_STM32);
}

void storage_off(robot_t *r) {
    storage_t *storage = &r->storage;
    robot_not(r, SOURCE_STORAGE);
    storage->busy = false;
    if (storage->function != NULL) {
        size_t answered = 0;
        storage->function(storage->context, r->now_ns, NULL, 0, storage->answer, &answered);
    }
}

int kernel_set_storage(kernel_t *k, int robot, storage_function_t function, void *context) {
    robot_t *r = robot_of(k, robot);
    if (r == NULL || r->storage.busy) {
        return KERNEL_ERR_CONFIG;
    }
    r->storage.function = function;
    r->storage.context = context;
    return 0;
}
