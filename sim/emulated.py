"""Robots whose STM32 and GAP8 run the real images (backend=emulated): building them, and looking into them."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from host.native import ffi, lib
from host.protocol.errors import LocalError

from . import images, unicorn
from .settings import RobotSettings

MCUS = {"stm32": lib.MCU_STM32, "gap8": lib.MCU_GAP8}


def images_of(settings: RobotSettings, given: Mapping[str, str | Path]) -> dict[str, images.Image]:
    """What each emulated MCU of a robot runs: the given images, or with backend=emulated those of `toolchain`, built
    if they have not been. One LocalError that names all that is missing."""
    if given:
        loaded = {mcu: images.load(path) for mcu, path in given.items()}
        for mcu, image in loaded.items():
            if image.mcu != mcu:
                raise LocalError(f"{image.path} is an image for the {image.mcu}, not for the {mcu}")
        return loaded
    if settings.backend == "native":
        return {}
    toolchain = None if settings.toolchain == "auto" else settings.toolchain
    made: dict[str, images.Image] = {}
    missing: list[str] = []
    for mcu in MCUS:
        try:
            made[mcu] = images.built(mcu, toolchain)
        except LocalError as error:
            missing.append(str(error))
    try:
        unicorn.table()
    except LocalError as error:
        missing.append(str(error))
    if missing:
        raise LocalError("backend=emulated: " + "; ".join(dict.fromkeys(missing)))
    return made


def emulate(kernel: Any, robot: int, mcu: str, image: images.Image) -> None:
    """That MCU runs that image from its first boot on."""
    result = lib.kernel_emulate(kernel, robot, MCUS[mcu], unicorn.table(), image.pointer)
    if result == lib.KERNEL_ERR_MEMORY:
        raise MemoryError
    if result == lib.KERNEL_ERR_IMAGE:
        raise LocalError(f"{image.path} cannot be run: {str(ffi.string(lib.kernel_fault(kernel)), 'ascii')}")
    if result < 0:
        raise LocalError(f"{image.path}: the {mcu} cannot run images here")
    lib.kernel_set_threads(kernel, _cores())


def _cores() -> int:
    """That this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def fault(kernel: Any, of: Mapping[tuple[int, str], images.Image]) -> str:
    """Why a run has ended, with names for the addresses."""
    report = str(ffi.string(lib.kernel_fault(kernel)), "ascii")
    found = re.match(r"robot (\d+), (\w+),", report)
    image = of.get((int(found[1]), found[2])) if found else None
    return report if image is None else image.explain(report)


def stack_used(kernel: Any, robot: int, mcu: str, image: images.Image) -> int:
    """Bytes of the stack that have ever been written since the last boot: all from its top down to what still holds the
    pattern that RAM was filled with."""
    limit, top = (image.symbols[name][0] for name in ("_stack_limit", "_stack_top"))
    memory = lib.kernel_memory(kernel, robot, MCUS[mcu], limit, top - limit)
    if memory == ffi.NULL:
        return 0
    stack = bytes(ffi.buffer(memory, top - limit))
    return len(stack.lstrip(bytes([lib.EMULATOR_RAM_PATTERN])))


def counters(kernel: Any, robot: int, mcu: str, image: images.Image, names: list[str]) -> dict[str, int]:
    """The app's counters, read from the image's memory. 0 before the first boot, as of an app that has not run."""
    address, size = image.symbols["board_app"]
    memory = lib.kernel_memory(kernel, robot, MCUS[mcu], address, size)
    if memory == ffi.NULL:
        return dict.fromkeys(names, 0)
    app, members = bytes(ffi.buffer(memory, size)), image.members("board_app")
    absent = [name for name in names if name not in members]
    if absent:
        raise LocalError(f"{image.path} has no counter {', '.join(absent)}: it was built from other sources")
    return {name: members[name].of(app) for name in names}
