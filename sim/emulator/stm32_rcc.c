#include "stm32.h"

/// RM0090, 7.3. The Crazyflie's crystal has 8 MHz.
enum {
    CR = 0x00,
    CR_RESET = 0x83,
    CR_HSION = 1 << 0,
    CR_HSEON = 1 << 16,
    CR_PLLON = 1 << 24,
    CR_READY = 2, ///< of these three, in the bit above
    PLLCFGR = 0x04,
    PLLCFGR_RESET = 0x24003010,
    PLLCFGR_HSE = 1 << 22,
    CFGR = 0x08,
    CFGR_SWS_SHIFT = 2,
    SOURCE_HSI = 0,
    SOURCE_HSE = 1,
    SOURCE_PLL = 2,
    BDCR = 0x70,
    CSR = 0x74,
    LOW_SPEED_ON = 1, ///< of BDCR and CSR; ready in the bit above
    HSI_KHZ = 16000,
    HSE_KHZ = 8000,
    CORE_KHZ_MAX = 168000,
};

static uint32_t reg(const stm32_chip_t *chip, uint32_t offset) {
    return chip->rcc[offset / 4];
}

static uint32_t pll_khz(const stm32_chip_t *chip) {
    uint32_t value = reg(chip, PLLCFGR);
    uint32_t input_khz = (value & PLLCFGR_HSE) != 0 ? HSE_KHZ : HSI_KHZ;
    uint32_t m = value & 0x3F;
    uint32_t n = value >> 6 & 0x1FF;
    uint32_t p = ((value >> 16 & 3) + 1) * 2;
    return m < 2 ? 0 : input_khz / m * n / p;
}

static uint32_t source_khz(const stm32_chip_t *chip) {
    uint32_t on = reg(chip, CR);
    switch (reg(chip, CFGR) & 3) {
    case SOURCE_HSI:
        return (on & CR_HSION) != 0 ? HSI_KHZ : 0;
    case SOURCE_HSE:
        return (on & CR_HSEON) != 0 ? HSE_KHZ : 0;
    case SOURCE_PLL:
        return (on & CR_PLLON) != 0 ? pll_khz(chip) : 0;
    default:
        return 0;
    }
}

/// A prescaler field of three bits: below 4 it divides by 1, then by 2, 4, 8, 16.
static uint32_t divided(uint32_t khz, uint32_t field) {
    return field < 4 ? khz : khz >> (field - 3);
}

static void set_clocks(emulator_t *e) {
    stm32_chip_t *chip = stm32_chip(e);
    uint32_t cfgr = reg(chip, CFGR);
    uint32_t khz = source_khz(chip);
    if (khz == 0 || khz > CORE_KHZ_MAX) {
        emulator_fail(
            e, "the clock tree gives the core %u kHz (RCC_CR 0x%08x, RCC_PLLCFGR 0x%08x, RCC_CFGR 0x%08x)",
            khz, reg(chip, CR), reg(chip, PLLCFGR), cfgr);
        return;
    }
    uint32_t hpre = cfgr >> 4 & 0xF; // 8 to 15: 2, 4, 8, 16, 64, 128, 256, 512
    uint32_t core_khz = hpre < 8 ? khz : khz >> (hpre - 7 + (hpre > 11));
    uint32_t ppre1 = cfgr >> 10 & 7;
    uint32_t apb1_khz = divided(core_khz, ppre1);
    stm32_timers_settle(e); // so far they have counted at the old rate
    chip->alarm_ns = INT64_MIN;
    chip->clocks = (stm32_clocks_t){core_khz, apb1_khz, ppre1 < 4 ? apb1_khz : 2 * apb1_khz};
    cortex_m_set_clock(e, core_khz);
}

void stm32_rcc_reset(emulator_t *e) {
    stm32_chip_t *chip = stm32_chip(e);
    chip->rcc[CR / 4] = CR_RESET;
    chip->rcc[PLLCFGR / 4] = PLLCFGR_RESET;
    set_clocks(e);
}

uint32_t stm32_rcc_read(emulator_t *e, uint32_t offset) {
    uint32_t value = reg(stm32_chip(e), offset);
    switch (offset) {
    case CR: // what is on is ready
        return value | (value & (CR_HSION | CR_HSEON | CR_PLLON)) * CR_READY;
    case CFGR:
        return value | (value & 3) << CFGR_SWS_SHIFT;
    case BDCR:
    case CSR:
        return value | (value & LOW_SPEED_ON) << 1;
    default:
        return value;
    }
}

void stm32_rcc_write(emulator_t *e, uint32_t offset, uint32_t value) {
    stm32_chip(e)->rcc[offset / 4] = value;
    if (offset <= CFGR) {
        set_clocks(e);
    }
}
