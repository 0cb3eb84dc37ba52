"""`host sync beacons`: broadcasts the host's clock, and says how well that went."""

from __future__ import annotations

import argparse
import sys
from array import array
from contextlib import closing
from typing import Any

from ..protocol.errors import LocalError, PeerError, PeerSilentError, SpindeckError
from ..radio.broadcast import Air, Sent, beacons
from ..usd.host_log import HostLog
from . import EXIT_INTERRUPTED
from .as_json import line
from .interrupt import Interrupt

HZ_MIN, HZ_MAX = 1.0, 10.0
SECOND_US = 1_000_000
CLEAR = "\r\x1b[K"
"""The line of a terminal."""


class Tally:
    """Of some beacons: how late they were, and how long the dongle took."""

    def __init__(self) -> None:
        self.late_us = array("q")
        self.transfer_us = array("q")
        self.failed = self.skipped = self.sequence = 0
        self.why = ""
        """The last one failed."""

    def add(self, sent: Sent) -> None:
        self.sequence = sent.sequence
        self.skipped += sent.skipped
        if sent.failed:
            self.failed += 1
            self.why = sent.failed
            return
        self.late_us.append(sent.late_us)
        self.transfer_us.append(sent.transfer_us)

    def record(self) -> dict[str, Any]:
        counts = {"sequence": self.sequence, "sent": len(self.late_us)}
        counts |= {"failed": self.failed, "skipped": self.skipped}
        return counts | parts("late_us", self.late_us) | parts("transfer_us", self.transfer_us)


def parts(name: str, values: array[int]) -> dict[str, int | None]:
    """Percentiles, by the nearest value that there was."""
    ordered = sorted(values)
    last = len(ordered) - 1
    found = {f"{name}_p{part}": ordered[round(last * part / 100)] if ordered else None for part in (50, 95)}
    return {**found, f"{name}_max": ordered[-1] if ordered else None}


def run(arguments: argparse.Namespace) -> int:
    """0 after the time, or after Ctrl-C if none was given."""
    if not HZ_MIN <= arguments.hz <= HZ_MAX:
        raise LocalError(f"--hz {arguments.hz:g}: allowed is {HZ_MIN:g} to {HZ_MAX:g}")
    if arguments.duration is not None and not arguments.duration > 0:
        raise LocalError(f"--duration {arguments.duration:g}: allowed is more than 0")
    if arguments.duration is not None and arguments.duration * arguments.hz <= 0.5:
        raise LocalError(
            f"--duration {arguments.duration:g}: too short for a beacon: the first comes after half a period"
        )
    if arguments.log == "":
        raise LocalError("--log: its name is empty")
    with closing(open_air(arguments.port)) as air, Interrupt() as interrupt:
        whole = Tally()
        log = HostLog(arguments.log) if arguments.log else None
        try:
            lost = send(air, arguments, interrupt, log, whole)
        finally:
            if log:
                log.end()
        if not whole.late_us:
            raise lost or (KeyboardInterrupt() if interrupt.asked else PeerSilentError(whole.why))
        if lost and not isinstance(lost, SpindeckError):
            raise lost
        finish(whole, air, arguments.json)
    if lost:
        kept = f"; {arguments.log} has what was sent before" if log and isinstance(lost, PeerError) else ""
        raise type(lost)(f"{lost} ({len(whole.late_us)} beacons were sent{kept})")
    return EXIT_INTERRUPTED if interrupt.asked and arguments.duration is not None else 0


def send(
    air: Air, arguments: argparse.Namespace, interrupt: Interrupt, log: HostLog | None, whole: Tally
) -> BaseException | None:
    """Why it ended before its time: the dongle, the log or our output that takes no more, a second Ctrl-C."""
    second, begin_us = Tally(), air.now_us()
    said_us = begin_us + SECOND_US
    try:
        for sent in beacons(air, arguments.hz, arguments.duration, lambda: interrupt.asked, arguments.reset):
            whole.add(sent)
            if log and not sent.failed:
                log.add(sent.sequence, sent.host_us, sent.done_us)
            if sent.host_us >= said_us:
                tell(second, (sent.host_us - begin_us) // SECOND_US, arguments.json)
                second, said_us = Tally(), said_us + (sent.host_us - said_us) // SECOND_US * SECOND_US + SECOND_US
            second.add(sent)
    except (SpindeckError, OSError, KeyboardInterrupt) as error:
        return error
    return None


def open_air(port: str) -> Air:
    if port.lower().startswith("sim://"):
        from sim.serial.air import SimulatedAir

        return SimulatedAir(port)
    if port.lower().startswith("radio://"):
        from ..radio.dongle import Dongle

        return Dongle(port)
    raise LocalError(f"{port}: nothing that broadcasts: give radio://DONGLE/CHANNEL/RATE, or sim://SCENARIO")


def tell(second: Tally, seconds: int, as_json: bool) -> None:
    record = second.record()
    if as_json:
        print(line({"event": "beacons", "after_s": seconds, **record}), flush=True)
        return
    lost = f", {second.failed} not taken" * bool(second.failed) + f", {second.skipped} left out" * bool(second.skipped)
    said = f"{seconds:6} s  beacon {second.sequence}{lost}  {late(record)}"
    # On a terminal each line takes the place of the one before it.
    print(f"{CLEAR}{said}" if sys.stdout.isatty() else said, end="" if sys.stdout.isatty() else "\n", flush=True)


def late(record: dict[str, Any]) -> str:
    if not record["sent"]:
        return "none sent"
    ways = (("late", "late_us"), ("to the dongle in", "transfer_us"))
    return ", ".join(f"{word} {record[f'{key}_p50']} us (worst {record[f'{key}_max']})" for word, key in ways)


def finish(whole: Tally, air: Air, as_json: bool) -> None:
    record = whole.record()
    if as_json:
        print(line({"event": "summary", **record, "heard": air.heard}))
        return
    print(CLEAR if sys.stdout.isatty() else "", end="")
    print(f"{record['sent']} beacons sent, {whole.failed} that the dongle did not take, {whole.skipped} left out")
    for word, key in (
        ("late against the schedule", "late_us"),
        ("from the clock's reading to the dongle", "transfer_us"),
    ):
        if record["sent"]:
            print(f"  {word}: " + ", ".join(f"{name} {record[f'{key}_{name}']} us" for name in ("p50", "p95", "max")))
    for robot, heard in enumerate(air.heard or ()):
        print(f"  robot {robot} has heard {heard}")
