/// One MCU that runs a firmware image, byte for byte, under Unicorn: memory, CPU and peripherals.
///
/// The kernel calls it as it calls an app (docs/DESIGN.md, "Real images"). Code takes no time: whatever runs
/// in one call runs at the local time that the call gives. Interrupt handlers run at once; what they wake in
/// the main loop runs when the kernel next asks for bytes or for the deadline.
#ifndef SPINDECK_SIM_EMULATOR_H
#define SPINDECK_SIM_EMULATOR_H

#include "../../firmware/core/bytes.h"
#include "unicorn.h"

enum {
    EMULATOR_REPORT_BYTES = 1024,
    EMULATOR_RAM_PATTERN = 0xA5,    ///< in every byte that nobody has written since power-up
    EMULATOR_BLOCKS_MAX = 20000000, ///< basic blocks in one call; code that runs longer is taken to spin
};

typedef struct {
    uint32_t address;
    bool executable;
    bytes_t bytes;
} image_segment_t;

/// A linked firmware. Addresses are those of its symbols.
typedef struct {
    int mcu; ///< mcu_t
    const image_segment_t *segments;
    size_t segment_count;
    uint32_t entry;
    uint32_t board_config;
    uint32_t board_config_bytes;
    uint32_t board_stamp_reset; ///< u64: the stamp clock's new value
    uint32_t board_init_result; ///< int: what app_init returned
    uint32_t board_app;
    uint32_t board_app_bytes;
    uint32_t stack_top;
    uint32_t stack_limit;
} image_t;

/// What ended a run.
typedef struct {
    bool failed;
    char text[EMULATOR_REPORT_BYTES];
} emulator_report_t;

typedef struct emulator emulator_t;

bool emulator_models(int mcu);

/// NULL when out of memory. `api`, `image` with its bytes, and `report` must live as long. An image that does
/// not fit the MCU fails at once, in the report.
emulator_t *emulator_new(const unicorn_api_t *api, const image_t *image, int robot,
                         emulator_report_t *report);
void emulator_free(emulator_t *self);

/// Switches it on: RAM holds a pattern, `config` is written to the image's board_config, the CPU runs from
/// its reset until it sleeps. Returns board_init_result.
int emulator_power_up(emulator_t *self, bytes_t config, int64_t local_ns);

/// The four verbs' other three, and what the kernel has to know beside them. After a failure they do nothing.
int emulator_receive(emulator_t *self, int port, bytes_t in, int64_t local_ns);
size_t emulator_transmit(emulator_t *self, int port, bytes_mut_t out, int64_t local_ns);
uint64_t emulator_deadline(emulator_t *self, int64_t local_ns);

/// The transmission that `transmit` has begun on that port has ended: its interrupt, before any port is
/// asked. Without this call, asking the port says so.
void emulator_sent(emulator_t *self, int port, int64_t local_ns);

/// How long a byte takes that the other end of that UART sends: if it is not what the image's baud register
/// says, it is received with a framing error.
void emulator_set_wire(emulator_t *self, int port, int64_t byte_ps);

/// How long a byte takes on that port, from its baud register; 0 for a port that is no UART.
int64_t emulator_byte_ps(emulator_t *self, int port);

/// An SPI window begins for which this, its master, had nothing to say: the slave has.
void emulator_window(emulator_t *self, int64_t local_ns);

/// From the next power-up on, how many instructions have run since; slow.
void emulator_count(emulator_t *self);
uint64_t emulator_instructions(const emulator_t *self);

/// Something outside sets the stamp clock.
void emulator_reset_stamp(emulator_t *self, uint64_t to_us, int64_t local_ns);

/// Its memory, to look into; NULL if it is not one piece there.
const uint8_t *emulator_memory(const emulator_t *self, uint32_t address, size_t size);

size_t emulator_bytes(const emulator_t *self); ///< memory that it takes, Unicorn's own not counted

#endif
