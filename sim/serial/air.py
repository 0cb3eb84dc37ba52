"""sim://SCENARIO as what a host broadcasts into: the world's robots hear it, and its true time is the host's clock.

With pace=real that does not get ahead of the wall time since it was opened.
"""

from __future__ import annotations

import time
from collections.abc import Callable

from host.protocol.errors import LocalError
from sim import scenario
from sim.radio import HOST_START_US
from sim.world import World

NS = 1_000_000_000
STEP_NS = NS // 50
"""The world runs this far, at most, before Ctrl-C is looked at."""
SLEEP_S = 0.002


class SimulatedAir:
    """One world, run in the caller's thread. LocalError when the URL cannot be used."""

    def __init__(self, url: str) -> None:
        made = scenario.from_url(url)
        if made.general.beacon_hz:
            raise LocalError(f"{url}: beacon_hz is another host that sends beacons: leave it out")
        self.world = World(made, keep_log=False)
        self._pace = made.pace
        self._opened_s = time.monotonic()

    @property
    def heard(self) -> tuple[int, ...]:
        return tuple(self.world.radio.heard_others)

    def now_us(self) -> int:
        return HOST_START_US + self.world.now_ns // 1000

    def wait_until(self, at_us: int, stop: Callable[[], bool]) -> None:
        at_ns = (at_us - HOST_START_US) * 1000
        while not stop() and (now_ns := self.world.now_ns) < at_ns:
            until_ns = min(at_ns, now_ns + STEP_NS)
            if self._pace == "real":
                until_ns = min(until_ns, round((time.monotonic() - self._opened_s) * NS))
            if until_ns > now_ns:
                self.world.run_until(until_ns)
            else:
                time.sleep(SLEEP_S)

    def send(self, packet: bytes) -> None:
        self.world.broadcast(packet)

    def close(self) -> None:
        """Robots with a card close their logs."""
        self.world.close()
