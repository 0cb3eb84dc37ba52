"""`host usd interpolate`: where a robot was, and how it was turned, at times between the rows of its log."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, TypeVar

from ..protocol.errors import LocalError, PeerError
from ..protocol.typed import integer, real

if TYPE_CHECKING:
    from ..usd.interpolate import Poses
    from ..usd.log import Log
    from ..usd.track import Track
    from .usd_times import Times

Number = TypeVar("Number", int, float)
LAG_SIGMAS = 3.0
MEASURED = "measured"
EXAMPLES = """\
TIMES are in us of the STM32's stamp clock, the log's own: 12400000,12500000, or a file of such numbers, or - for
standard input, or a recording of host stream (.mcap), whose frames' STM32 times are taken.

Answers are CSV on stdout: time, position in m, attitude as a quaternion, and how far each may be off: by the gap
between the rows (from how the track bends around it), by the error of the time, and by that of the rows' stamps. What
the robot's estimate itself was off by is not in it; how late it was, host sync mocap can say, for --lag-us
(--lag-us measured asks it here; a lag that it refuses ends the command, with its reason and exit code). Where the
log does not say, `refused` says why, and there are no numbers:
  before, after   the log's rows end there: nothing is extrapolated
  hole            rows are missing: the gap is longer than --hole-us
  epoch           the clock was reset: the time lies in several epochs, or in none (--epoch N chooses)
  few             too few rows without a hole, to know the error
  unverified      a row that is needed has no good CRC (--unverified takes it)
  invalid         a row that is needed has no number in it, or no attitude
The exit code is 4 if no time has an answer.

examples:
  host usd interpolate log00 --at 12400000,12500000
  host usd interpolate log00 --at times.txt --source estPose --method cubic > poses.csv
  host usd interpolate log00 --at flight1.mcap --json
  host usd interpolate log00 --at paper.mcap --time-error-us 5000
  host usd interpolate log00 --at flight1.mcap --source estPose --lag-us 6500±400
  host usd interpolate log00 --at flight1.mcap --source estPose --lag-us measured
"""


def add_parser(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the verb and its options."""
    this = verbs.add_parser(
        "interpolate",
        help="say where the robot was at given times, or for each frame of a recording",
        description="Say where the robot was, and how it was turned, at given times, or for each frame of a recording.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    this.add_argument("file", metavar="LOG", help="a log")
    this.add_argument("--at", metavar="TIMES", required=True, help="times, a file of times, or a recording (.mcap)")
    this.add_argument(
        "--source", metavar="NAME", help="a group of variables or an event, as estPose (default: stateEstimate)"
    )
    this.add_argument(
        "--method",
        choices=("linear", "cubic"),
        default="linear",
        help="of positions; attitudes: slerp (default linear)",
    )
    this.add_argument(
        "--time-error-us",
        metavar="US",
        help="how far the times may be off (default 0; a frame's own bound comes first: only native frames have one)",
    )
    this.add_argument(
        "--row-error-us",
        metavar="US",
        help="how far the rows' stamps may be off (default 1000, or the rows' interval if some repeat the row before)",
    )
    this.add_argument(
        "--lag-us",
        metavar="LAG±SIGMA",
        help="how late the rows' poses are: that is set right, and 3 sigma widen the error; 'measured': by the gyro of"
        " LOG, as host sync mocap does",
    )
    this.add_argument("--hole-us", metavar="US", help="longest gap with an answer (default 2.5 times the usual)")
    this.add_argument("--epoch", metavar="N", help="only this one, as host usd info counts them (default: any)")
    this.add_argument("--robot", metavar="N", help="of the recording (default: its first)")
    this.add_argument("--unverified", action="store_true", help="use rows that no good CRC covers, too")
    this.add_argument("--json", action="store_true", help="JSON lines on stdout")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """0, or 4 if no time has an answer."""
    import numpy as np

    from ..usd.interpolate import interpolate
    from ..usd.track import read_track
    from .usd import load, raise_nothing, warn, warn_of_card
    from .usd_times import read_times

    log, _ = load(arguments.file, examined=False)
    if not log.row_count:
        raise_nothing(arguments.file, log)
    try:
        track = read_track(log, arguments.source)
    except LocalError as error:
        raise LocalError(f"{arguments.file}: {error}") from error
    robot = from_zero(arguments.robot, "--robot", integer, "a whole number")
    epoch = from_zero(arguments.epoch, "--epoch", integer, "a whole number")
    if epoch is not None and epoch >= len(log.epochs):
        raise LocalError(f"--epoch {epoch}: {arguments.file} has {len(log.epochs)}, counted from 0")
    time_error_us = from_zero(arguments.time_error_us, "--time-error-us", real, "microseconds,")
    row_error_us = from_zero(arguments.row_error_us, "--row-error-us", real, "microseconds,")
    hole_us = from_zero(arguments.hole_us, "--hole-us", real, "microseconds,")
    is_measured = arguments.lag_us == MEASURED
    lag_us, lag_sigma_us = (0.0, 0.0) if is_measured else lag(arguments.lag_us)
    times = read_times(arguments.at, robot)
    if time_error_us is None and np.isnan(times.bound_us).any():
        raise LocalError(f"{arguments.at}: its frames do not say how good their times are: say it with --time-error-us")
    if is_measured:
        lag_us, lag_sigma_us = measured(arguments.file, log, track, arguments.json)
    poses = interpolate(
        track,
        times.stm32_us,
        arguments.method,
        bound_us=with_own(times, time_error_us) + LAG_SIGMAS * lag_sigma_us,
        row_error_us=row_error_us,
        hole_us=hole_us,
        epoch=epoch,
        unverified=arguments.unverified,
        lag_us=lag_us,
    )
    write(poses, times, arguments.json)
    warn_of_card(arguments.file)
    warn(arguments.file, log)
    return report(poses, times, track.name)


def with_own(times: Times, time_error_us: float | None) -> Any:
    """A frame's own bound if it has one; of times that are typed, what was said."""
    import numpy as np

    if times.frames is None:
        return time_error_us or 0.0
    return np.where(np.isnan(times.bound_us), time_error_us or 0.0, times.bound_us)


def lag(text: str | None) -> tuple[float, float]:
    """The lag and its sigma, us."""
    if text is None:
        return 0.0, 0.0
    mean, sign, sigma = text.replace("+-", "±").partition("±")
    try:
        value = real(mean)
    except ValueError as error:
        raise LocalError(f"--lag-us {text}: a lag in us and its sigma, 6500±400 or 6500+-400, or measured") from error
    return value, from_zero(sigma if sign else "0", "--lag-us", real, "a sigma in us") or 0.0


def measured(file: str, log: Log, track: Track, as_json: bool) -> tuple[float, float]:
    """As lag(), by the gyro of the same log. PeerError where nothing is known of it."""
    import sys

    from ..clock.lag import Lag
    from .as_json import line
    from .sync_gyro import source_of
    from .sync_mocap import measure, records

    if track.attitude is None:
        raise PeerError(f"{file}: --lag-us measured: {track.name} has no attitude to lay over the gyro: give the lag")
    gyro = source_of(file, file, log)
    found = measure(track, gyro)
    if as_json:
        (record,) = records(file, gyro, {track.name: found})
        print(line(record))
    if not isinstance(found, Lag):
        raise PeerError(f"{file}: no lag of {track.name} is known: {found.why}")
    print(
        f"{track.name}: {found.behind_motion_us / 1000:+.3f} ± {found.sigma_us / 1000:.3f} ms behind the motion, by the"
        f" log's gyro: set right, and 3 sigma of it are in the errors",
        file=sys.stderr,
    )
    return found.behind_motion_us, found.sigma_us


def from_zero(text: str | None, option: str, read: Callable[[str], Number], what: str) -> Number | None:
    """What an option says; None if it is not given."""
    try:
        value = None if text is None else read(text)
        if value is not None and value < 0:
            raise ValueError
    except ValueError as error:
        raise LocalError(f"{option} {text}: {what} from 0 on") from error
    return value


def write(poses: Poses, times: Times, as_json: bool) -> None:
    from ..usd.interpolate import Refusal
    from .as_json import line

    words = [each.name.lower() if each else "" for each in Refusal]
    columns = dict(columns_of(poses, times))
    refused = [words[code] for code in poses.refusal.tolist()]
    if not as_json:
        print(",".join([*columns, "refused"]))
    for *values, why in zip(*columns.values(), refused, strict=True):
        if as_json:
            known = {name: value for name, value in zip(columns, values, strict=True) if value == value}
            print(line({"event": "pose", **known, "refused": why or None}))
        else:
            print(",".join([*(number(value) for value in values), why]))


def columns_of(poses: Poses, times: Times) -> Iterator[tuple[str, list[Any]]]:
    """A refused time has no numbers but its own."""
    if times.frames is not None:
        yield "frame", times.frames
    yield "stamp_stm32_us", [int(each) if each == int(each) else each for each in poses.at_us.tolist()]
    if poses.position_m is not None and poses.position_error_m is not None:
        yield from ((f"{axis}_m", poses.position_m[:, place].tolist()) for place, axis in enumerate("xyz"))
        yield "position_error_m", poses.position_error_m.tolist()
    if poses.attitude is not None and poses.attitude_error_rad is not None:
        yield from ((f"q{axis}", poses.attitude[:, place].tolist()) for place, axis in enumerate("xyzw"))
        yield "attitude_error_rad", poses.attitude_error_rad.tolist()
    yield "gap_us", poses.gap_us.tolist()


def number(value: float) -> str:
    """Nothing where there is none; more digits than the error warrants are no use."""
    return "" if value != value else str(value) if isinstance(value, int) else f"{value:.9g}"


def report(poses: Poses, times: Times, name: str) -> int:
    """On stderr; the exit code."""
    import sys

    from ..usd.interpolate import Refusal

    answered = int((poses.refusal == 0).sum())
    causes = [(each.name.lower(), int((poses.refusal == each).sum())) for each in Refusal if each]
    refused = ", ".join(f"{count} {cause}" for cause, count in causes if count)
    more = f"; {times.timeless} frames carry no STM32 time" if times.timeless else ""
    print(
        f"{name}: {answered} of {len(poses.refusal)} times answered{f'; refused: {refused}' if refused else ''}{more}",
        file=sys.stderr,
    )
    return 0 if answered else 4
