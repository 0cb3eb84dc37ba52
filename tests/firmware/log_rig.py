"""The STM32's app with a card in memory whose operations take time, and the logs that are on it then."""

import random
from collections.abc import Callable
from typing import Any

from board import CRTP, HOST, STM32, App, cpx, uart
from memory_card import MemoryCard

from host.native import ffi, lib
from host.usd.decode import decode
from host.usd.log import Log

STAMPS_OFF = 2**32 - 1
SECOND = 1_000_000
ROW_BYTES = 10 + 6 * 4
"""With the variables of config()."""
POSE = {"x_m": 1.0, "z_m": 2.0, "qz": 0.6, "qw": 0.8}


class Rig:
    """The app as a board runs it; time is the uptime and the stamp clock at once."""

    def __init__(self, card: MemoryCard, seed: int = 1, operation_us: int = 2000, **config: object) -> None:
        self.app = App("stm32", stamp_period_us=STAMPS_OFF, **config)
        self.card = card
        self.now_us = 0
        self.operation_us: Callable[[], int] = lambda: operation_us
        self.rng = random.Random(seed)
        self._answer: tuple[int, bytes] | None = None
        self._byte, self._request = ffi.new("uint8_t[]", 1), ffi.new("uint8_t[]", lib.STORAGE_REQUEST_MAX)
        self.poll()

    def poll(self) -> None:
        """Asks the idle ports, as App.transmit does, in a hundredth of its time."""
        now, ask = (self.now_us, self.now_us), lib.stm32_transmit
        while ask(self.app.state, lib.STM32_PORT_UART2, (self._byte, 1), now):
            pass
        size = ask(self.app.state, lib.STM32_PORT_STORAGE, (self._request, lib.STORAGE_REQUEST_MAX), now)
        if size:
            assert self._answer is None, "one request at a time"
            answer = self.card.answer(bytes(ffi.buffer(self._request, size)))
            self._answer = (self.now_us + self.operation_us(), answer)

    def run(self, until_us: int) -> None:
        while True:
            deadline_us = lib.stm32_deadline(self.app.state)
            due = [deadline_us] if deadline_us > self.now_us else []
            due += [self._answer[0]] if self._answer is not None else []
            now_us = min(due, default=until_us + 1)
            if now_us > until_us:
                self.now_us = until_us
                return
            self.now_us = now_us
            if self._answer is not None and self._answer[0] == now_us:
                answer, self._answer = self._answer[1], None
                self.app.receive("STORAGE", answer, now_us)
            self.poll()

    def crtp(self, data: bytes) -> None:
        """From the host."""
        self.app.receive("UART2", uart(cpx(HOST, STM32, CRTP, data)), self.now_us)
        self.poll()

    def radio(self, data: bytes) -> None:
        """A CRTP packet that was broadcast."""
        self.app.receive("RADIO", data, self.now_us)
        self.poll()

    def logging(self, on: bool) -> None:
        self.crtp(b"\x23\0usd\0logging\0\x08" + bytes([on]))


def config(ring: int = 8192, hz: int = 1000, startup: int = 1, more: bytes = b"") -> bytes:
    axes = b"".join(b"stateEstimate.%b\n" % each for each in (b"x", b"y", b"z", b"vx", b"yaw", b"qw"))
    return b"1\n%d\nlog\n%d\non:fixedFrequency\n%d\n1\n" % (ring, startup, hz) + axes + more


def flown(seconds: float = 2.0, text: bytes | None = None, **settings: Any) -> Rig:
    rig = Rig(MemoryCard(config() if text is None else text), pose=POSE, sway_m=0.5, **settings)
    rig.run(round(seconds * SECOND))
    return rig


def ended(rig: Rig) -> Rig:
    rig.logging(False)
    rig.run(rig.now_us + 2 * SECOND)
    return rig


def log_files(rig: Rig) -> list[tuple[str, bytes]]:
    """In the order of their names."""
    return [(name, bytes(data)) for name, data in sorted(rig.card.files.items()) if name != "config.txt"]


def logs(rig: Rig) -> list[Log]:
    return [decode(data) for _, data in log_files(rig)]


def grid(first_us: int, last_us: int, period_us: int = 1000) -> int:
    """Rows that are due, both ends included."""
    return (last_us - int(first_us)) // period_us + 1


def last_status(log: Log) -> dict[str, int]:
    rows = log.rows["log.status"].data
    return {name: int(rows[name][-1]) for name in (rows.dtype.names or ())}
