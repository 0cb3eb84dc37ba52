"""`host sync`: one clock's times on another, from recordings and logs; and the beacons that make that possible."""

from __future__ import annotations

import argparse

from .row import row
from .verb import add_verb

STAMPS_EXAMPLES = """\
Native frames bring all messages with both clocks; NanoCockpit's bring one each. The times that are worked out from all
of them are those of the end of frame on the STM32's clock, with a bound that holds for 99 % of the frames. Of frames at
an even pace, 50 or more, it is found out how late the GAP8 read its clock. A frame for which nothing is known is
refused, with the reason. Stock and paper frames carry no times of messages: of these it says what can be repaired and
what cannot (exit code 4).

OUT is a CSV file with a line for each frame; or, if its name ends in .mcap, a copy of the recording in which the topic
/robot0/restamped has the times beside all that was there. REC is only read.

examples:
  host sync stamps flight1.mcap
  host sync stamps flight1.mcap --apply flight1.csv --plot flight1.svg
  host sync stamps flight1.mcap --apply flight1-times.mcap
  host sync stamps flight1.mcap --apply flight1.csv --row middle
  host sync stamps flight1.mcap --robot 1 --json
"""
ROBOTS_EXAMPLES = """\
Logs with beacons ('host sync beacons' sends them) are compared by these: each robot's clock is fitted against the
host's too, and it is found whether it counts 84 where 85 have passed. The host's own log may stand among them.

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
  host sync robots host00 cf231_00 cf5_00
  host sync robots cf231_00 cf5_00 --reset --plot clocks.svg
  host sync robots cf231_00 cf5_00 --variable stateEstimate.px,stateEstimate.py,stateEstimate.pz --json
"""
CAMERA_EXAMPLES = """\
The robot, its camera running and its gyro logged (gyro.x, gyro.y, gyro.z, 500 Hz or more), is turned to and fro by
hand, quickly, for 20 s or more, in front of things that are some metres away. How far pictures have moved is fitted to
the integral of the gyro, each row at its own time. The offset is what has to be added to a frame's time to have the
log's; sigma is one standard deviation. Beside it stands what the dataset paper did: the first frame that has moved.

Frames of native firmware say how long rows and exposure take; for others give --line-time-us and --exposure-us, or the
offset is that of the middle row's middle of exposure. The Crazyflie filters its gyro, which makes it 4.5 ms late (4.1
to 4.9: of one filter little more than the bandwidth is known): that is taken off. With too little rotation or texture
there is a reason instead of an offset (exit code 4).

examples:
  host sync camera turned.mcap log00
  host sync camera turned.mcap log00 --plot turned.svg --json
  host sync camera paper.mcap log00 --line-time-us 125.3 --exposure-us 12500
"""

GYRO_EXAMPLES = """\
The robots must have been fixed on one board that was rocked and struck, and have logged gyro.x, gyro.y and gyro.z, best
at 1 kHz and synchronously (mode 1). Shifts are the second clock less the first; the slope is the second clock's seconds
over the first one's, less 1, in ppm. How sure they are comes from leaving out each impact in turn. With too little
rotation, or robots that did not turn as one, there is a reason instead (exit code 4). Beside it: what the dataset
paper's procedure gives.

examples:
  host sync gyro cf1_00 cf2_00
  host sync gyro cf1_00 cf2_00 --plot shift.svg --json
"""

MOCAP_EXAMPLES = """\
How late motion capture's attitudes are (locSrv.qx to .qw on:estPose), and stateEstimate's, by the gyro of the same log
(gyro.x to .z, best at 500 Hz or more): where both turn alike, only later. With too little rotation, or an even one,
there is a reason instead; exit code 4 if that holds for all.

examples:
  host sync mocap log00
  host sync mocap log00 --source estPose --plot lag.svg --json
"""

BEACONS_EXAMPLES = """\
PORT is a Crazyradio (PA or 2.0) on the robots' channel, radio://DONGLE/CHANNEL/RATE: which of those plugged in, from 0,
or its serial number; 0 to 100; 1M or 2M. It needs pyusb (pip install 'spindeck[radio]') and a dongle of its own: a
program that flies robots keeps its. All robots on that channel hear; those whose app logs beacons (docs/DESIGN.md) have
on:beacon in config.txt. sim://SCENARIO sends to simulated robots, without a dongle.

FILE is the host's own log, as a µSD log with its clock: what was sent, and when the dongle had it. It tells 'host sync
robots', given among the robots' logs, which beacons were slow to the dongle, and takes that way off the robots' offsets
to the host. Ctrl-C, or a dongle that is pulled out, ends the log: what was sent is in it.

examples:
  host sync beacons --port radio://0/80/2M --log host00
  host sync beacons --port radio://0/80/2M --hz 1 --duration 1800 --reset
  host sync beacons --port sim://swarm --duration 10
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command, its subcommands and their options."""
    this = commands.add_parser(
        "sync",
        help="work out times on another clock afterwards; send beacons for it",
        description="Work out times on another clock afterwards, from recordings and logs; send beacons for it.",
    )
    verbs = this.add_subparsers(dest="verb", metavar="VERB", title="verbs", required=True)
    stamps = add_verb(verbs, "stamps", run_stamps, "give each frame of a recording its STM32 time", STAMPS_EXAMPLES)
    stamps.add_argument("file", metavar="REC", help="a recording (host stream --record)")
    stamps.add_argument("--robot", metavar="N", type=int, help="only this robot's; without it, all")
    stamps.add_argument("--apply", metavar="OUT", help="write the times: a .csv, or a copy as .mcap")
    stamps.add_argument(
        "--row",
        metavar="ROW",
        type=row,
        help="write the time of the middle of this row's exposure too (row_stm32_us, of native frames): its number, "
        "or first, middle, last",
    )
    stamps.add_argument("--plot", metavar="FILE", help="draw delays, drift, bound and flags: .svg or .png")
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
    robots.add_argument("--plot", metavar="FILE", help="draw what is left of each, and the bounds: .svg or .png")
    robots.add_argument("--force", action="store_true", help="overwrite FILE")
    robots.add_argument("--variable", metavar="NAMES", help="what was broadcast: variables, joined by commas")
    beacons = add_verb(verbs, "beacons", run_beacons, "broadcast this host's clock to all robots", BEACONS_EXAMPLES)
    beacons.add_argument("--port", metavar="PORT", required=True, help="radio://DONGLE/CHANNEL/RATE, or sim://SCENARIO")
    beacons.add_argument("--hz", metavar="N", type=float, default=4.0, help="so many a second, 1 to 10 (default 4)")
    beacons.add_argument("--duration", metavar="S", type=float, help="end after S seconds; without it, with Ctrl-C")
    beacons.add_argument("--reset", action="store_true", help="first set the clocks of all that hear it to 0, once")
    beacons.add_argument("--log", metavar="FILE", help="what was sent and when, in a new file")
    camera = add_verb(verbs, "camera", run_camera, "compare frames with the gyro's log of their robot", CAMERA_EXAMPLES)
    camera.add_argument("file", metavar="REC", help="a recording (host stream --record)")
    camera.add_argument("log", metavar="LOG", help="the µSD log of the same robot and run")
    camera.add_argument("--robot", metavar="N", type=int, help="which of the recording's robots")
    camera.add_argument("--own-times", action="store_true", help="the robot's estimates, not those of 'sync stamps'")
    camera.add_argument("--line-time-us", metavar="US", type=float, help="from row to row, where frames do not say it")
    camera.add_argument("--exposure-us", metavar="US", type=float, help="likewise")
    camera.add_argument("--raw-gyro", action="store_true", help="the log's gyro went through no filters")
    camera.add_argument("--within-ms", metavar="MS", type=float, default=500.0, help="how far off it may be (500)")
    camera.add_argument("--plot", metavar="FILE", help="draw search, residuals and parts: .svg or .png")
    camera.add_argument("--force", action="store_true", help="overwrite FILE")
    gyro = add_verb(
        verbs, "gyro", run_gyro, "compare the clocks of two robots on one board by their gyros", GYRO_EXAMPLES
    )
    gyro.add_argument("first", metavar="A", help="a µSD log with the gyro in it")
    gyro.add_argument("second", metavar="B", help="the other robot's, of the same time")
    gyro.add_argument("--plot", metavar="FILE", help="draw both gyros, what is left, each event: .svg or .png")
    gyro.add_argument("--force", action="store_true", help="overwrite FILE")
    mocap = add_verb(verbs, "mocap", run_mocap, "say how late a log's attitudes are, by its gyro", MOCAP_EXAMPLES)
    mocap.add_argument("file", metavar="LOG", help="a µSD log with attitudes and the gyro in it")
    mocap.add_argument("--source", metavar="NAME", help="only this group of variables, or event")
    mocap.add_argument("--plot", metavar="FILE", help="draw what is left over time: .svg or .png")
    mocap.add_argument("--force", action="store_true", help="overwrite FILE")


def run_camera(arguments: argparse.Namespace) -> int:
    from . import sync_camera

    return sync_camera.run(arguments)


def run_stamps(arguments: argparse.Namespace) -> int:
    from . import sync_stamps

    return sync_stamps.run(arguments)


def run_robots(arguments: argparse.Namespace) -> int:
    from . import sync_robots

    return sync_robots.run(arguments)


def run_beacons(arguments: argparse.Namespace) -> int:
    from . import sync_send

    return sync_send.run(arguments)


def run_gyro(arguments: argparse.Namespace) -> int:
    from . import sync_gyro

    return sync_gyro.run(arguments)


def run_mocap(arguments: argparse.Namespace) -> int:
    from . import sync_mocap

    return sync_mocap.run(arguments)
