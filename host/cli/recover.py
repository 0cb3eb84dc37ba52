"""`host recover`: a recording that was cut off, made whole."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from ..protocol.errors import LocalError

EXAMPLES = """\
FILE is only read. Every message of every chunk that was written completely is kept: a recording that was killed loses
less than its last 250 ms.

examples:
  host recover flight1.mcap                   makes flight1.recovered.mcap
  host recover flight1.mcap -o whole.mcap
"""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "recover",
        help="make a recording whole that was cut off",
        description="Copy all that is whole in a recording into a new one, and say what was lost.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    this.add_argument("file", metavar="FILE", help="a recording (MCAP), cut off or damaged")
    this.add_argument("-o", "--output", metavar="OUT", help="the new file (default: FILE with .recovered in its name)")
    this.add_argument("--json", action="store_true", help="one JSON object on stdout")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Recovers and reports."""
    from ..link.recover import recover
    from .as_json import line

    source = Path(arguments.file)
    if source.is_dir():
        raise LocalError(f"{arguments.file}: a folder: name one recording in it")
    target = arguments.output or str(source.with_name(f"{source.stem}.recovered{source.suffix or '.mcap'}"))
    found = recover(str(source), target)
    if arguments.json:
        print(line({"event": "recovered", "file": target, **dataclasses.asdict(found)}))
        return 0
    print(f"file        {target}")
    print(f"kept        {sum(found.messages.values())} messages in {found.chunks} chunks")
    for topic, count in sorted(found.messages.items()):
        print(f"            {count} {topic}")
    for damage in found.damage:
        print(f"lost        {damage.size} bytes from byte {damage.offset} on: {damage.why}")
    if found.left_out:
        print(f"left out    {found.left_out} attachments and metadata records")
    if not found.damage:
        print("lost        nothing" + ("" if found.has_end else ": cut off between two records"))
    return 0
