"""`host usd plot`: a picture of a log's variables over time, with what is missing in it."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from ..protocol.errors import LocalError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from ..usd.drawing import Shape
    from ..usd.log import Log
    from ..usd.plot import Curve

EXAMPLES = """\
NAME is a variable, as stateEstimate.x, or a group, as gyro, all of whose variables share a panel; TYPE:NAME where
several types of rows have it, as estPose:locSrv.x. Names joined by commas share a panel. OUT ends in .svg or .png.

Holes, rows that the logger dropped, rows that no good CRC covers, and resets of the clock are marked. Rows that do not
come regularly are dots. The range of a panel is that of its verified rows; others that are far off lie on its border.

examples:
  host usd plot log00 stateEstimate.x gyro.z -o flight.svg
  host usd plot log00 stateEstimate.x,stateEstimate.y gyro pm.vbatMV -o flight.png
  host usd plot log00 acc --from-us 12400000 --to-us 12900000 -o takeoff.svg
  host usd plot log00 gyro --also log01 log02 -o pictures/        # a picture of each
"""


def add_parser(verbs: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the verb and its options."""
    this = verbs.add_parser(
        "plot",
        help="draw variables over time, with holes, drops and resets",
        description="Draw variables of a log over time, with its holes, drops and resets of the clock.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    this.add_argument("file", metavar="LOG", help="a log")
    this.add_argument("names", metavar="NAME", nargs="+", help="a variable, or a group of them")
    this.add_argument("-o", "--output", metavar="OUT", required=True, help="the picture: .svg or .png, or a folder")
    this.add_argument("--also", metavar="LOG", nargs="+", default=[], help="the same of these: OUT is a folder")
    this.add_argument("--from-us", metavar="US", help="begin here, on the stamp clock")
    this.add_argument("--to-us", metavar="US", help="end here")
    this.add_argument("--force", action="store_true", help="overwrite what is there")
    this.add_argument("--json", action="store_true", help="JSON lines on stdout")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Draws the pictures; 4 if nothing of a log can be read."""
    from .usd_outputs import one_by_one, outputs

    made = outputs([arguments.file, *arguments.also], arguments.output, ".svg")
    return one_by_one(made, lambda name: draw(arguments, name, made[name]))


def draw(arguments: argparse.Namespace, name: str, output: str) -> int:
    from ..usd.plot import CURVES_MAX, PANELS_MAX, plot
    from .as_json import line
    from .new_file import new_file
    from .usd import load, raise_nothing, warn, warn_of_card
    from .usd_config import counted
    from .usd_report import state

    write = picture_writer(output)
    first, last = bound(arguments.from_us, "--from-us", -math.inf), bound(arguments.to_us, "--to-us", math.inf)
    log, findings = load(name)
    if not log.row_count:
        raise_nothing(name, log)
    try:
        panels = [[curve for asked in names.split(",") for curve in curves(log, asked)] for names in arguments.names]
        if len(panels) > PANELS_MAX:
            raise LocalError(f"{len(panels)} panels, and {PANELS_MAX} fit: join some names by commas")
        if len(most := max(panels, key=len)) > CURVES_MAX:
            raise LocalError(f"{len(most)} variables in one panel, and {CURVES_MAX} fit: name some of them")
        title = f"{Path(name).name}: {log.row_count} rows, {state(log)}"
        width, height, shapes = plot(log, findings, panels, title, first, last)
    except LocalError as error:
        raise LocalError(f"{name}: {error}") from error
    with new_file(output, arguments.force) as file:
        file.write(write(width, height, shapes))
    drawn = [[curve.variable for curve in panel] for panel in panels]
    if arguments.json:
        print(line({"event": "plotted", "file": name, "output": output, "panels": drawn}))
    else:
        print(f"{output}: {counted(sum(map(len, drawn)), 'variable')} in {counted(len(drawn), 'panel')}")
    warn_of_card(name)
    warn(name, log)
    return 0


def bound(text: str | None, option: str, otherwise: float) -> float:
    from ..protocol.typed import real

    try:
        return otherwise if text is None else real(text)
    except ValueError as error:
        raise LocalError(f"{option} {text}: microseconds of the stamp clock, as 12400000") from error


def picture_writer(output: str) -> Callable[[int, int, Sequence[Shape]], bytes]:
    """Of the format that a file's name asks for. LocalError if that is none."""
    from ..usd import drawing

    writers = {".svg": drawing.svg, ".png": drawing.png}
    writer = writers.get(Path(output).suffix.lower())
    if writer is None:
        raise LocalError(f"{output}: its ending chooses the format: {', '.join(writers)}")
    return writer


def curves(log: Log, asked: str) -> list[Curve]:
    """The variables that a name means. LocalError when there are none, or of several types."""
    from ..usd.plot import Curve

    of_type, _, name = asked.removesuffix(".*").rpartition(":")
    if not name:
        raise LocalError(f"{asked or ','}: a name is empty: write variables or groups, apart by single commas")
    if of_type and of_type not in log.rows:
        raise LocalError(f"{asked}: no type of rows {of_type} in it{near(of_type, list(log.rows))}")
    found = [
        Curve(rows, each.name)
        for rows in log.rows.values()
        if not of_type or rows.type.name == of_type
        for each in rows.type.variables
        if name in (each.name, each.name.rpartition(".")[0])
    ]
    types = sorted({curve.rows.type.name for curve in found})
    if len(types) > 1:
        raise LocalError(f"{asked}: in several types of rows: write {' or '.join(f'{each}:{name}' for each in types)}")
    if found and not len(found[0].rows):
        raise LocalError(f"{asked}: the log has no rows of {types[0]}")
    if not found:
        there = {each.name for rows in log.rows.values() for each in rows.type.variables}
        groups = {each.rpartition(".")[0] for each in there} - {""}
        raise LocalError(f"no variable {asked} in it{near(name, sorted(there | groups))}")
    return found


def near(name: str, there: list[str]) -> str:
    import difflib

    same = [each for each in there if each.lower() == name.lower()]
    found = same or difflib.get_close_matches(name, there, n=3, cutoff=0.6)
    return f": did you mean {' or '.join(found)}?" if found else ": 'host usd info' lists what there is"
