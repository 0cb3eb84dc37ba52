#include "board.h"

static struct {
    uint8_t request[STORAGE_REQUEST_MAX];
    uint8_t answer[STORAGE_ANSWER_MAX];
} storage;

static bool is_there(void) {
    return board_config.storage != 0;
}

void storage_init(void) {
    if (is_there()) {
        STORAGE->answer = (uint32_t)storage.answer;
        STORAGE->room = sizeof storage.answer;
        interrupt_enable(IRQ_STORAGE);
    }
}

bytes_mut_t storage_room(void) {
    return (bytes_mut_t){storage.request, sizeof storage.request};
}

bytes_t storage_begin(size_t size) {
    if (is_there()) {
        memory_barrier();
        STORAGE->request = (uint32_t)storage.request;
        STORAGE->size = (uint32_t)size;
        memory_barrier();
        return (bytes_t){storage.answer, 0};
    }
    storage.answer[0] = storage.request[0];
    store32_le(storage.answer + 1, (uint32_t)STORAGE_NO_CARD);
    return (bytes_t){storage.answer, STORAGE_HEAD_BYTES};
}

bytes_t storage_news(void) {
    const size_t size = STORAGE->answered;
    STORAGE->answered = 0;
    return (bytes_t){storage.answer, size};
}
