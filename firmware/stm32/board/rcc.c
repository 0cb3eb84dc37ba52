#include "board.h"

enum {
    CRYSTAL_MHZ = 8,
    PLL_MHZ = 336, ///< halved to the core's 168
    PLL_Q = 7,     ///< 48 MHz, as its range asks; nothing uses it
    HSE_POLLS_MAX = 10000,
    PLL_POLLS_MAX = 2000,
};

/// A crystal that does not start leaves the board at the wrong speed rather than without a sign of life. It
/// also lets the image run where the RCC is not modelled and reads 0 (QEMU).
static void wait_for(uint32_t bit, int polls_max) {
    while (polls_max > 0 && (RCC->cr & bit) == 0) {
        polls_max--;
    }
}

void rcc_init(void) {
    RCC->cr |= RCC_CR_HSEON;
    wait_for(RCC_CR_HSERDY, HSE_POLLS_MAX);
    RCC->pllcfgr = CRYSTAL_MHZ << RCC_PLLCFGR_M | PLL_MHZ << RCC_PLLCFGR_N | RCC_PLLCFGR_SRC_HSE |
                   PLL_Q << RCC_PLLCFGR_Q;
    RCC->cr |= RCC_CR_PLLON;
    wait_for(RCC_CR_PLLRDY, PLL_POLLS_MAX);
    FLASH_ACR = FLASH_ACR_5_WAIT_STATES | FLASH_ACR_PREFETCH | FLASH_ACR_CACHES;
    // If the PLL is not ready by now, the switch comes when it is (RM0090, 7.2.6).
    RCC->cfgr = RCC_CFGR_PPRE1_4 | RCC_CFGR_PPRE2_2 | RCC_CFGR_SW_PLL;
    RCC->ahb1enr |= RCC_AHB1_GPIOA | RCC_AHB1_GPIOC;
    RCC->apb1enr |= RCC_APB1_TIM2 | RCC_APB1_TIM3 | RCC_APB1_TIM5 | RCC_APB1_USART2 | RCC_APB1_USART3;
    // Until they answer: ES0182, "Delay after an RCC peripheral clock enabling".
    __asm volatile("dsb" ::: "memory");
}
