"""replay:// for pyserial: serial.serial_for_url("replay://flight1.mcap?rate=2&loop=1&start=10&robot=0&pace=max").

A read gives no more than one read of the recorded run gave, and clock_ns() is its arrival then: whatever decodes the
bytes does the same as it did, or would have done. Timeouts count on that clock. With pace=real it goes `rate` times as
fast as the wall clock, from the first read on; with pace=max it never waits. What is written is thrown away.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Literal, cast

from serial.serialutil import PortNotOpenError, SerialBase, SerialException, to_bytes

from ...native import lib
from ...protocol.errors import LocalError
from ..dialects import Dialect
from ..replay import Joint, Recording
from ..replay_url import from_url

NS = 1_000_000_000
SLEEP_S = 0.05
"""A wait looks this often whether it was cancelled."""
PAUSE_NS = NS // 10
"""Between two rounds of a loop: long enough for a packet that stopped half-way to be given up."""
PACKET_MAX = 4096
HEADER = struct.Struct("<HxB")
"""Length and function; between them the targets."""
FUNCTION_MASK = 0x3F

Seam = Literal["", "connection", "loop"]
"""What is read next begins anew: the robot was connected again, or the recording begins again."""


@dataclass
class PacketEnds:
    """Keeps the beginning of a TCP packet back until its end has come, so that halves of two are never joined where
    a loop begins anew, the robot was connected again, or the disk was too slow."""

    kept: bytearray = field(default_factory=bytearray)
    lost: bool = False
    """Damage in the recording: from there on everything passes."""

    def whole(self, data: memoryview) -> memoryview:
        self.kept += data
        at = 0
        while not self.lost and at + HEADER.size <= len(self.kept):
            length, function = HEADER.unpack_from(self.kept, at)
            # NanoCockpit alone sends this function, and its length leaves out the route.
            size = length + (4 if function & FUNCTION_MASK == lib.CPX_STREAMER else 2)
            self.lost = not HEADER.size <= size <= PACKET_MAX
            if self.lost or at + size > len(self.kept):
                break
            at += size
        if self.lost:
            at = len(self.kept)
        ready = bytes(self.kept[:at])
        del self.kept[:at]
        return memoryview(ready)


class Serial(SerialBase):  # type: ignore[misc]
    """One robot of a recording. Speed, parity and control lines have no meaning here and are ignored."""

    is_open: bool

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.framing = "tcp"
        self.dialect: Dialect = "auto"
        self.robot = 0
        self.epoch_ns = 0
        self.over = False
        """The end was reached: read() has said so."""
        self.seam: Seam = ""
        """Of the last read(), if tell_seams() was called: it has returned no bytes for it."""
        self._recording: Recording | None = None
        self._cancelled = False
        super().__init__(*args, **kwargs)

    def open(self) -> None:
        """LocalError when the URL or the file cannot be used."""
        if self._port is None:
            raise SerialException("Port must be configured before it can be used.")
        if self.is_open:
            raise SerialException("Port is already open.")
        self._choice = choice = from_url(self._port)
        recording = Recording(choice.path)
        try:
            self._source = source = recording.source(choice.robot)
            first_ns, last_ns = recording.span_ns(source)
            if choice.start * NS > last_ns - first_ns:
                seconds = (last_ns - first_ns) / NS
                raise LocalError(f"{self._port}: start={choice.start:g}: the recording ends after {seconds:.3f} s")
        except LocalError:
            recording.close()
            raise
        self.framing, self.robot, self.epoch_ns = source.framing, source.number, source.epoch_ns
        self.dialect = cast(Dialect, source.metadata.get("dialect", "auto"))
        self._recording = recording
        self._begin_ns = first_ns + round(choice.start * NS)
        self._round_ns = last_ns - self._begin_ns + PAUSE_NS
        self._telling = False
        self._now_ns = self._begin_ns
        self._began_s: float | None = None
        self._ready = memoryview(b"")
        self._reads = self._rounds()
        self._next = next(self._reads, None)
        self._cancelled = self.over = False
        self.seam = ""
        self._looked = True
        self.is_open = True

    def close(self) -> None:
        """Ends a read under way in another thread, too."""
        self.is_open = False
        if self._recording is not None:
            self._recording.close()

    def tell_seams(self) -> None:
        """For who begins anew at a seam, as the recorded run did: all bytes pass, and `seam` says where. Otherwise the
        half packet before a seam is left out. To be called before the first read."""
        self._telling = True
        self._reads = self._rounds()
        self._next = next(self._reads, None)

    def clock_ns(self) -> int:
        """Where the replay is, on the clock of the recorded port; in a loop it goes on."""
        return self._now_ns

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read now. A first look after a read shows only what is left of what was read then."""
        self._check()
        following = self._next
        if self._looked and not self._ready and following is not None:
            at_ns, what = following
            if not isinstance(what, str) and self._due_s(at_ns) <= 0:  # read() tells of a seam
                self._arrive()
        self._looked = True
        return len(self._ready)

    def read(self, size: int = 1) -> bytes:
        """At most so many bytes, and none beyond what one read gave; none at a seam that is told, after `timeout`
        seconds of the recording, cancel_read or close."""
        self._check()
        self.seam = ""
        if size and not self._ready:
            self._wait_for_next()
        data = bytes(self._ready[:size])
        self._ready = self._ready[size:]
        self._cancelled = self._looked = False
        return data

    def write(self, data: bytes) -> int:
        """A recording does not listen."""
        self._check()
        return len(to_bytes(data))

    def reset_input_buffer(self) -> None:
        """Throws away what has come and was not read."""
        self._check()
        self._ready = memoryview(b"")

    def reset_output_buffer(self) -> None:
        """Nothing: what was written is gone."""
        self._check()

    def flush(self) -> None:
        """Likewise."""
        self._check()

    def cancel_read(self) -> None:
        """Ends a read under way in another thread, or the next one."""
        self._cancelled = True

    def _reconfigure_port(self) -> None:
        """pyserial calls it after each change of a setting."""

    def _update_rts_state(self) -> None:
        """Likewise, and the next two."""

    def _update_dtr_state(self) -> None:
        pass

    def _update_break_state(self) -> None:
        pass

    def _check(self) -> None:
        if not self.is_open:
            raise PortNotOpenError

    def _rounds(self) -> Iterator[tuple[int, memoryview | Seam]]:
        """What is to be read, once or for ever."""
        later_ns, found = 0, True
        while found:
            found = False
            for at_ns, ready in self._round():
                if later_ns and not found and self._telling:
                    yield at_ns + later_ns, "loop"
                found = self._choice.loop
                yield at_ns + later_ns, ready
            later_ns += self._round_ns

    def _round(self) -> Iterator[tuple[int, memoryview | Seam]]:
        joints: set[Joint] = set(self._source.joints.values())
        cut = "missing" in joints or (not self._telling and (self._choice.loop or joints))
        ends = PacketEnds() if cut and self.framing == "tcp" else None
        for at_ns, data in cast(Recording, self._recording).reads(self._source, self._begin_ns):
            if isinstance(data, str):
                if self._telling and data == "connection":
                    if ends and ends.kept:
                        yield at_ns, memoryview(bytes(ends.kept))
                    yield at_ns, "connection"
                ends = PacketEnds() if ends else None
                continue
            ready = ends.whole(data) if ends else data
            if ready:
                yield at_ns, ready

    def _wait_for_next(self) -> None:
        if self._next is None:
            self.over = True
            raise SerialException("the recording has ended")
        due_ns = self._next[0]
        deadline_ns = due_ns if self._timeout is None else self._now_ns + round(self._timeout * NS)
        if self._wait(min(due_ns, deadline_ns)):
            if due_ns <= deadline_ns:
                self._arrive()
            else:
                self._now_ns = deadline_ns

    def _arrive(self) -> None:
        """The next read's bytes are there, or a seam."""
        if self._next is not None:
            self._now_ns, came = self._next
            if isinstance(came, str):
                self.seam = came
            else:
                self._ready = came
            self._next = next(self._reads, None)

    def _due_s(self, at_ns: int) -> float:
        """Wall seconds until then."""
        if self._choice.pace == "max":
            return 0.0
        now_s = time.monotonic()
        if self._began_s is None:
            self._began_s = now_s
        return self._began_s + (at_ns - self._begin_ns) / NS / self._choice.rate - now_s

    def _wait(self, until_ns: int) -> bool:
        """False when it was cancelled or closed."""
        while not self._cancelled and self.is_open:
            left_s = self._due_s(until_ns)
            if left_s <= 0:
                return True
            time.sleep(min(left_s, SLEEP_S))
        return False
