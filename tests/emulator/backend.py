"""What emulated robots need: tests name what is missing."""

from __future__ import annotations

import pytest

from host.firmware.targets import TARGETS
from host.firmware.toolchains import MissingError, find

EXTRA = "pip install 'spindeck[emulator]'"


def needs(*toolchains: str) -> None:
    """Skips the test without Unicorn, pyelftools, or those compilers (none named: any)."""
    pytest.importorskip("unicorn", reason=f"Unicorn is not installed: {EXTRA}")
    pytest.importorskip("elftools", reason=f"pyelftools is not installed: {EXTRA}")
    for toolchain in toolchains or (None,):
        for target in ("stm32", "gap8"):
            try:
                find(TARGETS[target], toolchain)
            except MissingError as error:
                pytest.skip(str(error))
