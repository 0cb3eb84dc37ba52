"""What a dialect adds to a session: asking for native, and saying where missing frames went.

Stock frames carry no number: whatever was dropped before the host leaves no trace. A native frame carries its number
and how many frames the GAP8 gave up; the ESP32 says once a second how many it dropped. From these every number that
was not delivered gets exactly one cause.
"""

from __future__ import annotations

from collections import Counter
from typing import Literal

from ..native import lib

Dialect = Literal["auto", "stock", "paper", "nanocockpit", "native"]
"""auto recognises all of them and transmits nothing before native is announced. stock: likewise, and never transmits.
paper and native: packets of CPX from the first byte on; native is asked for, paper for nothing. nanocockpit: packets by
its rule from the first byte on, and each frame is answered, as that firmware's own client does. Whoever chooses one of
these three and meets another firmware has made a mistake: see expected.py."""

SPOKEN: dict[int, Dialect] = {
    lib.DIALECT_STOCK: "stock",
    lib.DIALECT_PAPER: "paper",
    lib.DIALECT_NANOCOCKPIT: "nanocockpit",
    lib.DIALECT_NATIVE: "native",
}
"""By stream_frame_t.dialect."""

REPEAT_NS = 1_000_000_000
ASKS_MAX = 10
"""A robot that does not answer this often does not speak native."""
LAPSE_NS = 3_500_000_000
"""What came every second and has not come for so long has to be asked for again."""

WRAP = 1 << 32
JUMP = 1 << 16
"""Numbers further apart than this were not skipped: the GAP8 has restarted, or the number is damaged."""


class Asking:
    """When to ask one MCU for native. `auto` waits until the robot has announced that it speaks native."""

    def __init__(self, dialect: Dialect) -> None:
        self.dialect = dialect
        self.wanted = dialect == "native"
        self._asked = 0
        self._next_ns: int | None = None
        self._lapses_ns: int | None = None

    def announced(self) -> None:
        """The robot sends stock frames and would send native ones."""
        if self.dialect in ("auto", "native") and not self.wanted:
            self.wanted = True
            self._asked = 0
            self._next_ns = None

    def arrived(self) -> None:
        """What was asked for comes: nothing more to ask."""
        self.wanted = False

    def arrived_again(self, now_ns: int) -> None:
        """Likewise, unless it ceases to come: its MCU has restarted, and announces nothing."""
        self.wanted = False
        self._asked = 0
        self._lapses_ns = now_ns + LAPSE_NS

    def due(self, now_ns: int | None) -> bool:
        """True when a request is to be sent now. None: the time is not known yet, which is enough for the first."""
        if self._lapses_ns is not None and now_ns is not None and now_ns >= self._lapses_ns:
            self.wanted, self._lapses_ns, self._next_ns = True, None, None
        if not self.wanted or self._asked >= ASKS_MAX:
            return False
        if self._asked and (now_ns is None or self._next_ns is None or now_ns < self._next_ns):
            if self._next_ns is None and now_ns is not None:
                self._next_ns = now_ns + REPEAT_NS
            return False
        self._asked += 1
        self._next_ns = None if now_ns is None else now_ns + REPEAT_NS
        return True


class FrameIds:
    """NanoCockpit: the sensor's counter has 8 bits, so a gap of 256 frames is none."""

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self._last: int | None = None
        self._failed = 0

    def failed(self) -> None:
        """A frame began and was lost: counted where it was noticed."""
        self._failed += 1

    def came(self, frame_id: int) -> None:
        """A good frame with this number. Nobody on the robot says why others did not come."""
        last, self._last = self._last, frame_id
        failed, self._failed = self._failed, 0
        if last is not None:
            self.lost["unexplained"] += max(0, (frame_id - last - 1) % 256 - failed)


class FrameNumbers:
    """Causes of the numbers that were skipped between two good frames."""

    def __init__(self) -> None:
        self.lost: Counter[str] = Counter()
        self.renumbered = 0
        self._last: tuple[int, int, int] | None = None
        self._lost_since = 0
        self._stock_since = False
        self._esp32_total: int | None = None
        self._esp32_credit = 0

    def failed(self) -> None:
        """A native frame began and was lost: counted where it was noticed."""
        self._lost_since += 1

    def stock_came(self) -> None:
        """A frame without a number, whole or not: the GAP8 has restarted, or had taken this host for gone. How many
        frames there were until the next number is not known."""
        self._stock_since = True

    def came(self, frame: int, gap8_unsent: int, headless: int) -> None:
        """A good frame with this number; `gap8_unsent` and `headless` are totals so far: frames that the GAP8 gave
        up, and frames of which data came without a header."""
        previous, self._last = self._last, (frame, gap8_unsent, headless)
        failed, self._lost_since = self._lost_since, 0
        anew, self._stock_since = self._stock_since, False
        if previous is None:
            return
        skipped = (frame - previous[0] - 1) % WRAP
        if anew or skipped >= JUMP:
            self.renumbered += 1
            return
        left = max(0, skipped - failed)
        for cause, most in (
            ("missing_data", (headless - previous[2]) % WRAP),
            ("gap8_unsent", (gap8_unsent - previous[1]) % WRAP),
            ("esp32_dropped", self._esp32_credit),
            ("unexplained", left),
        ):
            count = min(left, most)
            left -= count
            self.lost[cause] += count
            if cause == "esp32_dropped":
                self._esp32_credit -= count

    def esp32_says(self, dropped: int) -> None:
        """The ESP32 has dropped so many frames since its boot."""
        before, self._esp32_total = self._esp32_total, dropped
        if before is None:
            # Drops of earlier connections are in the first figure too: it explains what is open now, no more.
            self._esp32_credit = min(dropped, self.lost["unexplained"])
        else:
            self._esp32_credit += dropped - before if dropped >= before else dropped
        count = min(self._esp32_credit, self.lost["unexplained"])
        self._esp32_credit -= count
        self.lost["unexplained"] -= count
        self.lost["esp32_dropped"] += count
