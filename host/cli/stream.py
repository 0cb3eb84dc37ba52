"""`host stream`: frames from one robot or several, shown, counted and kept."""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING

from ..protocol.typed import integer, real
from .row import row

if TYPE_CHECKING:
    from collections.abc import Callable

EXAMPLES = """\
ports:
  socket://192.168.4.1:5000   an AI-deck on Wi-Fi
  /dev/ttyUSB0, COM3          a serial adapter: CPX over UART2, or --framing stamps for a tap on UART1
  rfc2217://HOST:PORT         a serial adapter on another machine
  sim://SCENARIO?key=value&…  the simulator: hover, lossy, swarm, …; keys in docs/SCENARIOS.md
  replay://FILE?rate=2&…      a recording: keys rate, loop, start, robot, pace; see host replay --help

examples:
  host stream --port "sim://hover?gap8_ppm=80&uart1_loss=0.2&seed=7" --count 50
  host stream --port socket://192.168.4.1:5000 --images flight1
  host stream --port socket://192.168.4.1:5000 --record flight1.mcap
  host stream --port socket://192.168.4.1:5000 --reconnect --images flight2
  host stream --port "sim://swarm?robot=0" --port "sim://swarm?robot=1" --json
  host stream --port "sim://hover?seed=7" --row middle --count 3 --json
"""


def positive(kind: type[int] | type[float]) -> Callable[[str], float]:
    """An argparse type: a number above zero."""

    def parse(text: str) -> float:
        value = integer(text) if kind is int else real(text)
        if value <= 0:
            raise argparse.ArgumentTypeError(f"must be above 0, not {text}")
        return value

    parse.__name__ = kind.__name__
    return parse


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "stream",
        help="stream frames from a robot, a serial adapter or the simulator",
        description="Stream frames; show a status line, then a summary. JSON lines when piped.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("--port", action="append", required=True, metavar="PORT", help="where from; repeat for several robots")
    add("--baud", type=positive(int), help="of a serial port (default 576000, with --framing stamps 115200)")
    add("--framing", choices=["tcp", "cpx-uart", "stamps"], help="what the bytes are (default: follows the port)")
    add(
        "--dialect",
        choices=["auto", "stock", "paper", "nanocockpit", "native"],
        default="auto",
        help="auto (default): recognise what comes, ask for native once it has announced that; native: ask at once; "
        "stock: read every firmware, ask for nothing; paper: ask for nothing; nanocockpit: answer each frame, as its "
        "own client does. A robot that does not speak the paper, nanocockpit or native that was chosen: exit code 4",
    )
    add("--count", type=positive(int), metavar="N", help="end after N frames of each robot")
    add("--duration", type=positive(float), metavar="S", help="end after S seconds of the robot's stream")
    add(
        "--timeout", type=positive(float), default=10.0, metavar="S", help="give up after S silent seconds (default 10)"
    )
    add(
        "--reconnect",
        action="store_true",
        help="wait for a robot that is not there yet; when the connection ends, or is silent for the timeout, make it "
        "again; for ever (socket and serial)",
    )
    add("--images", metavar="DIR", help="keep every frame: one picture each, and frames.jsonl; DIR new or empty")
    add("--record", metavar="FILE", help="keep everything, bytes included, in a new MCAP file: host replay plays it")
    add(
        "--record-without",
        choices=["images", "raw"],
        help="halve the file: images are in the raw bytes too (Foxglove shows none then); without raw, no replay",
    )
    add("--picture", metavar="FILE", help="where the last frame goes as PNG (default on a terminal: a temporary file)")
    add("--camera", metavar="PATH", help="what a simulated camera sees: a PGM, PPM or PNG file, or a folder of them")
    add(
        "--row",
        type=row,
        metavar="ROW",
        help="give the STM32 time of the middle of this row's exposure too (row_stm32_us, in JSON and frames.jsonl of "
        "native frames): its number, or first, middle, last",
    )
    add("--json", action="store_true", help="JSON lines on stdout, also on a terminal")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Streams until the end, the count, the time, an error or Ctrl-C."""
    from .stream_loop import stream

    return stream(arguments, as_json=arguments.json or not sys.stdout.isatty())
