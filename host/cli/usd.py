"""`host usd`: logs of the µSD card."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from ..protocol.errors import LocalError, PeerError
from . import usd_config, usd_interpolate, usd_plot
from .usd_outputs import is_same, one_by_one, outputs
from .verb import add_verb

FILES = """\
FILE is a log as it lies on the card: version 2 or 1, or the format of 2019; or a log on a card's image (made with dd),
card.img:/log00. Damaged logs are read as far as anything in them can be trusted: verified rows are covered by a good
CRC, unverified rows only look right.
"""
INFO_EXAMPLES = """\
examples:
  host usd info log00
  host usd info card/log* --json
  host usd info card.img                  # the files on it
  host usd info card.img:/log00
"""
CHECK_EXAMPLES = """\
The exit code is 4 when a log is damaged, was not closed, or lacks rows, and 2 when a FILE could not be read. The clock
alone is no fault: it is a note.

examples:
  host usd check log00
  host usd check card/log* --json | grep damage
  host usd check card.img                 # all logs on it
  host usd check broken00 --header-of log01
"""
DECODE_EXAMPLES = """\
OUT's ending chooses the format:
  .csv      one file for each type of rows (OUT.fixedFrequency.csv ...); one file if there is only one type
  .parquet  the same; needs pyarrow: pip install 'spindeck[parquet]'
  .npz      a structured array for each type, and NAME.verified, NAME.epoch beside it
  .mcap     a topic for each type, as Foxglove plots them
Of several FILEs, or with a folder as OUT (it is there, or ends in /), each gets tables named after it, of the format
that --format says. Tables have the columns `epoch` (counts resets of the clock) and `verified`.

examples:
  host usd decode log00 -o flight.csv
  host usd decode log00 -o flight.npz --verified-only
  host usd decode broken00 --header-of log01 -o flight.csv
  host usd decode card/log* -o tables/ --format npz
"""
REPAIR_EXAMPLES = """\
OUT is a valid log of version 2, which older readers take too; a folder if there are several FILEs, which are only read.

examples:
  host usd repair log00 -o repaired00
  host usd repair broken00 --header-of log01 -o repaired00
  host usd repair card/log* -o repaired/
"""
HEADERLESS = """
A log whose beginning is lost or overwritten has no header, and nothing says what its rows are. --header-of OTHER reads
them as those of another log, which must be of the same config.txt and firmware: nothing in the rows tells whether it
is. Rows behind the first status row that is left are verified by the CRCs of those that follow; without status rows
none is.
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command, its subcommands and their options."""
    this = commands.add_parser(
        "usd",
        help="read, check, repair and plot logs of the µSD card",
        description="Read, check, repair and plot logs of the µSD card, and check what they are configured with.",
    )
    verbs = this.add_subparsers(dest="verb", metavar="VERB", title="verbs", required=True)
    more = f"\n\n{FILES}{HEADERLESS}"
    info = add_verb(verbs, "info", run_info, "say what is in a log", INFO_EXAMPLES, more)
    check = add_verb(verbs, "check", run_check, "say what is wrong with a log", CHECK_EXAMPLES, more)
    for each in (info, check):
        each.add_argument("files", metavar="FILE", nargs="+", help="a log")
    decode = add_verb(verbs, "decode", run_decode, "turn a log into tables", DECODE_EXAMPLES, more)
    repair = add_verb(
        verbs, "repair", run_repair, "write a valid log of all that is left of one", REPAIR_EXAMPLES, more
    )
    for each in (decode, repair):
        each.add_argument("files", metavar="FILE", nargs="+", help="a log")
        each.add_argument("-o", "--output", metavar="OUT", required=True, help="the new file, or a folder for them")
        each.add_argument("--force", action="store_true", help="overwrite what is there")
    for each in (info, check, decode, repair):
        each.add_argument("--header-of", metavar="OTHER", help="FILE has no header: take that of this log")
    formats = ("csv", "parquet", "npz", "mcap")
    decode.add_argument("--format", choices=formats, help="of tables in a folder (default csv)")
    decode.add_argument("--verified-only", action="store_true", help="leave out rows that no good CRC covers")
    usd_config.add_parser(verbs)
    usd_interpolate.add_parser(verbs)
    usd_plot.add_parser(verbs)


def run_info(arguments: argparse.Namespace) -> int:
    """0, unless nothing of a file can be read."""
    from ..usd.files import is_card, open_card
    from . import usd_card, usd_report
    from .as_json import line

    def info(name: str) -> int:
        if is_card(name):
            card = open_card(name)
            shown = [line(usd_card.as_record(name, card))] if arguments.json else usd_card.info_lines(name, card)
            print("\n".join(shown))
            return 0
        log, findings = load(name, header_of=arguments.header_of)
        warn_of_card(name)
        if arguments.json:
            print(line(usd_report.as_record(name, log, findings)))
        else:
            print("\n".join(usd_report.info_lines(name, log, findings)))
        return 0 if log.version else 4

    return one_by_one(arguments.files, info)


def run_check(arguments: argparse.Namespace) -> int:
    """0 if every log is whole and lacks nothing."""
    from ..usd.files import card_faults, logs_on
    from . import usd_report
    from .as_json import line

    def check(name: str) -> int:
        log, findings = load(name, header_of=arguments.header_of)
        faults, notes = usd_report.judge(log, findings)
        faults = [{"event": "card", "text": str(each), "sector": each.sector} for each in card_faults(name)] + faults
        if arguments.json:
            for record in [*faults, *notes]:
                print(line({"event": record["event"], "file": name, **record}))
            print(line({"event": "checked", "file": name, "good": not faults, "faults": len(faults)}))
        else:
            print("\n".join(usd_report.check_lines(name, log, faults, notes)))
        return 4 if faults else 0

    return one_by_one(arguments.files, lambda given: one_by_one(logs_on(given), check))


def run_decode(arguments: argparse.Namespace) -> int:
    """Writes the tables; 4 if nothing of a file can be read."""
    from . import usd_tables
    from .as_json import line

    made = outputs(arguments.files, arguments.output, f".{arguments.format or 'csv'}")
    if arguments.format and arguments.output in made.values():
        raise LocalError(
            f"--format {arguments.format}: for tables in a folder: write -o {arguments.output}/, or leave it out: the"
            " ending of one file chooses"
        )

    def decode(name: str) -> int:
        _, _, log = read_rows(name, arguments.header_of)
        written = usd_tables.write(log, made[name], arguments.verified_only, arguments.force)
        if arguments.json:
            print(line({"event": "decoded", "file": name, "written": written, **counts(log)}))
        else:
            for path, rows in written.items():
                print(f"{path}: {rows} rows")
        warn_of_card(name)
        warn(name, log)
        return 0

    return one_by_one(made, decode)


def run_repair(arguments: argparse.Namespace) -> int:
    """Writes the new logs; 4 if nothing of a file can be read."""
    from ..usd.files import split
    from ..usd.repair import repair
    from .as_json import line
    from .new_file import new_file

    made = outputs(arguments.files, arguments.output, "")

    def mend(name: str) -> int:
        source, header_of, log = read_rows(name, arguments.header_of)
        output = made[name]
        if any(is_same(output, split(each)[0]) for each in (*made, *filter(None, [arguments.header_of]))):
            raise LocalError(f"{output}: this is a log that is only read here: name another file with -o")
        repaired = repair(source, log, header_of)
        with new_file(output, arguments.force) as out:
            out.write(repaired)
        if arguments.json:
            print(line({"event": "repaired", "file": output, "size": len(repaired), **counts(log)}))
        else:
            lost = sum(each.size for each in log.damages)
            print(f"{output}: {log.row_count} rows, of which {log.verified_count} verified; {lost} bytes left out")
        warn_of_card(name)
        return 0

    return one_by_one(made, mend)


def load(name: str, examined: bool = True, header_of: str | None = None) -> tuple[Any, Any]:
    """A log and what its times say."""
    from ..usd.examine import examine

    log = read_as(name, header_of)[2]
    return log, examine(log) if examined else None


def read_rows(name: str, other: str | None) -> tuple[Any, Any, Any]:
    """As read_as(); PeerError if there are no rows."""
    source, header_of, log = read_as(name, other)
    if not log.row_count:
        raise_nothing(name, log)
    return source, header_of, log


def read_as(name: str, other: str | None) -> tuple[Any, Any, Any]:
    """The bytes of FILE, those of the log whose header it is read with if it is another's, and what is in it."""
    from ..usd.decode import decode
    from ..usd.files import read_log

    source = read_log(name)
    log = decode(source)
    if other is None:
        return source, None, log
    if log.is_whole or any(each.begin == 0 for each in log.verified):
        raise LocalError(f"{name} has a header, and its CRC is good: leave out --header-of")
    header_of = read_log(other)
    try:
        log = decode(source, header_of)
    except LocalError as error:
        raise LocalError(f"{other}: {error}") from None
    if not log.row_count:
        raise PeerError(f"{name}: no rows: nothing in it looks like rows of {other}: was the config.txt another one?")
    return source, header_of, log


def warn_of_card(name: str) -> None:
    """On stderr, of what is wrong on the card that a log lies on."""
    from ..usd.files import card_faults

    for fault in card_faults(name):
        print(f"{name}: {fault}", file=sys.stderr)


def counts(log: Any) -> dict[str, Any]:
    lost = sum(each.size for each in log.damages)
    return {"rows": log.row_count, "verified": log.verified_count, "lost_bytes": lost, "damages": log.damages}


def warn(name: str, log: Any) -> None:
    """On stderr, of a log that is not whole."""
    if not log.is_whole:
        unverified = log.row_count - log.verified_count
        print(
            f"{name}: not whole, {unverified} of {log.row_count} rows unverified: see 'host usd check'", file=sys.stderr
        )


def raise_nothing(name: str, log: Any) -> None:
    why = log.damages[0].why if log.damages else "the log is empty"
    way_out = " ('host usd repair --header-of OTHER' takes the header of a log of the same config.txt)"
    raise PeerError(f"{name}: no rows: {why}{way_out * (log.version is None and log.size > 0)}")
