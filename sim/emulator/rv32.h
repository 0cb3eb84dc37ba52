/// The CPU of the GAP8's fabric controller: RV32IMC in machine mode, with interrupts as RI5CY takes them.
///
/// Line n enters at mtvec + 4 n, with mcause and mstatus.MIE set; mret leads back. What is not modelled: the
/// Xpulp extension, cycles, and the rest of mstatus. In a handler mepc is RV32_ROM, wherever it will return
/// to.
///
/// A sleeping CPU takes an interrupt at once, even where mstatus says that it is to wait: it would wake, and
/// take it as soon as it may. So the main program has to come to that without doing anything else first.
#ifndef SPINDECK_SIM_RV32_H
#define SPINDECK_SIM_RV32_H

#include "machine.h"

extern const cpu_t rv32_cpu;

/// Where the chip has its boot ROM, the CPU has a word of its own; a machine gives it this memory.
enum { RV32_ROM = 0x1A000000, RV32_ROM_BYTES = 0x1000 };

/// The lines that are up.
void rv32_lines(emulator_t *e, uint32_t lines);

#endif
