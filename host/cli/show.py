"""What the user sees of a running stream: a status line and a summary on a terminal, JSON lines otherwise."""

from __future__ import annotations

import dataclasses
import sys
from typing import TYPE_CHECKING, Any

from ..link.rules_of_log import ENDS
from ..link.state import describe as describe_state
from .as_json import as_dict, line
from .stream_robot import USUAL_FLAGS

if TYPE_CHECKING:
    from pathlib import Path
    from types import TracebackType

    from ..link.frame import Frame
    from ..link.headers import NativeEcho
    from ..link.records import Event
    from .row import Row
    from .stream_robot import Robot


class JsonLines:
    """Every event as a line on stdout, then a summary line per robot."""

    def __init__(self, row: Row | None = None) -> None:
        self.row = row

    def __enter__(self) -> JsonLines:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def event(self, event: Event, robot: int) -> None:
        """One line, at once."""
        sys.stdout.write(line(as_dict(event, robot, self.row)) + "\n")
        sys.stdout.flush()

    def refresh(self, robots: list[Robot]) -> None:
        """Nothing: a pipe has no status line."""

    def finish(self, robots: list[Robot], picture: Path | None) -> None:
        """The summary lines."""
        for robot in robots:
            record = {"event": "summary", "robot": robot.number, **robot.summary()}
            if picture is not None:
                record["picture"] = str(picture)
            print(line(record), flush=True)


class Terminal:
    """A line per robot that is rewritten in place on stderr; warnings above it; a table at the end on stdout."""

    def __init__(self, robots: list[Robot]) -> None:
        from rich.console import Console
        from rich.live import Live

        self.console = Console(stderr=True, highlight=False)
        self.live = Live(console=self.console, auto_refresh=False, transient=True)
        self.robots = robots

    def __enter__(self) -> Terminal:
        self.live.__enter__()
        self.refresh(self.robots)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.live.__exit__(kind, error, trace)

    def event(self, event: Event, robot: int) -> None:
        """Prints what a person should not miss: console text, lost frames, garbage, who has fallen silent."""
        record = as_dict(event, robot)
        if record["event"] in ("console", "lost_frame", "garbage", "announced", "state"):
            self.console.print(f"robot {robot}: {describe(record)}", style="dim", markup=False)

    def refresh(self, robots: list[Robot]) -> None:
        """Rewrites the status lines."""
        self.live.update("\n".join(text for robot in robots for text in status_lines(robot)), refresh=True)

    def finish(self, robots: list[Robot], picture: Path | None) -> None:
        """The summary, on stdout."""
        for robot in robots:
            for text in summary_lines(robot.summary()):
                print(text)
        if picture is not None:
            print(f"last frame  {picture}")


def describe(record: dict[str, Any]) -> str:
    """One line for people about an event."""
    if record["event"] == "console":
        return f"{record['source']} says: {record['text'].rstrip()}"
    if record["event"] == "lost_frame":
        return f"frame lost ({record['cause']}): {record['received_bytes']} of {record['expected_bytes']} bytes"
    if record["event"] == "garbage":
        return f"skipped {record['size']} bytes of garbage at byte {record['offset']}"
    if record["event"] == "state":
        return str(record["text"])
    return "speaks the native dialect: asked for time-stamped frames"


def status_lines(robot: Robot) -> list[str]:
    """Frames, rate, bytes, losses and the last stamp of one robot; below it how its clocks go, what is emulated, and
    who is silent, if anyone is."""
    lines = [status_line(robot)]
    if told := clock_line(robot.last_frame):
        lines.append(f"  {told}")
    if of := emulated(robot.backends):
        lines.append(f"  {of}")
    if of := card_log(None if robot.log is None else dataclasses.asdict(robot.log)):
        lines.append(f"  log on the card: {of}")
    state = robot.stream.watch.state
    if state is not None and state.state not in ("waiting", "streaming"):
        lines.append(f"  {describe_state(state, robot.stream.port.clock_ns())}")
    return lines


def status_line(robot: Robot) -> str:
    """Frames, rate, bytes, losses and the last stamp of one robot."""
    if robot.first_ns is None:
        return f"robot {robot.number}: waiting for {robot.port}"
    # Not the summary: its stamp error looks at every frame so far, and this is asked for five times a second.
    counters = robot.stream.counters
    return (
        f"robot {robot.number}: {robot.frames} frames  {robot.fps or 0:.1f} fps  "
        f"{counters.bytes / 1e6:.1f} MB  lost {sum(counters.frames_lost.values())}  " + last_time(robot.last_frame)
    )


def emulated(backends: dict[str, str] | None) -> str:
    """Which MCUs run images; empty if none does."""
    by: dict[str, list[str]] = {}
    for mcu, backend in (backends or {}).items():
        by.setdefault(backend, []).append(mcu)
    parts = [f"{' and '.join(by[backend])} {backend}" for backend in sorted(by)]
    return ", ".join(parts) if "emulated" in by else ""


def card_log(log: dict[str, Any] | None) -> str:
    """How complete the log on the STM32's card is, from its record; empty where there is none, and none is wanted."""
    if log is None or (log["files"] == 0 and log["state"] in ("off", "no_card", "no_config")):
        return ""
    counters = log["counters"]
    return (
        f"{log['state'].replace('_', ' ')}, {counters['accepted']} rows, {counters['dropped']} dropped, "
        f"{counters['card_errors']} errors of the card, longest pause {counters['stall_us'] / 1000:.0f} ms"
    )


def waiting_log(log: dict[str, Any] | None) -> str:
    """There is a card, and none has begun."""
    if log is None or log["files"] or log["state"] != "off":
        return ""
    return "off: as config.txt has it, it begins when the parameter usd.logging is set to 1"


def ended_log(log: dict[str, Any]) -> str:
    """Why it has ended by itself and what to do, if it has."""
    if log["state"] not in ENDS:
        return ""
    _, what, todo = ENDS[log["state"]]
    return f"; {what}. {todo}"


def last_time(frame: Frame | None) -> str:
    """When the last frame was taken, on the clock that says so."""
    if frame is None:
        return "no frame yet"
    flags = warnings(frame)
    if frame.frame_stm32_us is not None:
        bound = "" if frame.native is None or frame.native.bound_us is None else f" ± {frame.native.bound_us} us"
        return f"last frame at STM32 {frame.frame_stm32_us / 1e6:.6f} s{bound}{flags}"
    if frame.native:
        return f"last frame without a time{flags}"
    if frame.nanocockpit:
        return f"last frame at GAP8 {frame.nanocockpit.frame_gap8_us / 1e6:.6f} s"
    return "no stamps"


def clock_line(frame: Frame | None) -> str:
    """How the robot's clocks go against each other; empty if it does not say."""
    native = frame.native if frame else None
    if native is None or native.clock is None or native.frame_stm32_us is None:
        return ""
    from ..clock.stamps import SLOW_PPM

    drift = native.clock.drift_ppm
    slow = ", which counts 84 of 85" if abs(drift - SLOW_PPM) < abs(drift) else ""
    offset_s = (native.frame_gap8_us - native.frame_stm32_us) * 1e-6
    return (
        f"GAP8 against STM32{slow}: drift {drift:+.2f} ppm  offset {offset_s:+.6f} s  "
        f"by {native.clock.window_stamps} stamps, {native.clock.delay_us} us late{echo_text(native.echo)}"
    )


def echo_text(echo: NativeEcho | None) -> str:
    """What echoes say of the delay that all stamps have; empty if none has come back."""
    if echo is None:
        return ""
    return f", the fastest by 0 to {echo.minimum_delay_us + echo.minimum_delay_error_us} us"


def warnings(frame: Frame) -> str:
    """Flags of a native frame's time that say how it came about; empty if nothing is the matter."""
    names = [name for name in (frame.native.flag_names if frame.native else ()) if name not in USUAL_FLAGS]
    return f" ({', '.join(names).lower().replace('_', ' ')})" if names else ""


def summary_lines(summary: dict[str, Any]) -> list[str]:
    """The summary of one robot, a fact a line."""
    lost = ", ".join(f"{count} {cause}" for cause, count in summary["frames_lost"].items()) or "none"
    lines = [
        f"port        {summary['port']}",
        f"frames      {summary['frames']} in {summary['seconds']:.2f} s"
        + (f", {summary['fps']:.2f} fps" if summary["fps"] else "")
        + (f", {summary['dialect']}" if summary["dialect"] else ""),
        f"bytes       {summary['bytes']}",
        f"lost        {lost}"
        + (f"; reconnected: {summary['reconnects']}" if summary["reconnects"] else "")
        + (f"; {summary['garbage_bytes']} garbage bytes" if summary["garbage_bytes"] else ""),
    ]
    if summary["recorded"]:
        missing = {what: count for what, count in summary["recorded"]["missing"].items() if count}
        slow = "; THE DISK WAS TOO SLOW, missing: " + ", ".join(f"{count} {what}" for what, count in missing.items())
        lines.append(f"recorded    {summary['recorded']['file']}" + (slow if missing else ""))
    if of := emulated(summary["backends"]):
        lines.append(f"firmware    {of}")
    if summary["stamps"]:
        lines.append(f"stamps      {summary['stamps']} messages of the STM32")
    if times := summary["times"]:
        named = ", ".join(f"{count} {name.lower().replace('_', ' ')}" for name, count in times["flags"].items())
        lines.append(
            f"times       {times['given']} of {times['of']} frames"
            + (f", good to ± {times['bound_us_median']:.0f} us (median)" if times["given"] else "")
            + (f"; {named}" if named else "")
        )
    if echo := summary["echo"]:
        lines.append(
            f"UART1       delays every stamp by 0 to {echo['minimum_delay_us'] + echo['minimum_delay_error_us']} us, "
            f"by {echo['echoes']} echoes; no time or bound has that in it"
        )
    if of := card_log(summary["log"]) or waiting_log(summary["log"]):
        lines.append(f"card's log  {of}{ended_log(summary['log'])}")
    error = summary["stamp_error_us"]
    if error:
        lines.append(
            f"stamp error {error['mean']:+.0f} us mean, {error['sd']:.0f} us sd, {error['worst']:+.0f} us worst "
            f"against the simulation's truth, over {error['n']} frames"
            + (f", {error['within']} of {error['bounded']} within their bound" if error["bounded"] else "")
        )
    return lines
