/// Order between plain memory and the registers that hand it to a peripheral.
#ifndef SPINDECK_BOARD_BARRIER_H
#define SPINDECK_BOARD_BARRIER_H

/// A compiler may move plain loads and stores across those of registers, and where the files are one program
/// no call is in its way. Before the register that starts a transfer: what is to be sent has been written,
/// what is to be overwritten has been read. After it: what the peripheral now owns is not touched earlier.
static inline void memory_barrier(void) {
    __asm volatile("" ::: "memory");
}

#endif
