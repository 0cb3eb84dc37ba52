"""The command line: `host COMMAND …`, also installed as `spindeck`.

Each command is a module with `add_parser(subparsers)` and `run(arguments) -> int`. Parsers are built without importing
anything heavy, so that `--help` and completion stay quick; a command imports what it needs when it runs.
stdout is data, stderr is for people.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence

from ..protocol.errors import LocalError, PeerError
from . import ports, recover, replay, sim, stream

EXIT_LOCAL = 2
EXIT_PEER = 3

EXIT_CODES = """\
exit codes:
  0  done, or stopped with Ctrl-C after something was received
  2  wrong arguments, or a port, file or scenario that cannot be used: the message says what to do
  3  the robot sent nothing usable, or stopped
"""


def parser() -> argparse.ArgumentParser:
    """The whole command line, without having imported numpy, rich or a port."""
    top = argparse.ArgumentParser(
        prog="host",
        description="Time-stamped camera streams from nano drones, real or simulated.",
        epilog=EXIT_CODES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="store_true", help="print the version and exit")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    stream.add_parser(commands)
    replay.add_parser(commands)
    recover.add_parser(commands)
    sim.add_parser(commands)
    ports.add_parser(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command and returns its exit code."""
    top = parser()
    arguments = top.parse_args(argv)
    if arguments.version:
        from importlib.metadata import version

        print(version("spindeck"))
        return 0
    if arguments.command is None:
        top.print_help(sys.stderr)
        return EXIT_LOCAL
    try:
        return int(arguments.run(arguments))
    except LocalError as error:
        print(f"host: {error}", file=sys.stderr)
        return EXIT_LOCAL
    except PeerError as error:
        print(f"host: {error}", file=sys.stderr)
        return EXIT_PEER
    except BrokenPipeError:
        # Whoever read our output has enough. Python would complain again when it flushes stdout at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
