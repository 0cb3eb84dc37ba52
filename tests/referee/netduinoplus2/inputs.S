    .section .rodata.inputs, "a"
    .balign 4
    .globl inputs, inputs_end
inputs:
    .incbin INPUTS
inputs_end:
