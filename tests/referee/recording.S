    .section .rodata.recording, "a"
    .balign 4
    .globl recording
recording:
    .incbin RECORDING
