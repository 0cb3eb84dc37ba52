"""What the host builds and reads by hand. Streams are split in C, in batches (host.link); this is for single packets.

Numbers are those of the C: `lib.CPX_GAP8`, `lib.CPX_APP`. Ranges are judged when a packet is encoded.
"""

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True, slots=True)
class Route:
    destination: int
    """0..7; in use: CPX_STM32, CPX_ESP32, CPX_HOST, CPX_GAP8."""
    source: int
    function: int
    """0..63."""
    version: int = 0
    last_packet: bool = False
    reserved: bool = False
    """Announces native on a stock header packet."""


@dataclass(frozen=True, slots=True)
class CpxPacket:
    route: Route
    data: bytes


@dataclass(frozen=True, slots=True)
class StampMessage:
    sequence: int
    stm32_us: int
    """STM32 stamp clock when the message began to leave."""
    epoch: int


@dataclass(frozen=True, slots=True)
class StreamRequest:
    """To the GAP8: which dialect to send. To the ESP32: whether to send its counters too."""

    native: bool
    data_max: int = 0
    """Longest CPX data wanted, 144..1020 bytes; 0: 1020."""


@dataclass(frozen=True, slots=True)
class CameraSettings:
    auto_exposure: bool = True
    analog_gain: int = 1
    """1, 2, 4 or 8."""
    digital_gain: int = 64
    """In 1/64; 1..255."""
    burst: int = 1
    """Images back to back, 1..3."""
    encoding: Literal["raw", "jpeg"] = "raw"
    exposure_lines: int = 500
    """2..65535; where automatic exposure starts, if that is on."""
    frame_period_us: int = 0
    """From burst to burst, at most 10 s; 0: as fast as it goes."""


@dataclass(frozen=True, slots=True)
class Beacon:
    """To all robots at once: the host's clock."""

    sequence: int
    host_us: int


RESET_CLOCKS = b"\x23\0usec\0reset\0\x08\x01"
"""Likewise: a CRTP packet that sets the parameter usec.reset, a u8, to 1 by its name."""
