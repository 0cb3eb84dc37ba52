"""What `host stream` does: one thread a port reads and decodes, this thread counts, shows and keeps.

The queue between them is bounded, so that a slow disk or terminal slows the reading down (and the robot then drops
whole frames and says so) instead of eating memory.
"""

from __future__ import annotations

import contextlib
import math
import queue
import statistics
import tempfile
import threading
import time
from collections import Counter
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import host

from ..link.records import Event, Frame, LogStatus, LostFrame, State
from ..protocol.errors import ConnectionLostError, LocalError, PeerSilentError, SpindeckError
from . import EXIT_INTERRUPTED
from .interrupt import Interrupt
from .keep import Keeper, new_folder, save_picture
from .show import USUAL_FLAGS, JsonLines, Terminal

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

    from host.link.records import NativeHeader
    from host.link.stream import Stream
    from host.link.track import Track
    from sim.truth import Stamped

QUEUE_EVENTS = 64
REFRESH_S = 0.2
STOP_S = 1.0
"""After Ctrl-C the reading threads get this long, at most, to hand over what they have."""


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


def wanted(events: Iterator[Event], count: int | None, duration_s: float | None) -> Iterator[tuple[Event, bool]]:
    """The events up to the frame, or the time since the first event, that the user wants, and not one byte more; and
    whether that was it."""
    frames, first_ns = 0, None
    for event in events:
        if first_ns is None and not isinstance(event, State):
            first_ns = event.arrival_host_ns
        frames += isinstance(event, Frame)
        passed_ns = 0 if first_ns is None else event.arrival_host_ns - first_ns
        enough = frames == count or (duration_s is not None and passed_ns >= duration_s * 1e9)
        yield event, enough
        if enough:
            return


def read(
    robot: Robot,
    events: queue.Queue[tuple[Robot, Event | None]],
    stop: threading.Event,
    arguments: argparse.Namespace,
) -> None:
    """The thread of one port: everything that is wanted, then None. After `stop` no more is read; what was read is
    handed over still."""
    try:
        for event, enough in wanted(robot.stream.events(states=True), arguments.count, arguments.duration):
            events.put((robot, event))
            if enough or stop.is_set():
                return
        why = robot.stream.lost
        if not why and not stop.is_set() and (arguments.count or arguments.duration):
            why = "the recording has ended before all that was wanted had come"
        if why:
            frames = robot.stream.counters.frames
            robot.error = ConnectionLostError(f"{robot.port}: {why}{f', after {frames} frames' * bool(frames)}")
    except Exception as error:  # handed to the main thread, which raises it
        robot.error = error
    finally:
        events.put((robot, None))


def stream(arguments: argparse.Namespace, as_json: bool) -> int:
    """Opens every port, streams until done, prints the summary. Returns the exit code."""
    for option in ("picture", "images", "record"):
        if getattr(arguments, option) == "":
            raise LocalError(f"--{option}: its name is empty")
    if arguments.record_without and not arguments.record:
        raise LocalError("--record-without: nothing is recorded: add --record FILE")
    if arguments.picture and Path(arguments.picture).exists():
        raise LocalError(f"--picture {arguments.picture}: exists, and nothing is ever overwritten: name another file")
    if arguments.row and not (as_json or arguments.images):
        raise LocalError("--row: its time is in JSON lines and frames.jsonl: add --json or --images DIR")
    robots: list[Robot] = []
    with contextlib.ExitStack() as open_things:
        for number, port in enumerate(arguments.port):
            opened = open_things.enter_context(
                host.open(
                    port,
                    baud=arguments.baud,
                    framing=arguments.framing,
                    dialect=arguments.dialect,
                    timeout=arguments.timeout,
                    camera=arguments.camera,
                    reconnect=arguments.reconnect,
                )
            )
            robots.append(Robot(number, port, opened))
        if arguments.images:
            folder = new_folder(arguments.images)
            for robot in robots:
                own = folder / f"robot{robot.number}" if len(robots) > 1 else folder
                robot.keeper = Keeper(own, robot.number, arguments.row)
                open_things.callback(robot.keeper.close)
        if arguments.record:
            record(robots, arguments, open_things)
        show: JsonLines | Terminal = JsonLines(arguments.row) if as_json else Terminal(robots)
        open_things.enter_context(show)
        interrupted = pump(robots, arguments, show)
    try:
        picture, not_saved = save_last(robots, arguments.picture, as_json), None
    except SpindeckError as error:
        picture, not_saved = None, error
    show.finish(robots, picture)
    if not_saved is not None:
        raise not_saved
    for robot in robots:
        named = len(robots) == 1 or str(robot.error).startswith(robot.port)
        if isinstance(robot.error, SpindeckError) and not named:
            raise type(robot.error)(f"{robot.port}: {robot.error}")
        if robot.error is not None:
            raise robot.error
        if robot.first_ns is None and not interrupted:
            raise PeerSilentError(f"{robot.port}: the stream ended before anything was received")
    asked_for_an_end = arguments.count is not None or arguments.duration is not None
    heard = any(robot.first_ns is not None for robot in robots)
    return EXIT_INTERRUPTED if interrupted and (asked_for_an_end or not heard) else 0


def record(robots: list[Robot], arguments: argparse.Namespace, open_things: contextlib.ExitStack) -> None:
    """From now on all that the robots receive and send goes into one file."""
    from ..link.recording import Recorder

    recorder = Recorder(arguments.record, arguments.record_without)
    open_things.callback(recorder.close)
    for robot in robots:
        robot.track = recorder.track(robot.number, robot.stream.port, arguments.dialect)
        robot.stream.tap = robot.track


def pump(robots: list[Robot], arguments: argparse.Namespace, show: JsonLines | Terminal) -> bool:
    """Runs the reading threads and takes what they bring. True if stopped by Ctrl-C: then what was read is kept, and
    no more is read."""
    events: queue.Queue[tuple[Robot, Event | None]] = queue.Queue(QUEUE_EVENTS)
    stop = threading.Event()
    threads = [threading.Thread(target=read, args=(robot, events, stop, arguments), daemon=True) for robot in robots]
    for thread in threads:
        thread.start()
    refreshed = time.monotonic()
    until = math.inf
    try:
        with Interrupt() as interrupt:
            while not all(robot.ended for robot in robots) and time.monotonic() < until:
                if interrupt.asked and not stop.is_set():
                    until = time.monotonic() + STOP_S
                    halt(robots, stop)
                with contextlib.suppress(queue.Empty):
                    robot, event = events.get(timeout=REFRESH_S)
                    if event is None:
                        robot.ended = True
                    else:
                        robot.take(event)
                        show.event(event, robot.number)
                if time.monotonic() - refreshed >= REFRESH_S:
                    refreshed = time.monotonic()
                    show.refresh(robots)
            return interrupt.asked
    finally:
        halt(robots, stop)
        until = time.monotonic() + STOP_S
        while any(thread.is_alive() for thread in threads) and time.monotonic() < until:
            # What they still bring is dropped: this is the way out of an error, or they have already said None.
            with contextlib.suppress(queue.Empty):
                events.get(timeout=0.01)


def halt(robots: list[Robot], stop: threading.Event) -> None:
    """Lets the reading threads end."""
    stop.set()
    for robot in robots:
        robot.stream.close()


def save_last(robots: list[Robot], wanted: str | None, as_json: bool) -> Path | None:
    """The last frame of the first robot that sent one, as PNG; None when there is none or nobody asked."""
    frames = [robot.last_frame for robot in robots if robot.last_frame is not None]
    if not frames or (as_json and not wanted):
        return None
    path = Path(wanted) if wanted else Path(tempfile.mkdtemp(prefix="spindeck-")) / "last-frame.png"
    save_picture(frames[0], path)
    return path
