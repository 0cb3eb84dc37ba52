#include "machine.h"

static bool on_bad_access(unicorn_t *engine, int type, uint64_t address, int size, int64_t value,
                          void *user) {
    (void)engine;
    (void)value;
    ((emulator_t *)user)->refused = (refused_t){type, (uint32_t)address, size};
    return false;
}

// A hook for bad accesses would make all stores slow: so the one that has failed is done again, with a hook.
void emulator_fail_on_access(emulator_t *e, uint64_t pc, uint64_t until, int error, const char *read_only) {
    const unicorn_api_t *api = e->api;
    const refused_t *access = &e->refused;
    size_t hook;
    e->refused.type = -1;
    api->add_hook(e->engine, &hook, api->hook_memory_invalid, (void *)on_bad_access, e, 1, 0);
    api->start(e->engine, pc, until, 0, 0);
    if (access->type == api->access_write_protected) {
        emulator_fail(e, "write to %s: %d bytes at 0x%08x", read_only, access->bytes, access->address);
    } else if (access->type == api->access_write_unmapped) {
        emulator_fail(e, "write where nothing is: %d bytes at 0x%08x", access->bytes, access->address);
    } else if (access->type == api->access_read_unmapped) {
        emulator_fail(e, "read where nothing is: %d bytes at 0x%08x", access->bytes, access->address);
    } else {
        emulator_fail(e, "%s", api->describe(error));
    }
}
