/// The registers of the STM32F405 that this board uses: addresses and bits as in ST's reference manual RM0090
/// (its section behind each name) and in Arm's ARMv7-M Architecture Reference Manual.
#ifndef SPINDECK_STM32_BOARD_REGISTERS_H
#define SPINDECK_STM32_BOARD_REGISTERS_H

#include <stdint.h>

typedef volatile uint32_t register_t;

/// 30.6, USART.
typedef struct {
    register_t sr, dr, brr, cr1, cr2, cr3;
} usart_t;

enum {
    USART_SR_FE = 1 << 1,
    USART_SR_ORE = 1 << 3,
    USART_SR_RXNE = 1 << 5,
    USART_SR_TC = 1 << 6, ///< 0 clears, 1 leaves it as it is; so do all bits of SR that can be written
    USART_CR1_RE = 1 << 2,
    USART_CR1_TE = 1 << 3,
    USART_CR1_RXNEIE = 1 << 5,
    USART_CR1_TCIE = 1 << 6,
    USART_CR1_UE = 1 << 13,
};

/// 18.4, TIM2 to TIM5. TIM2 and TIM5 count 32 bits, TIM3 counts 16.
typedef struct {
    register_t cr1, cr2, smcr, dier, sr, egr, ccmr1, ccmr2, ccer, cnt, psc, arr;
} timer_t;

enum {
    TIM_CR1_CEN = 1 << 0,
    TIM_CR1_URS = 1 << 2, ///< EGR_UG sets no UIF
    TIM_DIER_UIE = 1 << 0,
    TIM_SR_UIF = 1 << 0, ///< 0 clears, 1 leaves as it is; so do all bits of SR
    TIM_EGR_UG = 1 << 0, ///< CNT and the prescaler from 0, with the PSC written last
};

/// 7.3, RCC.
typedef struct {
    register_t cr, pllcfgr, cfgr, cir, ahb1rstr, ahb2rstr, ahb3rstr, reserved_1c, apb1rstr, apb2rstr,
        reserved_28, reserved_2c, ahb1enr, ahb2enr, ahb3enr, reserved_3c, apb1enr, apb2enr;
} rcc_t;

enum {
    RCC_CR_HSEON = 1 << 16,
    RCC_CR_HSERDY = 1 << 17,
    RCC_CR_PLLON = 1 << 24,
    RCC_CR_PLLRDY = 1 << 25,
    RCC_PLLCFGR_M = 0,
    RCC_PLLCFGR_N = 6,
    RCC_PLLCFGR_SRC_HSE = 1 << 22,
    RCC_PLLCFGR_Q = 24,
    RCC_CFGR_SW_PLL = 2,
    RCC_CFGR_PPRE1_4 = 5 << 10,
    RCC_CFGR_PPRE2_2 = 4 << 13,
    RCC_AHB1_GPIOA = 1 << 0,
    RCC_AHB1_GPIOC = 1 << 2,
    RCC_APB1_TIM2 = 1 << 0,
    RCC_APB1_TIM3 = 1 << 1,
    RCC_APB1_TIM5 = 1 << 3,
    RCC_APB1_USART2 = 1 << 17,
    RCC_APB1_USART3 = 1 << 18,
};

/// 3.9.2, FLASH_ACR.
enum { FLASH_ACR_5_WAIT_STATES = 5, FLASH_ACR_PREFETCH = 1 << 8, FLASH_ACR_CACHES = 3 << 9 };

/// 8.4, GPIO. Two bits a pin in moder and pupdr, four in afr.
typedef struct {
    register_t moder, otyper, ospeedr, pupdr, idr, odr, bsrr, lckr, afr[2];
} gpio_t;

enum { GPIO_ALTERNATE = 2, GPIO_PULL_UP = 1, GPIO_AF_USART1_TO_3 = 7 };

/// 12.3, EXTI.
typedef struct {
    register_t imr, emr, rtsr, ftsr, swier, pr; ///< pr: 1 clears
} exti_t;

enum { EXTI_LINE_0 = 1 << 0 };

/// No part of an STM32: the simulator's mailbox for a card, in the place of a driver and a file system. A
/// write to `size` begins the operation; its answer lies at `answer` when the interrupt comes, and a write to
/// `answered` acknowledges it.
typedef struct {
    register_t request, size; ///< where the request is, its bytes
    register_t answer, room;  ///< where its answer may go, and how much
    register_t answered;      ///< bytes of the answer
} storage_t;

/// Positions in the vector table behind the 16 of the core (12.2, table 61).
enum {
    IRQ_EXTI0 = 6,
    IRQ_TIM3 = 29,
    IRQ_USART2 = 38,
    IRQ_USART3 = 39,
    IRQ_STORAGE = 49, ///< the SDIO's, as its address
    IRQ_COUNT = 82,
};

#define TIM2 ((timer_t *)0x40000000U)
#define TIM3 ((timer_t *)0x40000400U)
#define TIM5 ((timer_t *)0x40000C00U)
#define USART2 ((usart_t *)0x40004400U)
#define USART3 ((usart_t *)0x40004800U)
#define STORAGE ((storage_t *)0x40012C00U)
#define EXTI ((exti_t *)0x40013C00U)
#define GPIOA ((gpio_t *)0x40020000U)
#define GPIOC ((gpio_t *)0x40020800U)
#define RCC ((rcc_t *)0x40023800U)
#define FLASH_ACR (*(register_t *)0x40023C00U)
#define NVIC_ISER ((register_t *)0xE000E100U)  ///< ARMv7-M, B3.4
#define NVIC_ISPR ((register_t *)0xE000E200U)  ///< B3.4
#define SCB_VTOR (*(register_t *)0xE000ED08U)  ///< B3.2
#define SCB_SCR (*(register_t *)0xE000ED10U)   ///< B3.2
#define SCB_CPACR (*(register_t *)0xE000ED88U) ///< B3.2
#define SCB_SCR_SLEEPONEXIT (1U << 1)          ///< behind the last handler the core sleeps again
#define SCB_CPACR_FPU (0xFU << 20)             ///< full access to coprocessors 10 and 11

#endif
