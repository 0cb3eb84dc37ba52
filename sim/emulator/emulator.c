#include "emulator.h"

#include "machine.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PAGE_BYTES = 4096 };

void emulator_fail(emulator_t *e, const char *format, ...) {
    if (e->report->failed) {
        return;
    }
    e->report->failed = true;
    char *out = e->report->text;
    size_t room = sizeof e->report->text;
    int used = snprintf(out, room, "robot %d, %s, %.6f s after its start: ", e->robot, e->machine->name,
                        (double)e->now_ns * 1e-9);
    va_list arguments;
    va_start(arguments, format);
    used += vsnprintf(out + used, room - (size_t)used, format, arguments);
    va_end(arguments);
    if (e->engine != NULL) {
        e->api->stop(e->engine);
    }
}

void emulator_run(emulator_t *e, bool thread) {
    e->machine->cpu->run(e, thread);
    if (emulator_failed(e)) {
        char *out = e->report->text;
        size_t used = strlen(out);
        e->machine->cpu->describe(e, out + used, sizeof e->report->text - used);
    }
}

bool emulator_models(int mcu) {
    return machine_of(mcu) != NULL;
}

static uint8_t *at(const emulator_t *e, uint32_t address, size_t size, bool writable) {
    for (int i = 0; i < MACHINE_MEMORIES_MAX; i++) {
        const machine_memory_t *memory = &e->machine->memories[i];
        uint32_t offset = address - memory->address;
        if (offset < memory->bytes && size <= memory->bytes - offset) {
            return writable && !memory->writable ? NULL : e->memories[i] + offset;
        }
    }
    return NULL;
}

uint8_t *emulator_at(const emulator_t *e, uint32_t address, size_t size) {
    return at(e, address, size, false);
}

uint8_t *emulator_ram_at(const emulator_t *e, uint32_t address, size_t size) {
    return at(e, address, size, true);
}

const uint8_t *emulator_memory(const emulator_t *e, uint32_t address, size_t size) {
    return emulator_at(e, address, size);
}

// Flash has to be mapped by whole pages, and RAM from the host must not move.
static bool allocate(emulator_t *e) {
    e->cpu_state = calloc(1, e->machine->cpu->state_bytes);
    e->machine_state = calloc(1, e->machine->state_bytes);
    bool ok = e->cpu_state != NULL && e->machine_state != NULL;
    for (int i = 0; i < MACHINE_MEMORIES_MAX && e->machine->memories[i].bytes != 0; i++) {
        e->memories[i] = aligned_alloc(PAGE_BYTES, e->machine->memories[i].bytes);
        ok = ok && e->memories[i] != NULL;
    }
    return ok;
}

static void check_image(emulator_t *e) {
    const image_t *image = e->image;
    for (size_t i = 0; i < image->segment_count; i++) {
        const image_segment_t *segment = &image->segments[i];
        if (emulator_at(e, segment->address, segment->bytes.size) == NULL) {
            emulator_fail(e, "the image has %zu bytes at 0x%08x, where there is no memory",
                          segment->bytes.size, segment->address);
        }
    }
    const uint32_t symbols[][2] = {{image->board_config, image->board_config_bytes},
                                   {image->board_stamp_reset, sizeof(uint64_t)},
                                   {image->board_init_result, sizeof(uint32_t)},
                                   {image->board_app, image->board_app_bytes}};
    for (size_t i = 0; i < sizeof symbols / sizeof symbols[0]; i++) {
        if (emulator_at(e, symbols[i][0], symbols[i][1]) == NULL) {
            emulator_fail(e, "a symbol of the image is at 0x%08x, where there is no memory", symbols[i][0]);
        }
    }
}

emulator_t *emulator_new(const unicorn_api_t *api, const image_t *image, int robot,
                         emulator_report_t *report) {
    emulator_t *e = calloc(1, sizeof *e);
    if (e == NULL) {
        return NULL;
    }
    *e = (emulator_t){
        .api = api, .image = image, .machine = machine_of(image->mcu), .robot = robot, .report = report};
    if (!allocate(e)) {
        emulator_free(e);
        return NULL;
    }
    check_image(e);
    return e;
}

static void power_off(emulator_t *e) {
    if (e->engine != NULL) {
        e->api->close(e->engine);
        e->engine = NULL;
    }
}

void emulator_free(emulator_t *e) {
    if (e == NULL) {
        return;
    }
    power_off(e);
    for (int i = 0; i < MACHINE_MEMORIES_MAX; i++) {
        free(e->memories[i]);
    }
    free(e->cpu_state);
    free(e->machine_state);
    free(e);
}

static uint64_t device_read(emulator_t *e, uint32_t address, unsigned size) {
    return emulator_failed(e) ? 0 : e->machine->read(e, address, size);
}

static void device_write(emulator_t *e, uint32_t address, unsigned size, uint64_t value) {
    if (!emulator_failed(e)) {
        e->machine->write(e, address, size, (uint32_t)value);
    }
}

// Unicorn tells the offset in the range: one pair of functions for each.
#define DEVICE(index)                                                                                        \
    static uint64_t read_##index(unicorn_t *engine, uint64_t offset, unsigned size, void *user) {            \
        emulator_t *e = user;                                                                                \
        (void)engine;                                                                                        \
        return device_read(e, e->machine->devices[index].address + (uint32_t)offset, size);                  \
    }                                                                                                        \
    static void write_##index(unicorn_t *engine, uint64_t offset, unsigned size, uint64_t value,             \
                              void *user) {                                                                  \
        emulator_t *e = user;                                                                                \
        (void)engine;                                                                                        \
        device_write(e, e->machine->devices[index].address + (uint32_t)offset, size, value);                 \
    }

DEVICE(0)
DEVICE(1)
DEVICE(2)
DEVICE(3)

static bool holds_code(const emulator_t *e, uint32_t page) {
    bool code = false;
    for (size_t i = 0; i < e->image->segment_count; i++) {
        const image_segment_t *segment = &e->image->segments[i];
        code = code || (segment->executable && segment->address < page + PAGE_BYTES &&
                        page < segment->address + segment->bytes.size);
    }
    return code;
}

// Where code may be executed, every store is looked at, in case that it changes code: so RAM without code is
// four times as fast. What else is forbidden is told by map.
static bool on_page(unicorn_t *engine, uint64_t address, int type, unicorn_page_t *page, void *user) {
    emulator_t *e = user;
    const unicorn_api_t *api = e->api;
    uint32_t at = (uint32_t)address & ~(uint32_t)(PAGE_BYTES - 1);
    (void)engine;
    if (type != api->access_fetch && e->machine->cpu->looked_up != NULL) {
        e->machine->cpu->looked_up(e);
    }
    page->address = address;
    bool code = emulator_ram_at(e, at, 1) == NULL || holds_code(e, at);
    page->rights = api->rights_read | api->rights_write | (code ? api->rights_execute : 0);
    return true;
}

static bool map(emulator_t *e) {
    static uint64_t (*const READ[])(unicorn_t *, uint64_t, unsigned, void *) = {read_0, read_1, read_2,
                                                                                read_3};
    static void (*const WRITE[])(unicorn_t *, uint64_t, unsigned, uint64_t, void *) = {write_0, write_1,
                                                                                       write_2, write_3};
    const unicorn_api_t *api = e->api;
    int error = 0;
    for (int i = 0; i < MACHINE_MEMORIES_MAX && e->memories[i] != NULL && error == 0; i++) {
        const machine_memory_t *memory = &e->machine->memories[i];
        int rights = api->rights_read | api->rights_execute | (memory->writable ? api->rights_write : 0);
        error = api->map_memory(e->engine, memory->address, memory->bytes, (uint32_t)rights, e->memories[i]);
    }
    for (int i = 0; i < MACHINE_DEVICES_MAX && e->machine->devices[i].bytes != 0 && error == 0; i++) {
        const machine_devices_t *devices = &e->machine->devices[i];
        error = api->map_device(e->engine, devices->address, devices->bytes, READ[i], e, WRITE[i], e);
    }
    size_t hook;
    if (error == 0) {
        error = api->control(e->engine, api->control_tlb, 1);
    }
    if (error == 0) {
        error = api->add_hook(e->engine, &hook, api->hook_page, (void *)on_page, e, 1, 0);
    }
    if (error != 0) {
        emulator_fail(e, "Unicorn cannot map its memory: %s", api->describe(error));
    }
    return error == 0;
}

static void load(emulator_t *e, bytes_t config) {
    const image_t *image = e->image;
    for (int i = 0; i < MACHINE_MEMORIES_MAX && e->memories[i] != NULL; i++) {
        const machine_memory_t *memory = &e->machine->memories[i];
        memset(e->memories[i], memory->writable ? EMULATOR_RAM_PATTERN : 0xFF, memory->bytes);
    }
    for (size_t i = 0; i < image->segment_count; i++) {
        const bytes_t bytes = image->segments[i].bytes;
        if (bytes.size != 0) {
            memcpy(emulator_at(e, image->segments[i].address, bytes.size), bytes.data, bytes.size);
        }
    }
    if (config.size != image->board_config_bytes) {
        emulator_fail(e, "the image's board_config has %u bytes, this simulator's %zu: build it anew",
                      image->board_config_bytes, config.size);
        return;
    }
    memcpy(emulator_at(e, image->board_config, config.size), config.data, config.size);
}

static void on_instruction(unicorn_t *engine, uint64_t address, uint32_t size, void *user) {
    (void)engine;
    (void)address;
    (void)size;
    ((emulator_t *)user)->instructions++;
}

static bool count_instructions(emulator_t *e) {
    size_t hook;
    e->instructions = 0;
    int error = !e->counting
                    ? 0
                    : e->api->add_hook(e->engine, &hook, e->api->hook_code, (void *)on_instruction, e, 1, 0);
    if (error != 0) {
        emulator_fail(e, "Unicorn cannot count instructions: %s", e->api->describe(error));
    }
    return error == 0;
}

int emulator_power_up(emulator_t *e, bytes_t config, int64_t local_ns) {
    if (emulator_failed(e)) {
        return 0;
    }
    power_off(e); // a new engine: nothing of the last run is left in it
    e->now_ns = local_ns;
    e->blocks_left = EMULATOR_BLOCKS_MAX;
    load(e, config);
    if (emulator_failed(e) || !e->machine->cpu->open(e) || !map(e) || !count_instructions(e)) {
        return 0;
    }
    memset(e->machine_state, 0, e->machine->state_bytes);
    e->machine->cpu->reset(e);
    e->machine->reset(e);
    emulator_run(e, true);
    return (int)load32_le(emulator_at(e, e->image->board_init_result, 4));
}

// Every call begins with what is due by now.
static bool enter(emulator_t *e, int64_t local_ns) {
    if (emulator_failed(e)) {
        return false;
    }
    e->now_ns = local_ns;
    e->blocks_left = EMULATOR_BLOCKS_MAX;
    if (e->machine->alarm_ns(e) <= local_ns) {
        e->machine->alarm(e);
        emulator_run(e, false);
    }
    return !emulator_failed(e);
}

int emulator_receive(emulator_t *e, int port, bytes_t in, int64_t local_ns) {
    if (enter(e, local_ns)) {
        e->machine->receive(e, port, in);
    }
    return (int)in.size;
}

size_t emulator_transmit(emulator_t *e, int port, bytes_mut_t out, int64_t local_ns) {
    if (!enter(e, local_ns)) {
        return 0;
    }
    e->machine->asked(e, port);
    emulator_run(e, true);
    return emulator_failed(e) ? 0 : e->machine->take(e, port, out);
}

void emulator_sent(emulator_t *e, int port, int64_t local_ns) {
    if (enter(e, local_ns)) {
        e->machine->asked(e, port);
        emulator_run(e, false);
    }
}

uint64_t emulator_deadline(emulator_t *e, int64_t local_ns) {
    if (!enter(e, local_ns)) {
        return NEVER_US;
    }
    emulator_run(e, true);
    int64_t alarm_ns = emulator_failed(e) ? INT64_MAX : e->machine->alarm_ns(e);
    return alarm_ns == INT64_MAX ? NEVER_US : (uint64_t)alarm_ns / 1000 + (alarm_ns % 1000 != 0);
}

void emulator_count(emulator_t *e) {
    e->counting = true;
}

uint64_t emulator_instructions(const emulator_t *e) {
    return e->instructions;
}

void emulator_set_wire(emulator_t *e, int port, int64_t byte_ps) {
    e->wire_byte_ps[port] = byte_ps;
}

int64_t emulator_byte_ps(emulator_t *e, int port) {
    return e->machine->byte_ps(e, port);
}

void emulator_window(emulator_t *e, int64_t local_ns) {
    if (enter(e, local_ns)) {
        e->machine->window(e);
    }
}

void emulator_reset_stamp(emulator_t *e, uint64_t to_us, int64_t local_ns) {
    if (enter(e, local_ns)) {
        store64_le(emulator_at(e, e->image->board_stamp_reset, 8), to_us);
        e->machine->reset_stamp(e);
        emulator_run(e, false);
    }
}

size_t emulator_bytes(const emulator_t *e) {
    size_t bytes = sizeof *e + e->machine->cpu->state_bytes + e->machine->state_bytes;
    for (int i = 0; i < MACHINE_MEMORIES_MAX; i++) {
        bytes += e->machine->memories[i].bytes;
    }
    return bytes;
}
