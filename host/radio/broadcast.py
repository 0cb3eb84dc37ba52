"""Beacons at an even pace: when each is due, its bytes, and how late it went. No clock and no dongle of its own: an Air
has both."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from ..protocol.codec import encode_beacon
from ..protocol.errors import PeerSilentError
from ..protocol.packets import RESET_CLOCKS, Beacon

WRAP = 1 << 32
"""Of the beacons' numbers."""
NUMBER_US = 50_000
"""The first number is the host's clock in these, which go by faster than beacons: so a sender that was started again
goes on behind the numbers before, and a robot's log has one run of the host."""
SILENT_MAX = 5
"""So many packets in a row that the dongle does not take: it is of no more use."""


class Air(Protocol):
    """What broadcasts, and the clock that beacons tell."""

    @property
    def heard(self) -> tuple[int, ...] | None:
        """Beacons that each robot has heard; None: nobody knows."""

    def now_us(self) -> int: ...

    def wait_until(self, at_us: int, stop: Callable[[], bool]) -> None:
        """Or until `stop`, which is asked often."""

    def send(self, packet: bytes) -> None:
        """Returns when the dongle has it. PeerSilentError: it did not take it in time, and whether it was sent is not
        known. ConnectionLostError: it is gone."""

    def close(self) -> None: ...


@dataclass(frozen=True, slots=True)
class Sent:
    """One beacon."""

    sequence: int
    due_us: int
    host_us: int
    """What it says: the host's clock, read last before it was sent."""
    done_us: int
    """The host's clock when the dongle had it."""
    failed: str
    """Why the dongle did not take it; empty: it did."""
    skipped: int
    """Beacons left out after it, for their time had passed."""

    @property
    def late_us(self) -> int:
        return self.host_us - self.due_us

    @property
    def transfer_us(self) -> int:
        return self.done_us - self.host_us


def beacons(
    air: Air, hz: float, duration_s: float | None, stop: Callable[[], bool], reset: bool = False
) -> Iterator[Sent]:
    """Sends, each in the middle of its period, and says what it has sent. `reset`: first sets all clocks to 0.
    ConnectionLostError, PeerSilentError: the dongle is of no more use."""
    period_us = 1e6 / hz
    begin_us = air.now_us()
    end_us = math.inf if duration_s is None else begin_us + duration_s * 1e6
    sequence = begin_us // NUMBER_US % WRAP
    place = silent = 0
    if reset:
        air.send(RESET_CLOCKS)
    while (due_us := begin_us + round((place + 0.5) * period_us)) < end_us:
        air.wait_until(due_us, stop)
        if stop():
            return
        sequence = (sequence + 1) % WRAP
        failed = ""
        host_us = air.now_us()
        try:
            air.send(encode_beacon(Beacon(sequence, host_us)))
        except PeerSilentError as error:
            failed = str(error)
        done_us = air.now_us()
        # Those whose time has passed are left out, not sent in a burst.
        skipped = max(math.ceil((done_us - begin_us) / period_us - 0.5) - place - 1, 0)
        place += 1 + skipped
        yield Sent(sequence, due_us, host_us, done_us, failed, skipped)
        silent = silent + 1 if failed else 0
        if silent == SILENT_MAX:
            raise PeerSilentError(f"{failed}: {SILENT_MAX} packets in a row")
    if duration_s is not None:
        air.wait_until(round(end_us), stop)
