#include "world.h"

static void answer_no_card(storage_t *storage) {
    storage->answer[0] = storage->operation;
    store32_le(storage->answer + 1, (uint32_t)STORAGE_NO_CARD);
    storage->size = STORAGE_HEAD_BYTES;
}

void storage_poll(kernel_t *k, robot_t *r) {
    storage_t *storage = &r->storage;
    uint8_t request[STORAGE_REQUEST_MAX];
    const size_t size =
        node_transmit(k, r, MCU_STM32, STM32_PORT_STORAGE, (bytes_mut_t){request, sizeof request});
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
            storage->function(storage->context, k->now_ns, request, size, storage->answer, &answered);
        storage->size = answered < sizeof storage->answer ? answered : sizeof storage->answer;
    }
    robot_at(k, r, SOURCE_STORAGE, k->now_ns + (duration_ns > 0 ? duration_ns : 0));
}

void storage_due(kernel_t *k, robot_t *r) {
    storage_t *storage = &r->storage;
    storage->busy = false;
    node_receive(k, r, MCU_STM32, STM32_PORT_STORAGE, (bytes_t){storage->answer, storage->size});
    node_poll(k, r, MCU_STM32);
}

void storage_off(kernel_t *k, robot_t *r) {
    storage_t *storage = &r->storage;
    robot_not(k, r, SOURCE_STORAGE);
    storage->busy = false;
    if (storage->function != NULL) {
        size_t answered = 0;
        storage->function(storage->context, k->now_ns, NULL, 0, storage->answer, &answered);
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
