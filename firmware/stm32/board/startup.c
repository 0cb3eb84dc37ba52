#include "board.h"

extern uint32_t _stack_top[];
extern uint32_t _data_start[], _data_end[], _data_image[], _bss_start[], _bss_end[];

typedef void (*vector_t)(void);

enum { CORE_VECTORS = 16, STACK = 0, RESET = 1 };

__attribute__((naked)) void board_trap(void) {
    __asm volatile("bkpt #0\n\tb .");
}

// Every entry that this board has no handler for is a trap; those that are reserved are never fetched.
__attribute__((section(".vectors"), used)) const vector_t vectors[CORE_VECTORS + IRQ_COUNT] = {
    [STACK] = (vector_t)_stack_top,
    [RESET] = board_reset,
    [2 ... CORE_VECTORS + IRQ_EXTI0 - 1] = board_trap,
    [CORE_VECTORS + IRQ_EXTI0] = exti0_handler,
    [CORE_VECTORS + IRQ_EXTI0 + 1 ... CORE_VECTORS + IRQ_TIM3 - 1] = board_trap,
    [CORE_VECTORS + IRQ_TIM3] = tim3_handler,
    [CORE_VECTORS + IRQ_TIM3 + 1 ... CORE_VECTORS + IRQ_USART2 - 1] = board_trap,
    [CORE_VECTORS + IRQ_USART2] = usart2_handler,
    [CORE_VECTORS + IRQ_USART3] = usart3_handler,
    [CORE_VECTORS + IRQ_USART3 + 1 ... CORE_VECTORS + IRQ_STORAGE - 1] = board_trap,
    [CORE_VECTORS + IRQ_STORAGE] = storage_handler,
    [CORE_VECTORS + IRQ_STORAGE + 1 ... CORE_VECTORS + IRQ_COUNT - 1] = board_trap,
};

void board_reset(void) {
    SCB_CPACR |= SCB_CPACR_FPU;
    __asm volatile("dsb\n\tisb" ::: "memory"); // from here on the FPU may be used
    SCB_VTOR = (uint32_t)vectors;
    memcpy(_data_start, _data_image, (size_t)((uint8_t *)_data_end - (uint8_t *)_data_start));
    memset(_bss_start, 0, (size_t)((uint8_t *)_bss_end - (uint8_t *)_bss_start));
    main();
    board_trap();
}
