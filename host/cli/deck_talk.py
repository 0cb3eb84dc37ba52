"""What `host deck` says to a deck and when: it listens, then asks, and knows who has not answered."""

from __future__ import annotations

from collections.abc import Callable

from ..link.deck import ECHO, LISTEN_S, Heard
from ..link.stream import Stream
from ..native import lib
from ..protocol.errors import ConnectionLostError, PeerError, PeerSilentError

REPEAT_S = 1.0


class Talk:
    """Listens, then asks, again each second."""

    def __init__(self, stream: Stream, timeout_s: float, no_nanocockpit: str) -> None:
        """`no_nanocockpit`: why that firmware is not asked."""
        self.heard = Heard()
        self.ended = False
        self.asked = 0
        self._asked_esp32 = False
        self._stream = stream
        self._no_nanocockpit = no_nanocockpit
        self._timeout_ns = int(timeout_s * 1e9)
        self._began_ns = stream.port.clock_ns()

    def listen(self) -> None:
        """Until it is known that CPX is spoken, or the ESP32 may be asked whether it is. On a UART there is nothing
        else. PeerError for other bytes: then nothing has been sent."""
        if self._stream.port.framing != "tcp":
            return
        long_enough_ns = min(int(LISTEN_S * 1e9), self._timeout_ns // 2)
        clock_ns = self._stream.port.clock_ns
        while not self.heard.is_cpx and clock_ns() - self._began_ns < self._timeout_ns:
            if self.heard.may_be_cpx and clock_ns() - self._began_ns >= long_enough_ns:
                return
            if not self._hear():
                raise self.lost()
        if not self.heard.is_cpx:
            raise PeerError(
                f"{self._stream.port.url}: {self.heard.bytes} bytes, {self.heard.packets} packets and no image in "
                "them: neither CPX nor NanoCockpit's. Nothing was sent. Is this a deck's port?"
            )

    def _hear(self) -> bool:
        """One read. False when the connection has ended."""
        stream = self._stream
        events = stream.poll()
        if events is None:
            self.ended = True
            return False
        self.heard.take(events, stream.counters, stream.reads_cpx)
        if self.heard.nanocockpit:
            sent = "An echo request" if self._asked_esp32 else "Nothing"
            raise PeerError(f"{stream.port.url}: {self._no_nanocockpit}. {sent} was sent")
        return True

    def until(
        self,
        done: Callable[[Heard], bool],
        question: tuple[int, int, bytes] | None = None,
        may_end: bool = False,
    ) -> None:
        """Until that is so or the time is up; `question` goes to the GAP8, an echo to the ESP32."""
        stream = self._stream
        began_ns = next_ns = stream.port.clock_ns()
        while not done(self.heard) and stream.port.clock_ns() - began_ns < self._timeout_ns:
            if stream.port.clock_ns() >= next_ns:
                next_ns += int(REPEAT_S * 1e9)
                if question is not None:
                    stream.send(*question)
                    self.asked += 1
                if not self.heard.echo:
                    stream.send(lib.CPX_ESP32, lib.CPX_TEST, ECHO)
                    self._asked_esp32 = True
            if not self._hear():
                if may_end:
                    return
                raise self.lost()

    def lost(self) -> ConnectionLostError:
        """Its end, which came too soon."""
        return ConnectionLostError(f"{self._stream.port.url}: {self._stream.port.ended or 'the connection has ended'}")

    def silent(self) -> PeerSilentError:
        """Who has not answered."""
        seconds = (self._stream.port.clock_ns() - self._began_ns) * 1e-9
        return PeerSilentError(f"{self._stream.port.url}: {self.heard.who_is_silent(seconds, self.asked)}")
