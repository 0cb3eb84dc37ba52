#include "../replay.h"

// QEMU's machine "virt" (hw/riscv/virt.c): a 16550 at 0x10000000.
static volatile uint8_t *const UART = (volatile uint8_t *)0x10000000u;
enum { TRANSMIT = 0, LINE_STATUS = 5, TRANSMIT_EMPTY = 0x20 };

void machine_write(bytes_t out) {
    for (size_t i = 0; i < out.size; i++) {
        while ((UART[LINE_STATUS] & TRANSMIT_EMPTY) == 0) {}
        UART[TRANSMIT] = out.data[i];
    }
}

/// An exception: nothing in the replay may cause one.
__attribute__((aligned(4))) void machine_trap(void);
void machine_trap(void) {
    static const uint8_t text[] = "trap";
    machine_write((bytes_t){text, sizeof text});
    for (;;) {}
}
