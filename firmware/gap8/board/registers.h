/// The registers of the GAP8 that this board uses. Addresses and bits as in GreenWaves' gap_sdk, the file
/// behind each name (rtos/pulp/gap_archi and rtos/pulp/archi_gap, include/archi), and in pulp-platform's RTL.
#ifndef SPINDECK_GAP8_BOARD_REGISTERS_H
#define SPINDECK_GAP8_BOARD_REGISTERS_H

#include <stdint.h>

typedef volatile uint32_t register_t;

/// udma/udma_v2.h: one direction of a peripheral's DMA. Writing cfg with UDMA_EN starts a transfer; `size`
/// then counts down what is left of it.
typedef struct {
    register_t address, size, cfg, reserved;
} udma_channel_t;

enum {
    UDMA_CONTINUOUS = 1 << 0, ///< at its end it begins anew, with the same address and size
    UDMA_EN = 1 << 4,         ///< reads as 1 while a transfer is under way
};

typedef struct {
    udma_channel_t rx, tx;
    register_t status, setup; ///< UART only
} udma_t;

/// chips/gap/properties.h: numbers of the uDMA's peripherals; 0x80 bytes each.
enum { UDMA_ID_SPIM1 = 2, UDMA_ID_UART = 4 };

#define UDMA_ADDRESS 0x1A102000U
#define SPIM1 ((udma_t *)(UDMA_ADDRESS + UDMA_ID_SPIM1 * 0x80U))
#define UART ((udma_t *)(UDMA_ADDRESS + UDMA_ID_UART * 0x80U))
#define UDMA_CLOCKS (*(register_t *)(UDMA_ADDRESS + 0x780U)) ///< a bit for each peripheral

/// udma/uart/udma_uart_v1.h.
enum {
    UART_SETUP_8_BITS = 3 << 1,
    UART_SETUP_TX = 1 << 8,
    UART_SETUP_RX = 1 << 9,
    UART_SETUP_DIVIDER_BIT = 16, ///< divider of the periphery's clock, less one
};

/// gpio/gpio_v2.h.
typedef struct {
    register_t direction, in, out, event_enable;
    register_t event_type[2]; ///< two bits for each pin
    register_t event_status;  ///< reading clears it
    register_t clock_enable;
} gpio_t;

#define GPIO ((gpio_t *)0x1A101000U)
enum { GPIO_EVENT_RISE = 1 };

/// chips/gap/apb_soc.h: two bits for each of 64 pads.
#define PAD_FUNCTIONS ((register_t *)0x1A104140U)

/// timer/timer_v2.h, and timer_unit.sv of pulp-platform: two counters of 32 bits, each with its prescaler.
/// One that is equal to its compare value gives an event.
typedef struct {
    register_t cfg_low, cfg_high;
    register_t value_low, value_high;
    register_t compare_low, compare_high;
    register_t start_low, start_high;
    register_t reset_low, reset_high; ///< writing 1 sets the counter and its prescaler to 0
} fc_timer_t;

#define FC_TIMER ((fc_timer_t *)0x00200400U)
enum {
    TIMER_ENABLE = 1 << 0,
    TIMER_EVENT = 1 << 2,
    TIMER_PRESCALER = 1 << 6,
    TIMER_REF_CLOCK = 1 << 7, ///< 32768 Hz
    TIMER_PRESCALER_BIT = 8,  ///< eight bits: divides by this plus one
};

/// eu/eu_v3.h: the fabric controller's event unit. A line whose bit is set in irq_mask interrupts while its
/// bit is set in `buffer`.
typedef struct {
    register_t mask, mask_and, mask_or;
    register_t irq_mask, irq_mask_and, irq_mask_or;
    register_t status, buffer, buffer_masked, buffer_irq_masked, buffer_clear;
} event_unit_t;

#define EVENT_UNIT ((event_unit_t *)0x00204000U)
#define SOC_EVENT_POP (*(register_t *)0x00200F00U) ///< takes the oldest of the SoC's events
enum { SOC_EVENT_VALID = 1 << 31, SOC_EVENT_NUMBER = 0xFF };

/// soc_eu/soc_eu_v1.h: a 0 passes the SoC's event on to the fabric controller. All are 1 after a reset.
#define SOC_EVENT_MASK_HIGH (*(register_t *)0x1A106004U) ///< events 32 to 63
#define SOC_EVENT_MASK_LOW (*(register_t *)0x1A106008U)

/// chips/gap/properties.h: the fabric controller's interrupt lines.
enum {
    IRQ_SOFTWARE_0 = 0,
    IRQ_TIMER_LOW = 10,
    IRQ_CAMERA = 20, ///< no line of the GAP8's: see CAMERA
    IRQ_SOC_EVENT = 27,
};

/// Likewise: the SoC's events.
enum {
    SOC_EVENT_SPIM1_RX = 4,
    SOC_EVENT_UART_RX = 8,
    SOC_EVENT_UART_TX = 9,
    SOC_EVENT_SPIM1_EOT = 23,
    SOC_EVENT_GPIO = 42,
};

/// The emulator's camera, in place of the HM01B0 on the parallel port. Nothing on the chip has these
/// registers.
typedef struct {
    register_t command[2]; ///< what gap8_transmit has handed out for GAP8_PORT_CAMERA
    register_t address;    ///< where the body goes
    register_t size;       ///< room there
    register_t start;      ///< writing 1 starts a capture; it ends with IRQ_CAMERA
    register_t length;     ///< of the body; 0: the capture has failed
    register_t taken;      ///< writing 1 ends the interrupt
} camera_t;

#define CAMERA ((camera_t *)0x1A170000U)

#endif
