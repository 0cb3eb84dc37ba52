"""The command line: `host COMMAND …`, also installed as `spindeck`.

Each command is a module with `add_parser(subparsers)` and `run(arguments) -> int`. Parsers are built without importing
anything heavy, so that `--help` and completion stay quick; a command imports what it needs when it runs.
stdout is data, stderr is for people.
"""

from __future__ import annotations

import argparse
import errno
import os
import sys
from collections.abc import Sequence

from ..protocol.errors import ConnectionLostError, LocalError, PeerError, PeerSilentError, SpindeckError
from . import deck, dissect, doctor, firmware, ports, recover, replay, sim, stream, sync, usd

EXIT_LOCAL = 2
EXIT_INTERRUPTED = 130
EXIT_OF: tuple[tuple[type[SpindeckError], int], ...] = (
    (LocalError, EXIT_LOCAL),
    (PeerSilentError, 3),
    (ConnectionLostError, 5),
    (PeerError, 4),
)
"""The first class that fits; the last one stands for whatever else a peer can do wrong."""

EXIT_CODES = """\
exit codes:
  0    done; also when Ctrl-C has ended a command that would otherwise have gone on for ever
  1    an error of this program: please report what it has printed
  2    wrong arguments, or a port, file or scenario that cannot be used: the message says what to do
  3    the robot, or a part of it, is silent
  4    the robot has refused, or has sent what makes no sense; of host doctor: something is wrong; of host usd: a log
       that cannot be read, is not whole, or has no answer; a config.txt with errors; of host sync:
       nothing that a time can be worked out from
  5    the connection ended before all that was wanted had come
  130  stopped with Ctrl-C before it was done
"""


FILES_FAULTS = (errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENAMETOOLONG)
"""Of a disk, or of a name that no file can have, wherever they show: no bug of this program."""


def parser() -> argparse.ArgumentParser:
    """The whole command line, without having imported numpy, rich or a port."""
    top = argparse.ArgumentParser(
        prog="host",
        description="Time-stamped camera streams from nano drones, real or simulated.",
    )
    top.add_argument("--version", action="store_true", help="print the version and exit")
    commands = top.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    stream.add_parser(commands)
    replay.add_parser(commands)
    recover.add_parser(commands)
    sim.add_parser(commands)
    ports.add_parser(commands)
    doctor.add_parser(commands)
    dissect.add_parser(commands)
    deck.add_parser(commands)
    usd.add_parser(commands)
    sync.add_parser(commands)
    firmware.add_parser(commands)
    list_exit_codes(top)
    return top


def list_exit_codes(parser: argparse.ArgumentParser) -> None:
    """At the end of each --help, those of subcommands too."""
    parser.epilog = f"{parser.epilog}\n{EXIT_CODES}" if parser.epilog else EXIT_CODES
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for command in action.choices.values():
                list_exit_codes(command)


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
        code = int(arguments.run(arguments))
        sys.stdout.flush()
        return code
    except SpindeckError as error:
        print(f"host: {error}", file=sys.stderr)
        return next(code for blame, code in EXIT_OF if isinstance(error, blame))
    except KeyboardInterrupt:
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # Whoever read our output has enough.
        forget_output()
        return 0
    except OSError as error:
        if error.errno not in FILES_FAULTS:
            raise
        named = f"{error.filename}: " if error.filename else ""
        print(f"host: {named}{error.strerror}", file=sys.stderr)
        if not named:
            forget_output()
        return EXIT_LOCAL


def forget_output() -> None:
    """Python would complain again when it flushes stdout at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
