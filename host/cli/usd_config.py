"""`host usd config check`: what a config.txt makes a robot log, and what is wrong with it."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from ..protocol.errors import LocalError

if TYPE_CHECKING:
    from ..usd.budget import Budget
    from ..usd.config import Config, Names

SIZE_MAX = 65536
"""Bytes of a config.txt that somebody has written by hand."""
EXAMPLES = """\
Which variables there are, only the robot's firmware knows. Without an option, those of this project's firmware are
taken. --log LOG takes the names out of a log of the same robot, and the most that each event came in a second; --any
takes every name, and its type for the largest one.

Errors: something that was asked for is not logged, and the exit code is 4. Warnings: something is other than it looks,
here or in the Crazyflie's own firmware. A stall is a single one, of a card that takes at most 2 ms otherwise; what the
Crazyflie's logger survives is its ring divided by the rate, which it does not always reach.

examples:
  host usd config check config.txt
  host usd config check card/config.txt --log card/log00
  host usd config check config.txt --any --rate estPose=100 --json
"""


def add_parser(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares `config check`."""
    config = verbs.add_parser("config", help="check a config.txt", description="Check a config.txt.")
    inner = config.add_subparsers(dest="config_verb", metavar="VERB", title="verbs", required=True)
    check = inner.add_parser(
        "check",
        help="say what a config.txt makes a robot log, and what is wrong with it",
        description="Say what a config.txt makes a robot log, and what is wrong with it, line by line.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    check.add_argument("file", metavar="FILE", help="a config.txt")
    names = check.add_mutually_exclusive_group()
    names.add_argument("--log", metavar="LOG", help="a log of the same robot: only what it has logged exists")
    names.add_argument("--any", action="store_true", help="every name exists")
    check.add_argument(
        "--rate",
        metavar="EVENT=HZ",
        action="append",
        default=[],
        help="how often an event comes, as estPose=100; repeat for several",
    )
    check.add_argument("--json", action="store_true", help="JSON lines on stdout")
    check.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """0, or 4 if there are errors."""
    from dataclasses import asdict

    from ..usd.budget import budget
    from ..usd.config import read_config
    from .as_json import line

    text = read_text(arguments.file)
    names = names_for(arguments, text)
    config = read_config(text, names)
    rates = {**names.rates_hz, **dict(map(read_rate, arguments.rate))}
    unknown = [event for event in rates if event not in {block.event for block in config.blocks}]
    if unused := [event for event in unknown if event not in names.rates_hz]:
        raise LocalError(f"--rate {unused[0]}: {arguments.file} has no block of this event")
    cost = budget(config, {event: hz for event, hz in rates.items() if event not in unknown})
    if arguments.json:
        for each in config.findings:
            print(line({"event": "finding", "file": arguments.file, **asdict(each)}))
        print(line(as_record(arguments.file, config, cost, names)))
    else:
        print("\n".join(lines(arguments.file, config, cost, names, rates)))
    return 4 if config.errors else 0


def read_text(name: str) -> bytes:
    from ..usd.files import read_log

    data = read_log(name)
    if len(data) > SIZE_MAX:
        raise LocalError(f"{name}: {len(data)} bytes are no config.txt")
    text = bytes(data)
    if text[:1] in (b"\xbc", b"") or text[1:9] == b"tick(I),":
        raise LocalError(f"{name}: {'a log' if text else 'empty'}: name the config.txt")
    if 0 in text:
        raise LocalError(f"{name}: not plain text (UTF-16?): save it as ASCII")
    return text


def names_for(arguments: argparse.Namespace, text: bytes) -> Names:
    from ..usd.config import names_of_firmware, names_of_log, names_of_text
    from ..usd.decode import decode
    from ..usd.files import read_log

    if arguments.any:
        return names_of_text(text)
    if arguments.log is None:
        return names_of_firmware()
    return names_of_log(decode(read_log(arguments.log)), arguments.log)


def read_rate(text: str) -> tuple[str, float]:
    from ..protocol.typed import real

    event, _, hz = text.partition("=")
    try:
        value = real(hz)
        if not event or not 0 < value <= 1e6:
            raise ValueError
    except ValueError as error:
        raise LocalError(f"--rate {text}: write EVENT=HZ, as estPose=100") from error
    return event, value


def as_record(name: str, config: Config, cost: Budget, names: Names) -> dict[str, Any]:
    """For a program."""
    from dataclasses import asdict

    return {
        "event": "config",
        "file": name,
        "good": not config.errors,
        "errors": config.errors,
        "warnings": config.warnings,
        "usable": config.usable,
        "ring_bytes": config.ring_bytes,
        "name": config.name,
        "on_startup": config.on_startup,
        "fixed_hz": config.fixed_hz,
        "blocks": [
            {"event": block.event, "row_bytes": block.row_bytes, "variables": [each.name for each in block.variables]}
            for block in config.blocks
        ],
        "types_known": names.typed,
        **asdict(cost),
    }


def lines(name: str, config: Config, cost: Budget, names: Names, rates: dict[str, float]) -> Iterator[str]:
    """For people."""
    from ..usd.budget import STALL_S
    from ..usd.config import FIXED

    yield f"{name}: {counted(config.errors, 'error')}, {counted(config.warnings, 'warning')}"
    for each in config.findings:
        yield f"  line {each.line:<4} {each.severity:<8} {each.text}"
    if names.is_ours and any(each.kind in ("variable", "event") for each in config.findings):
        yield "  names are those of this project's firmware; of another: --log with a log of the robot, or --any"
    if not config.usable:
        yield "  nothing would be logged"
        return
    most = "" if names.typed else "at most "
    for block in config.blocks:
        hz = config.fixed_hz if block.event == FIXED else rates.get(block.event)
        rate = "rate unknown" if hz is None else f"{hz:.6g} Hz"
        what = f"{counted(len(block.variables), 'variable')}, rows of {most}{block.row_bytes} bytes"
        yield f"  {block.event:<16} {rate}, {what}"
    starts = "at boot" if config.on_startup else "when the parameter usd.logging is set to 1"
    yield f"  file             {config.name}00 to {config.name}99, begun {starts}"
    if cost.uncounted:
        yield f"  not counted      {', '.join(cost.uncounted)}: --rate {cost.uncounted[0]}=HZ says how often it comes"
    yield f"  rows             {cost.rows_per_s:.6g} per second"
    yield f"  bytes            {most}{cost.bytes_per_s:.6g} per second, {cost.mb_per_hour:.3g} MB per hour"
    if cost.rows_per_s:
        yield f"  ring             {config.ring_bytes} bytes survive, when the card stalls:"
        enough = cost.stall_ms >= STALL_S * 1000
        here = f"{cost.stall_ms:.0f} ms" if cost.stall_ms else "nothing: rows are lost without any stall"
        wanted = "" if enough else f"; {STALL_S * 1000:.0f} ms take {cost.ring_wanted} bytes"
        yield f"                   with this project's logger {here}{wanted}"
        stock = "" if config.stock_ring_bytes == config.ring_bytes else f" ({config.stock_ring_bytes} bytes)"
        yield f"                   with the Crazyflie's{stock} at most {cost.stock_stall_ms:.0f} ms"


def counted(count: int, word: str) -> str:
    return f"{count or 'no'} {word}{'s' * (count != 1)}"
