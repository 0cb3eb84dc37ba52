"""`host doctor`: listens for a minute and says what is wrong with a robot, where, and what to do."""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from typing import TYPE_CHECKING, Any

from ..protocol.errors import LocalError, PeerSilentError
from .stream import positive

if TYPE_CHECKING:
    from ..link.diagnosis import Diagnosis
    from ..link.listening import Listening
    from ..link.stream import Stream

EXIT_ILL = 4
WAIT_NS = 1_000_000
"""A shorter read has not waited: its bytes were there."""
RETRY_S = 1.0
VERDICT_S = 10.0
"""Who has seen nothing wrong for a shorter time cannot say that nothing is."""
SILENCE_S = 2.0
"""Who was stopped before that has not even heard silence: a camera may be slow."""

EXAMPLES = """\
Listens and says where the fault is: camera, GAP8, UART1, STM32, clock, SPI, ESP32, UART2, Wi-Fi or this host, with
what was seen and what to do; whether the log on the robot's card is complete; and which stage limits the frame rate.
Firmware that speaks native tells most; of a stock stream only what reaches the host can be judged. Exit code 4 when
something is wrong. Ctrl-C ends it earlier. Nothing wrong in less than 10 s is no verdict: healthy is null in JSON then,
and the exit code is 2, or after Ctrl-C 130.

examples:
  host doctor --port socket://192.168.4.1:5000
  host doctor --port "sim://hover?uart1_loss=0.1&pace=max"
  host doctor --port /dev/ttyUSB0 --framing stamps --duration 20
  host doctor --port replay://flight1.mcap?pace=max --json
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "doctor",
        help="listen to a robot for a minute and say what is wrong, where, and what to do",
        description="Listen to a robot and say what is wrong with it.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("--port", required=True, metavar="PORT", help="as of host stream")
    add("--duration", type=positive(float), default=60.0, metavar="S", help="listen for S seconds (default 60)")
    add("--baud", type=positive(int), help="of a serial port (default 576000, with --framing stamps 115200)")
    add("--framing", choices=["tcp", "cpx-uart", "stamps"], help="what the bytes are (default: follows the port)")
    add(
        "--dialect",
        choices=["auto", "stock", "paper", "nanocockpit", "native"],
        default="auto",
        help="as of host stream; native frames tell most",
    )
    add("--json", action="store_true", help="one JSON object on stdout, also on a terminal")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """0: nothing wrong was seen, for long enough."""
    from ..link.diagnosis import diagnose
    from . import EXIT_INTERRUPTED

    as_json = arguments.json or not sys.stdout.isatty()
    if not as_json:
        print(f"listening to {arguments.port} for {arguments.duration:g} s; Ctrl-C ends it earlier", file=sys.stderr)
    heard, stopped = listen(arguments)
    diagnosis = diagnose(heard)
    if stopped and heard.seconds < SILENCE_S:
        diagnosis = dataclasses.replace(diagnosis, findings=[])
    verdict = not diagnosis.healthy or heard.seconds >= VERDICT_S
    if as_json:
        from .as_json import line

        print(line(as_record(arguments.port, heard, diagnosis, stopped, verdict)))
    else:
        print("\n".join(in_words(heard, diagnosis, verdict)))
    if stopped and not verdict:
        return EXIT_INTERRUPTED
    if heard.counters.bytes == 0:
        raise PeerSilentError(f"{arguments.port}: not a byte in {heard.seconds:.1f} s")
    if not verdict:
        raise LocalError(f"{arguments.port}: {heard.seconds:.1f} s is too short for a verdict: {VERDICT_S:g} are not")
    return 0 if diagnosis.healthy else EXIT_ILL


def listen(arguments: argparse.Namespace) -> tuple[Listening, bool]:
    """Until the time is over, a recording has ended, or Ctrl-C (True). A connection that ends is made again, if it can
    be."""
    from ..link.counters import SessionCounters
    from ..link.listening import Listening
    from .interrupt import Interrupt

    first = connect(arguments)
    heard = Listening(first.port.framing, arguments.dialect)
    stream: Stream | None = first
    total, over = SessionCounters(), False
    with Interrupt() as interrupt:
        while not over and not interrupt.asked and heard.seconds < arguments.duration:
            if stream is not None:
                with stream:
                    over = attend(stream, heard, arguments.duration, interrupt)
                    total += stream.counters
                if not over and not stream.counters.bytes:
                    pause(heard)  # a robot that takes no connection is not to be flooded with them
            try:
                stream = None if over else connect(arguments)
            except LocalError:
                stream = None
                pause(heard)
    if stream is not None:
        stream.close()
    heard.counters = total
    return heard, interrupt.asked


def pause(heard: Listening) -> None:
    """Before a real port is tried again."""
    time.sleep(RETRY_S)
    heard.read(time.monotonic_ns(), int(RETRY_S * 1e9), 0)


def connect(arguments: argparse.Namespace) -> Stream:
    import host

    return host.open(
        arguments.port, baud=arguments.baud, framing=arguments.framing, dialect=arguments.dialect, timeout=None
    )


def attend(stream: Stream, heard: Listening, duration_s: float, interrupt: Any) -> bool:
    """Listens to one connection. True when there is no other one to be made."""
    real = stream.port.url.partition("://")[0] not in ("sim", "replay")
    heard.read(stream.port.clock_ns(), 0, 0)
    waited_ns, then_ns, reconnects = stream.waited_ns, time.monotonic_ns(), 0
    while not interrupt.asked and heard.seconds < duration_s:
        events = stream.poll()
        now_ns, before_ns, then_ns = stream.port.clock_ns(), then_ns, time.monotonic_ns()
        waited, waited_ns = stream.waited_ns - waited_ns, stream.waited_ns
        if waited < WAIT_NS:
            waited = 0
        # A simulation, or a recording, is not waited for: its time stands still meanwhile.
        heard.read(now_ns, waited, then_ns - before_ns - waited if real else 0)
        if events is None:
            break
        heard.take(events)
        if stream.reconnects > reconnects:
            reconnects = stream.reconnects
            heard.ended(now_ns, "in the recording the robot was connected again")
    if stream.lost:
        heard.ended(stream.port.clock_ns(), stream.lost)
        return not real
    return True


def as_record(port: str, heard: Listening, diagnosis: Diagnosis, stopped: bool, verdict: bool) -> dict[str, Any]:
    """What `--json` prints."""
    return {
        "event": "diagnosis",
        "port": port,
        "seconds": round(heard.seconds, 3),
        "stopped": stopped,
        "healthy": diagnosis.healthy if verdict else None,
        "bottleneck": diagnosis.bottleneck,
        "rate": diagnosis.rate,
        "findings": [dataclasses.asdict(finding) for finding in diagnosis.findings],
        "frames": len(heard.frames),
        "frames_lost": {cause: count for cause, count in heard.counters.frames_lost.items() if count},
        "gap8": dict(heard.gap8.grown),
        "esp32": dict(heard.esp32.grown),
        "log": None if heard.log is None else dataclasses.asdict(heard.log),
    }


def in_words(heard: Listening, diagnosis: Diagnosis, verdict: bool) -> list[str]:
    """What a terminal shows."""
    lost = sum(heard.counters.frames_lost.values())
    tap = heard.framing == "stamps"
    came = f"{heard.stamps} time messages" if tap else f"{len(heard.frames)} frames, {lost} lost"
    lines = [f"heard       {came}, in {heard.seconds:.0f} s"]
    if not tap:
        lines.append(f"rate        {diagnosis.rate}")
    if not verdict:
        short = f"{heard.seconds:.1f} s is too short for a verdict: listen for a minute"
        lines.append(f"no verdict  nothing wrong was seen, and {short}")
    elif diagnosis.healthy:
        lines.append("healthy     nothing wrong was seen")
    for finding in diagnosis.findings:
        lines += ["", f"{finding.severity:<12}{finding.stage}: {finding.what}"]
        lines += [f"            {text}" for text in (finding.evidence, finding.todo) if text]
    return lines
