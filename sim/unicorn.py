"""Unicorn, the CPU emulator, as the C of sim/emulator calls it: a table of addresses and constants.

Unicorn is GPL and this project is not: nothing of it is linked or copied. Where somebody has installed it, its
library is loaded by its own Python package, and this takes the functions' addresses from there at run time.
"""

from __future__ import annotations

import ctypes
import functools
from types import ModuleType
from typing import Any

from host.native import ffi, lib
from host.protocol.errors import LocalError

FUNCTIONS = {
    "open": "uc_open",
    "close": "uc_close",
    "control": "uc_ctl",
    "describe": "uc_strerror",
    "map_memory": "uc_mem_map_ptr",
    "map_device": "uc_mmio_map",
    "add_hook": "uc_hook_add",
    "read": "uc_reg_read",
    "write": "uc_reg_write",
    "read_batch": "uc_reg_read_batch",
    "write_batch": "uc_reg_write_batch",
    "start": "uc_emu_start",
    "stop": "uc_emu_stop",
}
REGISTER = "UNICORN_REG_"


def _write_control(constants: ModuleType, kind: int) -> int:
    """UC_CTL_WRITE(kind, 1) of unicorn.h."""
    return int(kind | 1 << 26 | constants.UC_CTL_IO_WRITE << 30)


@functools.cache
def table() -> Any:
    """unicorn_api_t *, of the installed package; LocalError if there is none."""
    try:
        from unicorn import arm_const, riscv_const, unicorn_const
        from unicorn.unicorn_py3.unicorn import uclib
    except ImportError as error:
        raise LocalError(
            f"running real images needs the CPU emulator Unicorn 2.1 or later, which is not here ({error}): "
            "pip install 'spindeck[emulator]'"
        ) from error
    api = ffi.new("unicorn_api_t *")
    for name, symbol in FUNCTIONS.items():
        address = ctypes.cast(getattr(uclib, symbol), ctypes.c_void_p).value
        setattr(api, name, ffi.cast(ffi.typeof(getattr(api, name)), address))
    const = unicorn_const
    values = {
        "arch_arm": const.UC_ARCH_ARM,
        "arch_riscv": const.UC_ARCH_RISCV,
        "mode_arm": const.UC_MODE_THUMB,
        "mode_riscv": const.UC_MODE_RISCV32,
        "control_cpu": _write_control(const, const.UC_CTL_CPU_MODEL),
        "control_page": _write_control(const, const.UC_CTL_UC_PAGE_SIZE),
        "cpu_arm": arm_const.UC_CPU_ARM_CORTEX_M4,
        "rights_read": const.UC_PROT_READ,
        "rights_write": const.UC_PROT_WRITE,
        "rights_execute": const.UC_PROT_EXEC,
        "control_tlb": _write_control(const, const.UC_CTL_TLB_TYPE),
        "hook_page": const.UC_HOOK_TLB_FILL,
        "access_fetch": const.UC_MEM_FETCH,
        "hook_interrupt": const.UC_HOOK_INTR,
        "hook_block": const.UC_HOOK_BLOCK,
        "hook_code": const.UC_HOOK_CODE,
        "hook_memory_invalid": const.UC_HOOK_MEM_INVALID,
        "error_instruction": const.UC_ERR_INSN_INVALID,
        "access_read_unmapped": const.UC_MEM_READ_UNMAPPED,
        "access_write_unmapped": const.UC_MEM_WRITE_UNMAPPED,
        "access_write_protected": const.UC_MEM_WRITE_PROT,
    }
    for name, value in values.items():
        setattr(api, name, value)
    for name in dir(lib):
        if name.startswith(REGISTER) and name != f"{REGISTER}COUNT":
            family, _, register = name.removeprefix(REGISTER).partition("_")
            module = {"ARM": arm_const, "RISCV": riscv_const}[family]
            api.registers[getattr(lib, name)] = getattr(module, f"UC_{family}_REG_{register}")
    return api
