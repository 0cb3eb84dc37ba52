"""What somebody heard who listened to a robot for a while: events in, figures over time out. Pure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .counters import SessionCounters
from .frame import PAIR_DTYPE, Frame, LostFrame
from .headers import NativeHeader
from .records import Announced, Event, LogStatus, NanocockpitStamp, PaperStamp, Stamp, Status

NS = 1_000_000_000
RESTART_STAMPS = 50
"""A stamp number that is lower by more: the STM32 has restarted. By less: messages have overtaken each other."""
SEGMENT_S = 2.0
"""Shorter pieces of a clock's readings say nothing about its rate."""


@dataclass(slots=True)
class Growth:
    """How much counters have grown since they were first read, across restarts of the MCU that counts."""

    grown: Counter[str] = field(default_factory=Counter)
    _last: dict[str, int] | None = None

    def read(self, counters: dict[str, int], restarted: bool) -> None:
        last = {} if restarted else self._last
        if last is not None:
            self.grown.update({name: max(0, value - last.get(name, 0)) for name, value in counters.items()})
        self._last = counters


@dataclass(slots=True)
class Clocks:
    """Readings of one clock against another, in pieces without a jump: (x, y), both in us."""

    pieces: list[list[tuple[int, int]]] = field(default_factory=lambda: [[]])

    def read(self, x_us: int, y_us: int) -> None:
        last = self.pieces[-1]
        if last and (x_us < last[-1][0] or y_us < last[-1][1]):
            self.cut()
        self.pieces[-1].append((x_us, y_us))

    def cut(self) -> None:
        """What comes now is not to be compared with what came before."""
        if self.pieces[-1]:
            self.pieces.append([])

    def longest(self) -> NDArray[np.int64] | None:
        """Shape (n, 2); None when no piece is long enough to say anything."""
        piece = max(self.pieces, key=len)
        if len(piece) < 8 or piece[-1][0] - piece[0][0] < SEGMENT_S * 1e6:
            return None
        return np.array(piece, np.int64)

    def late_us(self) -> tuple[float, NDArray[np.float64]] | None:
        """How much faster y runs than x, in ppm, and how late each y is behind the earliest.

        Delays only add: so a quarter of the readings at each end has one that is nearly undelayed, and the line through
        both is the clock. None when there is nothing to say.
        """
        piece = self.longest()
        if piece is None:
            return None
        x, extra = (piece[:, 0] - piece[0, 0]).astype(float), (piece[:, 1] - piece[:, 0]).astype(float)
        quarter = max(2, len(piece) // 4)
        first, last = int(np.argmin(extra[:quarter])), len(piece) - quarter + int(np.argmin(extra[-quarter:]))
        rate = (extra[last] - extra[first]) / (x[last] - x[first])
        late = extra - rate * x
        return rate * 1e6, late - np.percentile(late, 1)


@dataclass(slots=True)
class Listening:
    """Feed it with all that one robot sends; host.link.diagnosis reads it."""

    framing: str = "tcp"
    dialect: str = "auto"
    started_ns: int | None = None
    now_ns: int = 0
    waited_ns: int = 0
    """Of the host's time: in which it waited for bytes. The rest it was busy."""
    busy_ns: int = 0
    frames: list[tuple[int, int, NativeHeader | None]] = field(default_factory=list)
    """arrival_host_ns, bytes of the body, header."""
    broken: list[tuple[int, str]] = field(default_factory=list)
    """arrival_host_ns and cause."""
    statuses: int = 0
    announced: int = 0
    ends: list[tuple[int, str]] = field(default_factory=list)
    """When a connection ended, and why."""
    gap8: Growth = field(default_factory=Growth)
    esp32: Growth = field(default_factory=Growth)
    gap8_restarts: int = 0
    gap8_forgot: int = 0
    """The stream was stock again for a while, and the GAP8 had not restarted."""
    logs: dict[int, LogStatus] = field(default_factory=dict)
    """By session, the last that was heard of each log on the STM32's card."""
    log: LogStatus | None = None
    """The last of all."""
    esp32_restarts: int = 0
    stm32_restarts: int = 0
    stm32_resets: int = 0
    """Of its stamp clock."""
    stamps: int = 0
    stamps_missed: int = 0
    """UART1 listened to."""
    arrivals: Clocks = field(default_factory=Clocks)
    """Frames: GAP8 time, host time."""
    pairs: Clocks = field(default_factory=Clocks)
    """Stamp messages: STM32 time, GAP8 time. UART1 listened to: STM32 time, host time."""
    captures: list[tuple[int, int, int]] = field(default_factory=list)
    """From frame to frame: numbers, GAP8 us, captures that failed."""
    gaps: list[tuple[int, int]] = field(default_factory=list)
    """From frame to frame: host ns, and how much of it the camera explains."""
    gap8_steps: Counter[int] = field(default_factory=Counter)
    """Readings of the GAP8's stamp clock, modulo 1 ms. The STM32's say nothing: it sends at whole milliseconds."""
    no_stamp_us: int = 0
    """Longest age of the last stamp at a frame."""
    never_stamped: int = 0
    spoken: str = "stock"
    """Dialect of the last frame."""
    counters: SessionCounters = field(default_factory=SessionCounters)
    """Of the session, of all connections together."""
    _esp32_up_us: int | None = None
    _stock_since: bool = False
    _header: NativeHeader | None = None
    _stamp: tuple[int, int] | None = None

    def read(self, now_ns: int, waited_ns: int, busy_ns: int) -> None:
        """The host has read once: it had waited so long for it, and before that was busy so long."""
        if self.started_ns is None:
            self.started_ns = now_ns
        self.now_ns = max(self.now_ns, now_ns)
        self.waited_ns += waited_ns
        self.busy_ns += busy_ns

    def ended(self, now_ns: int, why: str) -> None:
        """The connection, not the listening."""
        self.ends.append((now_ns, why))
        self._stock_since = False
        self._header = None
        self.arrivals.cut()

    def take(self, events: Iterable[Event]) -> None:
        """All that a session hands out, in its order."""
        for event in events:
            if isinstance(event, Frame):
                self._frame(event)
            elif isinstance(event, LostFrame):
                self.broken.append((event.arrival_host_ns, event.cause))
            elif isinstance(event, Status):
                self._status(event)
            elif isinstance(event, LogStatus):
                self.log = self.logs[event.session] = event
            elif isinstance(event, Stamp):
                self._stamp_heard(event)
            elif isinstance(event, PaperStamp):
                self.stamps += 1
                self.pairs.read(event.stm32_us, event.arrival_host_ns // 1000)
            elif isinstance(event, NanocockpitStamp):
                self.stamps += 1
            elif isinstance(event, Announced):
                self.announced += 1

    @property
    def seconds(self) -> float:
        return 0.0 if self.started_ns is None else (self.now_ns - self.started_ns) / NS

    @property
    def garbage_bytes(self) -> int:
        """A packet that was under way when the connection, or a recording, ended is none."""
        return self.counters.garbage_bytes - self.counters.cut_bytes

    @property
    def numbered(self) -> list[tuple[int, NativeHeader]]:
        return [(arrival_ns, header) for arrival_ns, _, header in self.frames if header is not None]

    def _frame(self, frame: Frame) -> None:
        header = frame.native
        self.frames.append((frame.arrival_host_ns, int(frame.body.size), header))
        self.spoken = frame.dialect
        if header is None:
            self._other_times(frame)
            self._stock_since = True
            self._gap(None, None)
            return
        restarted = self._continue(header)
        self.gap8.read({"frame": header.frame, **header.counters}, restarted)
        self.arrivals.read(header.frame_gap8_us, frame.arrival_host_ns // 1000)
        self.gap8_steps[header.frame_gap8_us % 1000] += 1
        if header.stamp_age_us is None:
            self.never_stamped += 1
        else:
            self.no_stamp_us = max(self.no_stamp_us, header.stamp_age_us)
        if frame.pairs is not None:
            self._pairs(frame.pairs)

    def _other_times(self, frame: Frame) -> None:
        """Other firmware tells when the GAP8 has heard nothing of the STM32 yet."""
        if frame.paper:
            self.never_stamped += not frame.paper.heard
        if frame.nanocockpit:
            self.never_stamped += frame.nanocockpit.state_gap8_us == 0

    def _continue(self, header: NativeHeader) -> bool:
        """Judges what lies between the last numbered frame and this one. True: the GAP8 has restarted."""
        last, self._header = self._header, header
        self._gap(last, header)
        stock, self._stock_since = self._stock_since, False
        if last is None:
            return False
        restarted = header.frame < last.frame or header.counters["stamps_received"] < last.counters["stamps_received"]
        if restarted:
            self.gap8_restarts += 1
            self.pairs.cut()
            self.arrivals.cut()
        elif stock:
            self.gap8_forgot += 1
        elif header.frame_gap8_us > last.frame_gap8_us:
            failed = header.counters["captures_failed"] - last.counters["captures_failed"]
            self.captures.append((header.frame - last.frame, header.frame_gap8_us - last.frame_gap8_us, failed))
        return restarted

    def _gap(self, last: NativeHeader | None, header: NativeHeader | None) -> None:
        if len(self.frames) < 2:
            return
        by_camera = header.frame_gap8_us - last.frame_gap8_us if last is not None and header is not None else 0
        self.gaps.append((self.frames[-1][0] - self.frames[-2][0], max(0, by_camera) * 1000))

    def _status(self, status: Status) -> None:
        self.statuses += 1
        restarted = self._esp32_up_us is not None and status.up_us < self._esp32_up_us
        self.esp32_restarts += restarted
        self._esp32_up_us = status.up_us
        self.esp32.read(status.counters, restarted)

    def _pairs(self, pairs: NDArray[np.void]) -> None:
        if pairs.dtype != PAIR_DTYPE:
            raise TypeError(pairs.dtype)
        for sequence, stm32_us, gap8_us, epoch in pairs.tolist():
            if self._follows(sequence, epoch):
                self.pairs.read(stm32_us, gap8_us)
                self.gap8_steps[gap8_us % 1000] += 1

    def _stamp_heard(self, stamp: Stamp) -> None:
        last = self._stamp
        if self._follows(stamp.sequence, stamp.epoch):
            self.stamps += 1
            self.pairs.read(stamp.stm32_us, stamp.arrival_host_ns // 1000)
            if last is not None and stamp.sequence > last[0]:
                self.stamps_missed += stamp.sequence - last[0] - 1

    def _follows(self, sequence: int, epoch: int) -> bool:
        """False for a message that has been overtaken."""
        last = self._stamp
        if last is not None and sequence <= last[0] <= sequence + RESTART_STAMPS:
            return False
        self._stamp = (sequence, epoch)
        if last is not None and sequence < last[0]:
            self.stm32_restarts += 1
            self.pairs.cut()
        elif last is not None and epoch != last[1]:
            self.stm32_resets += 1
            self.pairs.cut()
        return True
