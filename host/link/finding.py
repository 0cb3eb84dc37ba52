"""What host doctor can say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Stage = Literal["camera", "GAP8", "UART1", "STM32", "clock", "SPI", "ESP32", "UART2", "Wi-Fi", "host", "card", "robot"]
Severity = Literal["problem", "warning", "note"]
RARE = 3
"""Less often means nothing."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One thing that is wrong, or (a note) that could not be judged."""

    stage: Stage
    severity: Severity
    cause: str
    """A word for programs: uart1_loss, wifi_slow, …"""
    what: str
    evidence: str
    todo: str
