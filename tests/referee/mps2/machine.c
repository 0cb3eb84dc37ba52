#include "../replay.h"

// QEMU's machine "mps2-an386" (hw/arm/mps2.c): a Cortex-M4F, memory at 0 and at 0x20000000, and the UART of
// ARM's CMSDK at 0x40004000.
typedef struct {
    uint32_t data;
    uint32_t state;
    uint32_t control;
    uint32_t interrupt;
    uint32_t divider;
} uart_t;

static volatile uart_t *const UART = (volatile uart_t *)0x40004000u;
static volatile uint32_t *const CPACR = (volatile uint32_t *)0xE000ED88u; ///< coprocessor access: the FPU
enum { TRANSMIT_FULL = 1, TRANSMIT_ENABLE = 1, DIVIDER_MIN = 16, FPU = 0xF << 20 };

extern uint32_t _stack_top[], _bss_start[], _bss_end[];
void machine_start(void);
void machine_trap(void);

__attribute__((section(".vectors"), used)) void (*const vectors[16])(void) = {
    (void (*)(void))_stack_top, machine_start, [2 ... 15] = machine_trap};

void machine_write(bytes_t out) {
    for (size_t i = 0; i < out.size; i++) {
        while ((UART->state & TRANSMIT_FULL) != 0) {}
        UART->data = out.data[i];
    }
}

/// An exception: nothing in the replay may cause one.
void machine_trap(void) {
    static const uint8_t text[] = "trap";
    machine_write((bytes_t){text, sizeof text});
    for (;;) {}
}

void machine_start(void) {
    *CPACR |= FPU;
    __asm volatile("dsb\n\tisb" ::: "memory");
    memset(_bss_start, 0, (size_t)((uint8_t *)_bss_end - (uint8_t *)_bss_start));
    UART->divider = DIVIDER_MIN;
    UART->control = TRANSMIT_ENABLE;
    replay();
    for (;;) {
        __asm volatile("wfi");
    }
}
