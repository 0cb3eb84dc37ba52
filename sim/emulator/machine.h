/// Private to sim/emulator: what an MCU is made of, and the parts that all of them share.
///
/// A machine is a memory map and peripherals; a CPU is what runs the code and takes the interrupts. A machine
/// knows its CPU and calls its interrupt controller directly.
#ifndef SPINDECK_SIM_MACHINE_H
#define SPINDECK_SIM_MACHINE_H

#include "emulator.h"

enum { MACHINE_MEMORIES_MAX = 3, MACHINE_DEVICES_MAX = 4, MACHINE_PORTS_MAX = 4 };

typedef struct {
    uint32_t address;
    uint32_t bytes; ///< a multiple of 4096
    bool writable;
} machine_memory_t;

/// Addresses at which reads and writes go to the machine.
typedef struct {
    uint32_t address;
    uint32_t bytes; ///< a multiple of 4096
} machine_devices_t;

typedef struct {
    size_t state_bytes; ///< of its own state, emulator_t.cpu_state
    /// Opens e->engine and adds hooks; false after emulator_fail.
    bool (*open)(emulator_t *e);
    void (*reset)(emulator_t *e);
    /// Runs every handler that can be taken, and if `thread` the main program until it sleeps.
    void (*run)(emulator_t *e, bool thread);
    /// Data of another page have been looked up, in the middle of a block; NULL: there is nothing to be
    /// mended.
    void (*looked_up)(emulator_t *e);
    /// Writes "; pc=0x... ...".
    void (*describe)(emulator_t *e, char *out, size_t size);
} cpu_t;

typedef struct {
    const char *name;
    const cpu_t *cpu;
    machine_memory_t memories[MACHINE_MEMORIES_MAX];
    machine_devices_t devices[MACHINE_DEVICES_MAX];
    size_t state_bytes; ///< of its own state, emulator_t.machine_state; zeroed before reset
    void (*reset)(emulator_t *e);
    uint32_t (*read)(emulator_t *e, uint32_t address, unsigned size);
    void (*write)(emulator_t *e, uint32_t address, unsigned size, uint32_t value);
    /// Has to run the handlers too (emulator_run): bytes come one after the other.
    void (*receive)(emulator_t *e, int port, bytes_t in);
    /// The kernel asks this port for bytes: if its transmitter is busy with bytes that `take` has handed out,
    /// they have left.
    void (*asked)(emulator_t *e, int port);
    /// What the code has written to this port since.
    size_t (*take)(emulator_t *e, int port, bytes_mut_t out);
    /// Local time of the next timer's interrupt, INT64_MAX for none; and raising what is due by e->now_ns.
    int64_t (*alarm_ns)(emulator_t *e);
    void (*alarm)(emulator_t *e);
    int64_t (*byte_ps)(emulator_t *e, int port);
    /// emulator_window; has to run the code too.
    void (*window)(emulator_t *e);
    /// The new value is in board_stamp_reset.
    void (*reset_stamp)(emulator_t *e);
} machine_t;

/// An access to memory that Unicorn has refused.
typedef struct {
    int type; ///< as Unicorn names it, or -1
    uint32_t address;
    int bytes;
} refused_t;

struct emulator {
    const unicorn_api_t *api;
    const image_t *image;
    const machine_t *machine;
    int robot;
    emulator_report_t *report;
    unicorn_t *engine; ///< NULL until it is first switched on
    void *cpu_state;
    void *machine_state;
    uint8_t *memories[MACHINE_MEMORIES_MAX];
    int64_t now_ns; ///< local
    uint32_t blocks_left;
    refused_t refused;
    bool counting;
    uint64_t instructions;
    int64_t wire_byte_ps[MACHINE_PORTS_MAX]; ///< how fast the other end of a UART sends
};

/// By mcu_t; NULL if there is no model of it.
const machine_t *machine_of(int mcu);

/// Ends the run; the CPU's registers are added when it has stopped. Only the first failure of a robot is
/// kept.
__attribute__((format(printf, 2, 3))) void emulator_fail(emulator_t *e, const char *format, ...);

static inline bool emulator_failed(const emulator_t *e) {
    return e->report->failed;
}

/// Unicorn has refused an access with `error`: it is done again, from `pc`, to say what it was. `read_only`
/// is what memory is called that code cannot write.
void emulator_fail_on_access(emulator_t *e, uint64_t pc, uint64_t until, int error, const char *read_only);

/// At the start of every basic block: false, and the end of the run, when there have been too many.
static inline bool emulator_may_go_on(emulator_t *e) {
    if (e->blocks_left == 0) {
        emulator_fail(e, "the code has run %d blocks without going to sleep", EMULATOR_BLOCKS_MAX);
        return false;
    }
    e->blocks_left--;
    return true;
}

/// cpu->run; after each call emulator_failed is to be checked.
void emulator_run(emulator_t *e, bool thread);

/// Host memory of `size` bytes at an address; NULL if it is not one piece there.
uint8_t *emulator_at(const emulator_t *e, uint32_t address, size_t size);
/// Likewise, of memory that code can write.
uint8_t *emulator_ram_at(const emulator_t *e, uint32_t address, size_t size);

#endif
