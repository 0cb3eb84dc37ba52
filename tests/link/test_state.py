"""Who is silent, and since when, from made streams and made times."""

import pytest
from made_streams import native, packet, pixels, stock

from host.link.records import Event, State
from host.link.session import Session
from host.link.state import BACKOFF_MAX_S, Backoff, Watch, describe

BODY = pixels(8, 6, 1)
S = 1_000_000_000


class Run:
    """A session and a watch, a tenth of a second at a time."""

    def __init__(self, framing: str = "tcp") -> None:
        self.session = Session(framing, "stock")  # type: ignore[arg-type]
        self.watch = Watch()
        self.now_ns = 5 * S
        self.watch.connected(self.now_ns)
        self.changes: list[tuple[str, float]] = []

    def go(self, seconds: float, *parts: bytes) -> "Run":
        """One of the parts each 0.1 s, in turn; nothing without any."""
        for step in range(round(10 * seconds)):
            self.now_ns += S // 10
            events: list[Event] = []
            if parts:
                events = self.session.receive(parts[step % len(parts)], self.now_ns)
            changed = self.watch.look(self.session, events, self.now_ns)
            if changed:
                self.changes.append((changed.state, round((self.now_ns - changed.since_host_ns) / S, 1)))
        return self

    @property
    def text(self) -> str:
        assert self.watch.state is not None
        return describe(self.watch.state, self.now_ns)


FRAME = b"".join(stock(BODY, 8, 6))


def test_nothing_at_all() -> None:
    run = Run().go(3.2)
    assert run.changes == [("no_bytes", 2.1)]
    assert run.text == "no bytes from the robot since 3.2 s"


def test_frames_and_then_silence_and_then_frames() -> None:
    run = Run().go(1, FRAME).go(2).go(0.1)
    assert run.changes == [("streaming", 0.0), ("no_bytes", 2.1)]
    run.go(1.5)
    assert run.text == "no bytes from the robot since 3.6 s"
    run.go(0.1, FRAME)
    assert run.changes[2:] == [("streaming", 0.0)]


def test_bytes_without_frames() -> None:
    console = packet(b"hello\0", b"\x63\x02")
    run = Run().go(1, FRAME).go(3, console)
    assert run.changes[1:] == [("no_frames", 2.1)]
    assert run.text == "bytes but no frames since 3.0 s: camera or GAP8"


def test_bytes_that_are_no_packets() -> None:
    run = Run().go(5, b"\xff\x00\x00\x00\x00\xff" * 400)
    assert run.changes[-1][0] == "no_packets"
    assert "wrong framing or baud rate" in run.text


def test_only_broken_frames() -> None:
    header, *pieces = stock(pixels(60, 50, 3), 60, 50)
    run = Run().go(1, FRAME).go(3, header + pieces[0] + pieces[2])
    assert run.changes[1][0] == "broken_frames"
    assert "bytes are lost on the way" in run.text


def test_a_slow_line_is_no_silent_camera() -> None:
    large = b"".join(stock(pixels(100, 100, 2), 100, 100))
    run = Run().go(8, *(large[at : at + 256] for at in range(0, len(large), 256)))
    assert [state for state, _ in run.changes] == ["streaming"]


def test_stamps_that_stop() -> None:
    def made(frame: int, age_us: int) -> bytes:
        return b"".join(native(frame, BODY, 8, 6, stamp_age_us=age_us))

    run = Run()
    for frame in range(10):
        run.go(0.1, made(frame, 4_000))
    for frame in range(10, 20):
        run.go(0.1, made(frame, (frame - 9) * 100_000))
    assert run.changes == [("streaming", 0.0), ("no_stamps", 0.6)]
    assert run.text == "GAP8 says no stamps since 1.0 s: STM32 or UART1"
    run.go(0.1, made(20, 3_000))
    assert run.changes[2:] == [("streaming", 0.0)]


def test_stamps_that_never_came() -> None:
    run = Run()
    for frame in range(10):
        run.go(0.1, b"".join(native(frame, BODY, 8, 6, stamp_age_us=0xFFFFFFFF)))
    assert run.changes[-1] == ("no_stamps", 0.6)


def test_a_stock_frame_has_no_stamps_to_miss() -> None:
    assert Run().go(3, FRAME).changes == [("streaming", 0.0)]


def test_disconnected_since_the_first_of_several_reasons() -> None:
    watch = Watch()
    watch.connected(0)
    watch.disconnected(7 * S, "closed by the robot")
    state = watch.disconnected(9 * S, "refused")
    assert state == State(9 * S, "disconnected", 7 * S, "refused")
    assert describe(state, 10 * S) == "disconnected since 3.0 s: refused"
    assert watch.connected(11 * S).state == "waiting"


def test_backoff() -> None:
    backoff = Backoff()
    assert [backoff.next_s() for _ in range(7)] == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]
    assert pytest.approx(10.0) == BACKOFF_MAX_S
    backoff.reset()
    assert backoff.next_s() == 0.5
