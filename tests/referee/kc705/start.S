// Xtensa, call0 ABI. The vectors' offsets are those of QEMU's core "lx106", from vecbase on.
    .section .vectors, "ax"
    .balign 256
vectors:
    .org 0x10
    j machine_trap
    .org 0x30
    j machine_trap
    .org 0x50
    j machine_trap
    .org 0x70
    j machine_trap
    .org 0x80

    .section .start, "ax"
    .literal_position
    .globl machine_start
machine_start:
    movi a0, 0
    wsr a0, intenable
    movi a1, _stack_top
    movi a2, vectors
    wsr a2, vecbase
    movi a2, _bss_start
    movi a3, _bss_end
1:  bgeu a2, a3, 2f
    s32i a0, a2, 0
    addi a2, a2, 4
    j 1b
2:  movi a2, 0x20 // user mode, all levels of interrupts, no register windows
    wsr a2, ps
    rsync
    movi a0, replay
    callx0 a0
3:  j 3b
