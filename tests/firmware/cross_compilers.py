"""Which compilers of firmware images this machine has: tests name what is missing."""

import pytest

from host.firmware.targets import TARGETS
from host.firmware.toolchains import MissingError, find

PAIRS = [("stm32", "gcc"), ("stm32", "zig"), ("gap8", "gcc"), ("gap8", "zig"), ("esp32", "gcc")]


def needs(target: str, toolchain: str) -> None:
    """Skips the test without that compiler or pyelftools, which reads what it makes."""
    pytest.importorskip("elftools", reason="pyelftools is not installed")
    try:
        find(TARGETS[target], toolchain)
    except MissingError as error:
        pytest.skip(str(error))
