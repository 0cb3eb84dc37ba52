"""--row: of which row of a picture the time is wanted."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..protocol.errors import LocalError

if TYPE_CHECKING:
    from ..link.frame import Frame

NAMED = {"first": 0.0, "middle": 0.5, "last": 1.0}
"""As a part of the picture's height."""


@dataclass(frozen=True, slots=True)
class Row:
    name: str

    def of(self, height: int) -> float:
        """Its number; LocalError when a picture of that height has no such row."""
        if self.name in NAMED:
            return NAMED[self.name] * (height - 1)
        if int(self.name) >= height:
            raise LocalError(f"--row {self.name}: the pictures have {height} rows, counted from 0")
        return float(self.name)

    def stm32_us(self, frame: Frame) -> float | None:
        """Middle of its exposure; None when the frame does not tell."""
        time_us = frame.row_stm32_us(self.of(frame.height))
        return None if time_us is None else round(time_us, 1)


def row(text: str) -> Row:
    """For argparse."""
    if text not in NAMED and not (text.isascii() and text.isdigit()):
        raise argparse.ArgumentTypeError(f"{text!r}: a row's number, from 0 on, or {', '.join(NAMED)}")
    return Row(text)
