/// The functions and constants of an installed Unicorn (the CPU emulator, GPL), as sim/unicorn.py fills them
/// in at run time. Nothing of it is linked or included here. Names and meanings are those of Unicorn 2.1's
/// API.
#ifndef SPINDECK_SIM_UNICORN_H
#define SPINDECK_SIM_UNICORN_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

typedef struct unicorn unicorn_t; ///< uc_engine

/// Registers by their place in unicorn_api_t.registers, named UNICORN_REG_ and then as in UC_ARM_REG_ or
/// UC_RISCV_REG_: Python finds their numbers by these names.
typedef enum {
    UNICORN_REG_ARM_R0,
    UNICORN_REG_ARM_R1,
    UNICORN_REG_ARM_R2,
    UNICORN_REG_ARM_R3,
    UNICORN_REG_ARM_R4,
    UNICORN_REG_ARM_R5,
    UNICORN_REG_ARM_R6,
    UNICORN_REG_ARM_R7,
    UNICORN_REG_ARM_R8,
    UNICORN_REG_ARM_R9,
    UNICORN_REG_ARM_R10,
    UNICORN_REG_ARM_R11,
    UNICORN_REG_ARM_R12,
    UNICORN_REG_ARM_SP,
    UNICORN_REG_ARM_LR,
    UNICORN_REG_ARM_PC,
    UNICORN_REG_ARM_XPSR,
    UNICORN_REG_ARM_XPSR_NZCVQG, ///< the same, to be written
    UNICORN_REG_ARM_EPSR,
    UNICORN_REG_ARM_CONTROL,
    UNICORN_REG_ARM_MSP,
    UNICORN_REG_ARM_PSP,
    UNICORN_REG_ARM_PRIMASK,
    UNICORN_REG_ARM_BASEPRI,
    UNICORN_REG_ARM_FAULTMASK,
    UNICORN_REG_ARM_FPSCR,
    UNICORN_REG_ARM_D0,   ///< the 7 others have the next numbers of Unicorn's
    UNICORN_REG_RISCV_X0, ///< so do the 31 others
    UNICORN_REG_RISCV_PC,
    UNICORN_REG_RISCV_MSTATUS,
    UNICORN_REG_RISCV_MIE,
    UNICORN_REG_RISCV_MIP,
    UNICORN_REG_RISCV_MTVEC,
    UNICORN_REG_RISCV_MEPC,
    UNICORN_REG_RISCV_MCAUSE,
    UNICORN_REG_RISCV_PRIV,
    UNICORN_REG_COUNT,
} unicorn_reg_t;

/// uc_tlb_entry: what a page of addresses stands for.
typedef struct {
    uint64_t address;
    int rights;
} unicorn_page_t;

/// Every function returns 0 or an error that `describe` explains.
typedef struct {
    int (*open)(int arch, int mode, unicorn_t **engine);
    int (*close)(unicorn_t *engine);
    int (*control)(unicorn_t *engine, int control, ...);
    const char *(*describe)(int error);
    int (*map_memory)(unicorn_t *engine, uint64_t address, uint64_t size, uint32_t rights, void *memory);
    int (*map_device)(unicorn_t *engine, uint64_t address, size_t size,
                      uint64_t (*read)(unicorn_t *, uint64_t offset, unsigned size, void *user),
                      void *read_user,
                      void (*write)(unicorn_t *, uint64_t offset, unsigned size, uint64_t value, void *user),
                      void *write_user);
    int (*add_hook)(unicorn_t *engine, size_t *hook, int type, void *callback, void *user, uint64_t begin,
                    uint64_t end, ...);
    int (*read)(unicorn_t *engine, int reg, void *value);
    int (*write)(unicorn_t *engine, int reg, const void *value);
    int (*read_batch)(unicorn_t *engine, const int *regs, void *const *values, int count);
    int (*write_batch)(unicorn_t *engine, const int *regs, void *const *values, int count);
    int (*start)(unicorn_t *engine, uint64_t begin, uint64_t until, uint64_t timeout_us, size_t instructions);
    int (*stop)(unicorn_t *engine);
    int arch_arm;
    int arch_riscv;
    int mode_arm;     ///< Thumb, M profile
    int mode_riscv;   ///< 32 bit
    int control_cpu;  ///< sets the CPU model
    int control_page; ///< sets the size of an Arm's pages
    int cpu_arm;      ///< Cortex-M4
    int rights_read;
    int rights_write;
    int rights_execute;
    int control_tlb; ///< sets where pages are looked up: 1, in hook_page
    int hook_page;   ///< its callback's third argument is the access:
    int access_fetch;
    int hook_interrupt;
    int hook_block;
    int hook_code;           ///< each instruction
    int error_instruction;   ///< what start returns for an undefined one
    int hook_memory_invalid; ///< its callback's second argument is the access that failed:
    int access_read_unmapped;
    int access_write_unmapped;
    int access_write_protected;
    int registers[64]; ///< by unicorn_reg_t
} unicorn_api_t;

_Static_assert(UNICORN_REG_COUNT <= 64, "unicorn_api_t.registers is too short");

#endif
