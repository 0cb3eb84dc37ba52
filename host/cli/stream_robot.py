"""What has come from one port of `host stream`, counted: its figures while it streams and at the end."""

from __future__ import annotations

import statistics
from collections import Counter
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from ..link.frame import Frame, LostFrame
from ..link.records import Event, LogStatus, State

if TYPE_CHECKING:
    from host.link.headers import NativeHeader
    from host.link.stream import Stream
    from host.link.track import Track
    from sim.truth import Stamped

    from .keep import Keeper

USUAL_FLAGS = ("HAS_ESTIMATE", "HAS_BOUND", "QUANTISED")
"""Of a native frame: they say that there is a time, and what its clock is. The others tell of something."""


@dataclass
class Robot:
    """One port and what has come from it."""

    number: int
    port: str
    stream: Stream
    keeper: Keeper | None = None
    track: Track | None = None
    frames: int = 0
    native_frames: int = 0
    first_ns: int | None = None
    last_ns: int = 0
    first_frame_ns: int = 0
    last_frame: Frame | None = None
    log: LogStatus | None = None
    stamped: list[Stamped] = field(default_factory=list)
    """Of the frames with an estimate, kept where there is a truth to compare."""
    bounds_us: list[int] = field(default_factory=list)
    """Of the native frames with one."""
    flags: Counter[str] = field(default_factory=Counter)
    """Of native frames, but those that most have."""
    ended: bool = False
    error: Exception | None = None
    """What ended its thread; anything but a SpindeckError is a bug and is raised as it is."""

    def take(self, event: Event) -> None:
        """Counts one event and keeps what is to be kept."""
        if isinstance(event, State):
            return
        if self.first_ns is None:
            self.first_ns = event.arrival_host_ns
        self.last_ns = event.arrival_host_ns
        if isinstance(event, Frame):
            if self.last_frame is None:
                self.first_frame_ns = event.arrival_host_ns
            self.frames += 1
            self.last_frame = event
            if self.world is not None:
                from sim.truth import stamped

                self.stamped += stamped([event])
            if event.native:
                self.take_time(event.native)
            if self.keeper:
                self.keeper.frame(event)
        elif isinstance(event, LostFrame) and self.keeper:
            self.keeper.broken(event)
        elif isinstance(event, LogStatus):
            self.log = event

    def take_time(self, native: NativeHeader) -> None:
        """What the robot says of a frame's time."""
        self.native_frames += 1
        if native.bound_us is not None:
            self.bounds_us.append(native.bound_us)
        self.flags.update(name for name in native.flag_names if name not in USUAL_FLAGS)

    @property
    def times(self) -> dict[str, Any] | None:
        """Native frames with a bound, its median, and the others' and their own flags; None without such frames."""
        if not self.native_frames:
            return None
        return {
            "given": len(self.bounds_us),
            "of": self.native_frames,
            "bound_us_median": statistics.median(self.bounds_us) if self.bounds_us else None,
            "flags": dict(self.flags),
        }

    @property
    def echo(self) -> dict[str, int] | None:
        """What the last native frame says of the smallest delay on UART1; None if it says nothing."""
        native = None if self.last_frame is None else self.last_frame.native
        return None if native is None or native.echo is None else asdict(native.echo)

    @property
    def seconds(self) -> float:
        """Between the first event and the last, on the clock of the port."""
        return 0.0 if self.first_ns is None else (self.last_ns - self.first_ns) * 1e-9

    @property
    def fps(self) -> float | None:
        """From the first frame to the last: N frames span N - 1 periods."""
        if self.last_frame is None or self.last_frame.arrival_host_ns <= self.first_frame_ns:
            return None
        return (self.frames - 1) / ((self.last_frame.arrival_host_ns - self.first_frame_ns) * 1e-9)

    @property
    def world(self) -> Any:
        """The simulated world behind the port, or None for a real one."""
        return getattr(self.stream.port, "world", None)

    @property
    def backends(self) -> dict[str, str] | None:
        """What each MCU of a simulated robot is: "native" or "emulated"; None for a real one."""
        return None if self.world is None else dict(self.world.robots[self.stream.port.robot].backends)

    def summary(self) -> dict[str, Any]:
        """Figures at the end, or so far; `frames_lost` by cause, `stamp_error_us` only where the truth is known."""
        counters = self.stream.counters
        fps = self.fps
        return {
            "port": self.port,
            "backends": self.backends,
            "frames": self.frames,
            "dialect": None if self.last_frame is None else self.last_frame.dialect,
            "seconds": round(self.seconds, 3),
            "fps": None if fps is None else round(fps, 2),
            "bytes": counters.bytes,
            "frames_lost": {cause: count for cause, count in counters.frames_lost.items() if count},
            "garbage_bytes": counters.garbage_bytes,
            "stamps": counters.stamps + counters.pairs,
            "reconnects": self.stream.reconnects,
            "times": self.times,
            "echo": self.echo,
            "stamp_error_us": self.stamp_error_us(),
            "log": None if self.log is None else asdict(self.log),
            "recorded": None if self.track is None else self.track.summary(),
            "error": None if self.error is None else str(self.error),
        }

    def stamp_error_us(self) -> dict[str, float] | None:
        """Estimate minus truth over all stamped frames: n, mean, sd, worst. None without a truth."""
        if self.world is None or not self.stamped:
            return None
        from sim.truth import stamp_errors_us

        return stamp_errors_us(self.stamped, self.world, self.stream.port.robot)
