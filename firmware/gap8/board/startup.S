// The GAP8's fabric controller starts 0x80 bytes into L2, where the boot ROM has put the image; interrupt n goes
// to the n-th word before that, an illegal instruction and a call to the two behind it (gap_sdk, crt0.S).

    .section .vectors, "ax"
    .option push
    .option norvc
    .globl board_vectors
board_vectors:
    j software_handler // IRQ_SOFTWARE_0
    .rept 9
    j board_trap
    .endr
    j timer_handler // IRQ_TIMER_LOW
    .rept 9
    j board_trap
    .endr
    j camera_handler // IRQ_CAMERA
    .rept 6
    j board_trap
    .endr
    j soc_event_handler // IRQ_SOC_EVENT
    .rept 4
    j board_trap
    .endr

    .org 0x80
    j board_reset
    j board_trap // illegal instruction
    j board_trap // environment call
    j board_trap // load or store
    .option pop

    .text
    .globl board_trap
board_trap:
    ebreak
    j board_trap

    .globl board_reset
board_reset:
    .option push
    .option norelax
    la gp, __global_pointer$
    .option pop
    la sp, _stack_top
    la t0, board_vectors
    csrw mtvec, t0
    la t0, _bss_start
    la t1, _bss_end
1:  bgeu t0, t1, 2f
    sw zero, 0(t0)
    addi t0, t0, 4
    j 1b
2:  call main
    j board_trap
