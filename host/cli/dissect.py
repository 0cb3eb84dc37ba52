"""`host dissect`: captured bytes, packet by packet, from the specification."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..protocol.errors import LocalError, PeerError
from ..protocol.typed import integer

if TYPE_CHECKING:
    from ..protocol.dissect.fields import Field, Meaning
    from ..protocol.dissect.piece import Framing, Piece

EXAMPLES = """\
input:
  the bytes of one direction of one wire, as a sniffer, a logic analyser or socat -x have them; FILE or - (stdin)
  --hex: text with two digits a byte, spaces as you like; also what xxd and hexdump -C print
  FILE.mcap: what a recording has received (host stream --record); --robot N chooses which

framings (guessed when not given):
  tcp              CPX over TCP, port 5000: length, route, data
  nanocockpit      NanoCockpit over TCP: likewise, but the length leaves out the route, and packets are longer
  cpx-uart         UART2: FF, length, route, data, check; credits
  stamps           UART1: the time messages of native firmware, of the paper's and of NanoCockpit's
  spi              one line of the SPI between GAP8 and ESP32
  nanocockpit-spi  likewise, with NanoCockpit's packets
Stock, paper and native firmware share CPX: which one it is, each packet says.

examples:
  host dissect capture.bin
  echo "ff 04 0a 04 20 01 d4" | host dissect - --hex
  host dissect flight1.mcap --json | grep wifi
"""
FRAMINGS: list[Framing] = ["tcp", "nanocockpit", "cpx-uart", "stamps", "spi", "nanocockpit-spi"]
GARBAGE_SHOWN = 16
LIKELY = 0.02
"""Less than this is found in random bytes too."""


def add_parser(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Declares the command and its options."""
    this = commands.add_parser(
        "dissect",
        help="explain captured bytes, packet by packet",
        description="Explain captured bytes, packet by packet: where each is, its route, what it says. Every byte is "
        "accounted for; garbage is located and explained.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    add = this.add_argument
    add("file", metavar="FILE", help="the capture; - for stdin")
    add("--framing", choices=FRAMINGS, help="what the bytes are (default: guessed)")
    add("--hex", action="store_true", help="FILE is hexadecimal text")
    add("--robot", type=integer, metavar="N", help="of a recording (default: its first)")
    add("--brief", action="store_true", help="one line a packet, without its fields")
    add("--show-keys", action="store_true", help="show keys of wireless networks in the clear")
    add("--json", action="store_true", help="JSON lines: each piece, then a summary")
    this.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Reads, splits, explains, prints."""
    try:
        from ..protocol import dissect, explain
    except ModuleNotFoundError as error:
        if error.name not in ("construct", "crcmod"):
            raise
        raise LocalError(
            f"host dissect needs {error.name}, which is not installed: pip install 'spindeck[spec]'"
        ) from error
    data, framings = read(arguments)
    if not data:
        raise LocalError(f"{arguments.file}: empty: there is not one byte to dissect")
    framing = framings[0]
    if len(framings) > 1:
        framing, part = dissect.guess(data, framings)
        explains = f"it explains {part:.0%} of the first bytes" if part >= LIKELY else "and nothing looks like it"
        print(f"framing {framing}, guessed, {explains}", file=sys.stderr)
    explainer = explain.Explainer(framing, arguments.show_keys)
    total = Summary(framing)
    for piece in dissect.split(data, framing):
        meaning = explainer.explain(piece)
        name = piece.layout or piece.kind
        if piece.kind == "packet":
            name = explain.NAMES.get(piece.content.route.function, "unknown")
        total.add(piece, name)
        if arguments.json:
            print(line(record(piece, name, meaning, data)))
        else:
            print_piece(piece, name, meaning, data, arguments.brief)
    total.print(as_json=arguments.json)
    sys.stdout.flush()  # before the error
    garbage = total.garbage
    if garbage is not None and total.understood < LIKELY * len(data):
        raise PeerError(
            f"{arguments.file}: {total.bytes['garbage']} of {len(data)} bytes are garbage, from byte {garbage.offset} "
            f"on: {garbage.about}. {tried(data, framings)}"
        )
    return 0


def tried(data: bytes, framings: list[Framing]) -> str:
    """What the bytes were taken for, and what else they may be."""
    from ..protocol import dissect

    if len(framings) > 1:
        return f"Tried: {', '.join(framings)}"
    best, part = dissect.guess(data)
    if part >= LIKELY:
        return f"Read as {framings[0]}; they look like {best}: --framing {best}"
    return f"Tried: {framings[0]} as told, and {', '.join(each for each in dissect.SPLITTERS if each != framings[0])}"


def read(arguments: argparse.Namespace) -> tuple[bytes, list[Framing]]:
    """The captured bytes and what they may be. LocalError when they cannot be had."""
    told: list[Framing] = [arguments.framing] if arguments.framing else []
    if arguments.file.endswith(".mcap"):
        from ..link.replay import Recording

        recording = Recording(arguments.file)
        try:
            source = recording.source(arguments.robot)
            may_be: list[Framing] = ["tcp", "nanocockpit"] if source.framing == "tcp" else [source.framing]
            reads = (data for _, data in recording.reads(source) if not isinstance(data, str))
            return b"".join(reads), told or may_be
        finally:
            recording.close()
    if arguments.robot is not None:
        raise LocalError("--robot is for recordings (FILE.mcap): other captures are of one wire")
    try:
        raw = sys.stdin.buffer.read() if arguments.file == "-" else Path(arguments.file).read_bytes()
    except OSError as error:
        raise LocalError(f"{arguments.file}: {error.strerror}") from error
    data = from_hex(raw.decode("utf-8", "replace"), arguments.file) if arguments.hex else raw
    return data, told or list(FRAMINGS)


def from_hex(text: str, name: str) -> bytes:
    """Two digits a byte. Offsets (xxd, hexdump -C) at the start of a line and what they print behind are left out."""
    import re

    out = bytearray()
    hexdump = False
    for number, whole in enumerate(text.splitlines(), 1):
        digits = re.sub(r"#.*", "", whole)
        digits = re.sub(r"^\s*[0-9a-fA-F]{4,}:(.*?)(  .*)?$", r"\1", digits)
        if barred := re.match(r"^[0-9a-fA-F]{7,8}  ([^|]*)\|.*\|\s*$", whole):
            digits, hexdump = barred[1], True
        elif hexdump and re.match(r"^[0-9a-fA-F]{7,8}\s*$", whole):
            continue  # its end: the size
        digits = re.sub(r"0[xX]|[\s,:]", "", digits)
        try:
            out += bytes.fromhex(digits)
        except ValueError as error:
            raise LocalError(
                f"{name}, line {number}: {whole.strip()[:40]!r} is not pairs of hexadecimal digits"
            ) from error
    return bytes(out)


class Summary:
    """Counts at the end: all pieces together are all bytes."""

    def __init__(self, framing: Framing) -> None:
        self.framing = framing
        self.bytes: Counter[str] = Counter()
        self.pieces: Counter[str] = Counter()
        self.garbage: Piece | None = None
        """The first."""
        self.understood = 0
        """Bytes: all but garbage and what is cut off at the end."""

    def add(self, piece: Piece, name: str) -> None:
        if piece.kind == "garbage":
            self.garbage = self.garbage or piece
        elif piece.kind != "truncated":
            self.understood += piece.size
        self.bytes[name] += piece.size
        self.pieces[name] += 1

    def print(self, as_json: bool) -> None:
        if as_json:
            of = {name: {"pieces": count, "bytes": self.bytes[name]} for name, count in sorted(self.pieces.items())}
            print(line({"event": "summary", "framing": self.framing, "bytes": self.bytes.total(), "of": of}))
            return
        print(f"{self.bytes.total()} bytes, {self.framing}:")
        for name, count in sorted(self.pieces.items(), key=lambda item: -self.bytes[item[0]]):
            print(f"{self.bytes[name]:>12} bytes in {count} {name}")


def line(made: dict[str, Any]) -> str:
    """One line of JSON."""
    from . import as_json

    return as_json.line(made)


def record(piece: Piece, name: str, meaning: Meaning, data: bytes) -> dict[str, Any]:
    """A piece for a program."""
    made: dict[str, Any] = {"event": piece.kind, "offset": piece.offset, "size": piece.size}
    if piece.kind == "packet":
        made["route"] = {key: value for key, value in piece.content.route.items() if not key.startswith("_")}
        made["function"] = name
    made["about"] = meaning.about
    if piece.kind == "garbage":
        made["hex"] = data[piece.offset : piece.offset + GARBAGE_SHOWN].hex()
    if meaning.fields:
        made["fields"] = {each.name: each.value for each in meaning.fields}
    return made


def print_piece(piece: Piece, name: str, meaning: Meaning, data: bytes, brief: bool) -> None:
    """A piece for people."""
    print(f"{piece.offset:>10} {piece.size:>6}  {headline(piece, name, meaning)}")
    if piece.kind == "garbage":
        shown = data[piece.offset : piece.offset + min(piece.size, GARBAGE_SHOWN)]
        print(f"{'':19}{shown.hex(' ')}{' …' if piece.size > GARBAGE_SHOWN else ''}")
    if brief:
        return
    for each in meaning.fields:
        for text in field_lines(each):
            print(f"{'':19}{text}")


def headline(piece: Piece, name: str, meaning: Meaning) -> str:
    from ..protocol.explain import target

    if piece.kind != "packet":
        return f"{piece.kind}{': ' * bool(meaning.about)}{meaning.about}"
    route = piece.content.route
    marks = [mark for mark, set_ in (("last", route.last_packet), ("reserved bit", route.reserved)) if set_]
    if route.version:
        marks.append(f"version {route.version}")
    notes = f" ({', '.join(marks)})" if marks else ""
    return f"{target(route.source)} to {target(route.destination)}, {name}{notes}: {meaning.about}"


def field_lines(each: Field) -> Iterator[str]:
    """A field and its meaning; a list, one of its rows a line."""
    if isinstance(each.value, list):
        rows = [row for row in each.value if isinstance(row, dict)]
        numbers = [str(number) for number in each.value if not isinstance(number, dict)]
        for row in rows:
            yield ", ".join(f"{name} {value}" for name, value in row.items())
        if numbers:
            yield f"{each.name:<18} {' '.join(numbers):<22} {each.meaning}".rstrip()
        return
    value = each.words if each.value is None else f"{each.value}{f' {each.words}' * bool(each.words)}"
    yield f"{each.name:<18} {value:<22} {each.meaning}".rstrip()
