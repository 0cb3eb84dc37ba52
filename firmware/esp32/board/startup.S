// ESP32 (Xtensa LX6), call0 ABI: register windows are off. No interrupt is used; an exception stops the CPU.
// Offsets of the vectors are the ESP32's (ESP-IDF, xtensa/config/core.h), not those of the compiler's own core.

    .section .vectors, "ax"
    .balign 1024
board_vectors:
    .org 0x300 // kernel mode
    j board_trap
    .org 0x340 // user mode
    j board_trap
    .org 0x3C0 // within an exception
    j board_trap
    .org 0x400

    .text
    .literal_position
    .align 4
    .globl board_trap
    .type board_trap, @function
board_trap:
    break 1, 15
1:  j 1b
    .size board_trap, . - board_trap

    .align 4
    .globl board_reset
    .type board_reset, @function
board_reset:
    movi a0, 0
    wsr a0, intenable
    movi a2, 0x20 // user mode, all levels of interrupts, no windows
    wsr a2, ps
    rsync
    movi a1, _stack_top
    movi a2, board_vectors
    wsr a2, vecbase
    movi a2, _bss_start
    movi a3, _bss_end
1:  bgeu a2, a3, 2f
    s32i a0, a2, 0
    addi a2, a2, 4
    j 1b
2:  movi a0, main
    callx0 a0
    j board_trap
    .size board_reset, . - board_reset
