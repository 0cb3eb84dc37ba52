"""What a capture is taken apart into."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

Framing = Literal["tcp", "nanocockpit", "cpx-uart", "stamps", "spi", "nanocockpit-spi"]
Kind = Literal["packet", "credit", "idle", "stamp", "garbage", "truncated"]


@dataclass(frozen=True, slots=True)
class Piece:
    """One thing on the wire."""

    offset: int
    """In the capture."""
    size: int
    kind: Kind
    about: str = ""
    """Of garbage and of a truncated piece: what is wrong."""
    content: Any = None
    """What construct made of a packet or a message on UART1."""
    layout: str = ""
    """Of a message on UART1: its table in docs/PROTOCOL.md."""
