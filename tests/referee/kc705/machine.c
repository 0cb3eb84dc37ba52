#include "../replay.h"

// QEMU's machine "kc705-nommu" (hw/xtensa/xtfpga.c): a 16550 whose registers are four bytes apart.
static volatile uint32_t *const UART = (volatile uint32_t *)0x9D050020u;
enum { TRANSMIT = 0, LINE_STATUS = 5, TRANSMIT_EMPTY = 0x20 };

void machine_write(bytes_t out) {
    for (size_t i = 0; i < out.size; i++) {
        while ((UART[LINE_STATUS] & TRANSMIT_EMPTY) == 0) {}
        UART[TRANSMIT] = out.data[i];
    }
}

void machine_trap(void);
void machine_trap(void) {
    static const uint8_t text[] = "trap";
    machine_write((bytes_t){text, sizeof text});
    for (;;) {}
}
