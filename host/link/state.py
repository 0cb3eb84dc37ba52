"""Which side is silent, and since when; and how long to wait before a connection is tried again. Pure: the times are
those of the caller.
"""

from __future__ import annotations

from .frame import Frame, LostFrame
from .records import Condition, Event, NanocockpitStamp, PaperStamp, Stamp, State
from .session import Session

SILENT_NS = 2_000_000_000
"""A camera may be slow: shorter silences mean nothing."""
STAMPS_SILENT_US = 500_000
"""Fifty stamp messages."""

LOOK_NS = 50_000_000
"""While frames come, a look at the counters this often is enough: reading them takes time at full speed."""

BACKOFF_FIRST_S = 0.5
BACKOFF_MAX_S = 10.0


class Backoff:
    """Seconds from one try to the next: doubling, so that a robot that is away costs nothing, up to a bound, so that
    one that comes back is found soon."""

    def __init__(self) -> None:
        self._next_s = BACKOFF_FIRST_S

    def next_s(self) -> float:
        """To wait now."""
        now_s, self._next_s = self._next_s, min(2 * self._next_s, BACKOFF_MAX_S)
        return now_s

    def reset(self) -> None:
        """The robot has sent what it is there for."""
        self._next_s = BACKOFF_FIRST_S


class Watch:
    """Looks on at one stream, over all its connections, and says when its state changes."""

    def __init__(self) -> None:
        self.state: State | None = None
        self._bytes = 0
        self._packets = 0
        self._bytes_ns = 0
        self._packets_ns = 0
        self._whole_ns = 0
        self._progress = -1
        self._progress_ns = 0
        self._broken_ns: int | None = None
        self._began = False
        self._looked_ns = 0
        self._first_stampless_ns: int | None = None
        self._stamps_since_ns: int | None = None

    def connected(self, now_ns: int) -> State:
        """A connection begins: nothing has come yet."""
        self._bytes = self._packets = 0
        self._bytes_ns = self._packets_ns = self._whole_ns = self._progress_ns = now_ns
        self._broken_ns = self._first_stampless_ns = self._stamps_since_ns = None
        self._began = False
        return self._become("waiting", now_ns, now_ns, "")

    def disconnected(self, now_ns: int, reason: str) -> State:
        """A connection has ended, or could not be made again. The first of both tells since when."""
        since_ns = self.state.since_host_ns if self.state and self.state.state == "disconnected" else now_ns
        return self._become("disconnected", since_ns, now_ns, reason)

    def look(self, session: Session, events: list[Event], now_ns: int) -> State | None:
        """After each read, with what it brought: the new state, or None while it is the old one."""
        for event in events:
            if isinstance(event, Frame):
                self._began, self._whole_ns = True, now_ns
                self._look_at_stamps(event)
            elif isinstance(event, Stamp | PaperStamp | NanocockpitStamp):
                self._began, self._whole_ns = True, now_ns
            elif isinstance(event, LostFrame):
                self._broken_ns = now_ns
        streaming = self.state is not None and self.state.state == "streaming" and self._stamps_since_ns is None
        if streaming and now_ns - self._looked_ns < LOOK_NS:
            return None
        self._looked_ns = now_ns
        if session.bytes_received != self._bytes:
            self._bytes, self._bytes_ns = session.bytes_received, now_ns
        if session.frame_progress != self._progress:
            self._progress, self._progress_ns = session.frame_progress, now_ns
        if self._whole_ns == now_ns:
            self._packets, self._packets_ns = session.packets_received, now_ns
        condition, since_ns = self._judge(session, now_ns)
        if self.state is not None and self.state.state == condition:
            return None
        return self._become(condition, since_ns, now_ns, "")

    def _judge(self, session: Session, now_ns: int) -> tuple[Condition, int]:
        broken = self._broken_ns is not None and now_ns - self._broken_ns <= SILENT_NS
        if now_ns - self._whole_ns > SILENT_NS and broken:
            return "broken_frames", self._whole_ns
        if now_ns - max(self._whole_ns, self._progress_ns) <= SILENT_NS:
            if not self._began:
                return "waiting", self._whole_ns
            if self._stamps_since_ns is not None:
                return "no_stamps", self._stamps_since_ns
            return "streaming", now_ns
        if now_ns - self._bytes_ns > SILENT_NS:
            return "no_bytes", self._bytes_ns
        packets = session.packets_received
        if packets != self._packets:
            self._packets, self._packets_ns = packets, now_ns
        if now_ns - self._packets_ns > SILENT_NS:
            return "no_packets", self._packets_ns
        return "no_frames", self._whole_ns

    def _look_at_stamps(self, frame: Frame) -> None:
        """A native frame says how old the GAP8's last stamp is; one without any has had its chance after a while. The
        paper's says only that there was none yet."""
        native, now_ns = frame.native, frame.arrival_host_ns
        if native is None and (frame.paper is None or frame.paper.heard):
            self._first_stampless_ns = self._stamps_since_ns = None
        elif native is not None and native.stamp_age_us is not None:
            self._first_stampless_ns = None
            silent = native.stamp_age_us > STAMPS_SILENT_US
            if not silent:
                self._stamps_since_ns = None
            elif self._stamps_since_ns is None:
                self._stamps_since_ns = now_ns - native.stamp_age_us * 1000
        elif self._first_stampless_ns is None:
            self._first_stampless_ns = now_ns
        elif now_ns - self._first_stampless_ns > STAMPS_SILENT_US * 1000:
            self._stamps_since_ns = self._first_stampless_ns

    def _become(self, condition: Condition, since_ns: int, now_ns: int, reason: str) -> State:
        self.state = State(now_ns, condition, since_ns, reason)
        return self.state


def describe(state: State, now_ns: int) -> str:
    """For people: which side is silent, and since when."""
    ago = f"since {max(0, now_ns - state.since_host_ns) * 1e-9:.1f} s"
    return {
        "waiting": "connected, waiting for the first frame",
        "streaming": "streaming",
        "no_bytes": f"no bytes from the robot {ago}",
        "no_packets": f"bytes but no packets {ago}: wrong framing or baud rate?",
        "no_frames": f"bytes but no frames {ago}: camera or GAP8",
        "broken_frames": f"no whole frame {ago}, only broken ones: bytes are lost on the way",
        "no_stamps": f"GAP8 says no stamps {ago}: STM32 or UART1",
        "disconnected": f"disconnected {ago}: {state.reason}",
    }[state.state]
