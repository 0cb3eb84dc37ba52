"""`host sync`: one clock's times on another, from recordings and logs."""

from __future__ import annotations

import argparse

from .verb import add_verb

STAMPS_EXAMPLES = """\
Native frames bring all messages with both clocks; NanoCockpit's bring one each. The times that are worked out from all
of them are those of the end of frame on the STM32's clock, with a bound that holds for 99 % of the frames, but for how
late the GAP8 reads its clock then. A frame for which nothing is known is refused, with the reason. Stock and paper
frames carry no times of messages: of these it says what can be repaired and what cannot (exit code 4).

OUT is a CSV file with a line for each frame; or, if its name ends in .mcap, a copy of the recording in which the topic
/robot0/restamped has the times beside all that was there. REC is only read.

examples:
  host sync stamps flight1.mcap
  host sync stamps flight1.mcap --apply flight1.csv --plot flight1.svg
  host sync stamps flight1.mcap --apply flight1-times.mcap
  host sync stamps flight1.mcap --robot 1 --json
"""
ROBOTS_EXAMPLES = """\
Logs with beacons (docs/PROTOCOL.md) are compared by these: each robot's clock is fitted against the host's too, and it
is found whether it counts 84 where 85 have passed.

Else the robots must have heard the same broadcasts of motion capture, and have logged what was in them: a variable that
only changes with a broadcast, in all logs the same values. It is found by itself, or named by --variable (a group, as
stateEstimate, or more names).

A reset of all clocks by one broadcast shows in logs that it came into; --reset says that it came before. By that
alone two clocks are the same at 0, but for the packets' spread and their drift since; who has missed it is named.
Beside beacons or motion capture it is said when each robot has carried it out, and with --reset-every-us which repeat.

Slopes are the second clock's seconds over the first one's, less 1, in ppm; offsets are second less first. For three
logs and more the closure says whether the slopes agree.

examples:
  host sync robots cf231_00 cf5_00 cf6_00
  host sync robots cf231_00 cf5_00 --reset
  host sync robots cf231_00 cf5_00 --variable stateEstimate.px,stateEstimate.py,stateEstimate.pz --json
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command, its subcommands and their options."""
    this = commands.add_parser(
        "sync",
        help="work out times on another clock afterwards",
        description="Work out times on another clock afterwards, from recordings and logs.",
    )
    verbs = this.add_subparsers(dest="verb", metavar="VERB", title="verbs", required=True)
    stamps = add_verb(verbs, "stamps", run_stamps, "give each frame of a recording its STM32 time", STAMPS_EXAMPLES)
    stamps.add_argument("file", metavar="REC", help="a recording (host stream --record)")
    stamps.add_argument("--robot", metavar="N", type=int, help="only this robot's; without it, all")
    stamps.add_argument("--apply", metavar="OUT", help="write the times: a .csv, or a copy as .mcap")
    stamps.add_argument("--plot", metavar="FILE", help="draw delays, drift and bound: .svg or .png")
    stamps.add_argument("--force", action="store_true", help="overwrite OUT and FILE")
    robots = add_verb(verbs, "robots", run_robots, "compare the clocks of robots by their logs", ROBOTS_EXAMPLES)
    robots.add_argument("files", metavar="LOG", nargs="+", help="µSD logs of one run, two or more")
    robots.add_argument("--reset", action="store_true", help="one broadcast had set all clocks to 0 before these logs")
    robots.add_argument(
        "--reset-every-us",
        dest="every_us",
        metavar="N",
        type=float,
        help="so long from repeat to repeat of that broadcast",
    )
    robots.add_argument("--variable", metavar="NAMES", help="what was broadcast: variables, joined by commas")


def run_stamps(arguments: argparse.Namespace) -> int:
    from . import sync_stamps

    return sync_stamps.run(arguments)


def run_robots(arguments: argparse.Namespace) -> int:
    from . import sync_robots

    return sync_robots.run(arguments)
