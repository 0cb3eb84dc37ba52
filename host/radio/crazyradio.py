"""What a Crazyradio, PA or 2.0, is told over USB before it broadcasts (docs/PROTOCOL.md, "Crazyradio"). Bytes only."""

from __future__ import annotations

from dataclasses import dataclass

from .url import RadioUrl

VENDOR, PRODUCT = 0x1915, 0x7777
CONFIGURATION = 1
INTERFACE = 0
OUT = 0x01
"""Bulk endpoint: a packet of 1 to 32 bytes is sent as it is. With acknowledgements off nothing comes back."""
TO_DEVICE = 0x40
"""bmRequestType of a vendor's request."""
BROADCAST = bytes.fromhex("ff e7 e7 e7 e7")
"""The second address on which every Crazyflie listens; it acknowledges nothing that comes there."""

SET_CHANNEL = 0x01
SET_ADDRESS = 0x02
SET_RATE = 0x03
SET_POWER = 0x04
SET_ACK = 0x10
SET_CARRIER = 0x20
SET_INLINE = 0x23
RATE = {"1M": 1, "2M": 2}
POWER_MOST = 3


@dataclass(frozen=True, slots=True)
class Control:
    """A request on the control endpoint; wIndex is 0."""

    request: int
    value: int
    data: bytes = b""


INLINE_OFF = Control(SET_INLINE, 0)
"""A program before this one may have left it on, and then the first 8 bytes of a packet are settings. The Crazyradio PA
has no such mode and refuses (stalls)."""


def settings(url: RadioUrl) -> tuple[Control, ...]:
    """All that this dongle may have been told otherwise."""
    return (
        Control(SET_RATE, RATE[url.rate]),
        Control(SET_CHANNEL, url.channel),
        Control(SET_CARRIER, 0),
        Control(SET_ADDRESS, 0, BROADCAST),
        Control(SET_POWER, POWER_MOST),
        Control(SET_ACK, 0),
    )
