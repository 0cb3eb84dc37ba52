"""What `host stream` does: one thread a port reads and decodes, this thread counts, shows and keeps.

The queue between them is bounded, so that a slow disk or terminal slows the reading down (and the robot then drops
whole frames and says so) instead of eating memory.
"""

from __future__ import annotations

import contextlib
import math
import queue
import tempfile
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING

import host

from ..link.frame import Frame
from ..link.records import Event, State
from ..protocol.errors import ConnectionLostError, LocalError, PeerSilentError, SpindeckError
from . import EXIT_INTERRUPTED
from .interrupt import Interrupt
from .keep import Keeper, save_picture
from .new_file import new_folder
from .show import JsonLines, Terminal
from .stream_robot import Robot

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator

QUEUE_EVENTS = 64
REFRESH_S = 0.2
STOP_S = 1.0
"""After Ctrl-C the reading threads get this long, at most, to hand over what they have."""


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
    if arguments.picture and not Path(arguments.picture).parent.is_dir():
        raise LocalError(f"--picture {arguments.picture}: there is no folder {Path(arguments.picture).parent}")
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
            folder = new_folder(arguments.images, "--images ")
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
