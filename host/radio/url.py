"""radio://DONGLE/CHANNEL/RATE, as the Crazyflie's other programs write it."""

from __future__ import annotations

from dataclasses import dataclass

from ..protocol.errors import LocalError

SCHEME = "radio://"
FORM = "write radio://DONGLE/CHANNEL/RATE, such as radio://0/80/2M"
RATES = ("1M", "2M")
CHANNEL_MAX = 100
"""The Crazyradio 2.0 sends nothing on those above, nor at 250K, and says nothing about it."""
NUMBER_DIGITS_MAX = 9
"""A longer number is a serial number."""


@dataclass(frozen=True, slots=True)
class RadioUrl:
    dongle: int | str
    """Which of those that are plugged in, from 0 on; or its serial number."""
    channel: int
    """MHz above 2400."""
    rate: str
    """On the air, bits a second: "1M" or "2M"."""


def parse(url: str) -> RadioUrl:
    """LocalError: says what it should be."""
    parts = url[len(SCHEME) :].split("/")
    if not url.lower().startswith(SCHEME) or len(parts) < 3 or "?" in url:
        raise LocalError(f"{url}: {FORM}")
    dongle, channel, rate, *more = parts
    if more:
        raise LocalError(f"{url}: leave out the address /{'/'.join(more)}: all robots hear broadcasts")
    if not channel.isdecimal() or int(channel) > CHANNEL_MAX:
        raise LocalError(f"{url}: channel {channel}: give that of the robots, 0..{CHANNEL_MAX}")
    if rate.upper() not in RATES:
        raise LocalError(f"{url}: rate {rate}: give that of the robots, {' or '.join(RATES)}")
    if not dongle:
        raise LocalError(f"{url}: no dongle: {FORM}")
    is_number = dongle.isdecimal() and len(dongle) <= NUMBER_DIGITS_MAX
    return RadioUrl(int(dongle) if is_number else dongle, int(channel), rate.upper())
