"""What the packets of a capture say, and the messages on UART1.

Images and messages go over several packets: an Explainer is given the pieces of one capture in their order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from construct import ConstructError, Int8ul, Struct

from .dissect.buffers import Buffers
from .dissect.fields import Field, Meaning, data_field, fields_of, parsed_or_none, unreadable
from .dissect.piece import Framing, Piece
from .spec import control, cpx, image, native, paper, tables
from .spec.values import Value

MESSAGES: dict[int, tuple[str, Any]] = {
    1: ("native frame", native.FRAME),
    2: ("native data", native.DATA),
    3: ("native pairs", native.PAIRS),
    4: ("native status", native.STATUS),
    5: ("native reply", native.REPLY),
    6: ("native log", native.LOG),
    16: ("native stream request", native.STREAM),
    17: ("native camera request", native.CAMERA),
}
HEADERS: dict[str, Any] = {
    "stock image header": image.STOCK_HEADER,
    "image header of the paper's firmware": paper.HEADER,
}
STAMPS = {
    "stamp": "stamp message",
    "echo question": "question for an echo",
    "echo answer": "answer to it",
    "paper stamp": "time message of the paper's firmware",
    "nanocockpit state": "NanoCockpit's state",
    "nanocockpit noise": "NanoCockpit's random number",
    "nanocockpit ranges": "NanoCockpit's distances",
}
"""By the layout of a message on UART1."""
BY_COMMAND: dict[str, tuple[Any, tuple[Value, ...]]] = {
    "SYSTEM": (control.SYSTEM, control.SYSTEM_COMMANDS),
    "WIFI_CTRL": (control.WIFI_CTRL, control.WIFI_COMMANDS),
}
TEST = Struct("command" / Int8ul * "0 discard, 1 send back, 2 send many")
BOOTLOADER = Struct("command" / Int8ul * "6 starts the application")
NAMES = {function.number: function.name.removeprefix("CPX_") for function in cpx.FUNCTIONS}
TARGETS = {target.number: target.name.removeprefix("CPX_") for target in cpx.TARGETS}
UART_PIECE = 98
"""Longer data comes in pieces of this size on UART2."""


def target(number: int) -> str:
    """Who it is. A frame on UART2 with a good check may name nobody."""
    return TARGETS.get(number, f"nobody ({number})")


@dataclass
class Explainer:
    """`framing` says whether messages may come in pieces; `show_keys` whether the key of a network is shown."""

    framing: Framing
    show_keys: bool = False
    image_bytes: int = 0
    """Of the stock image under way; 0: none is."""
    image_got: int = 0
    native_low: int | None = None
    native_bytes: int = 0
    joined: bytes = b""
    joined_route: tuple[int, int] | None = None
    buffers: Buffers = field(default_factory=Buffers)

    def explain(self, piece: Piece) -> Meaning:
        """Of any piece."""
        if piece.kind == "garbage":
            self.joined, self.joined_route = b"", None  # a piece of the message may have been in it
        if piece.content is None:
            return Meaning(piece.about)
        if piece.kind == "stamp":
            return Meaning(STAMPS[piece.layout], list(fields_of(tables.LAYOUTS[piece.layout], piece.content)))
        route, data = piece.content.route, bytes(piece.content.data)
        name = NAMES.get(route.function, "")
        if route.version != cpx.VERSION or not name:
            return Meaning("no receiver knows what to do with it", data_field(data))
        if name == "APP":
            return self.app(route, data)
        if not data:
            return Meaning("without data: existing routers lose such packets")
        if name == "CONSOLE":
            return Meaning("console", [Field("text", data.rstrip(b"\0").decode("utf-8", "replace"), "")])
        if name == "CRTP":
            header = Field("port", data[0] >> 4, ""), Field("channel", data[0] & 3, "")
            return Meaning("CRTP", [*header, *data_field(data[1:])])
        if name in ("SYSTEM", "WIFI_CTRL"):
            return self.command(name, data)
        if name in ("TEST", "BOOTLOADER"):
            struct = TEST if name == "TEST" else BOOTLOADER
            return Meaning(name.lower(), [*fields_of(struct, struct.parse(data)), *data_field(data[1:])])
        if self.framing in ("nanocockpit", "nanocockpit-spi"):
            return self.buffers.explain(data)
        return Meaning("of NanoCockpit firmware", data_field(data))

    def command(self, function: str, data: bytes) -> Meaning:
        """The first byte is a command."""
        struct, commands = BY_COMMAND[function]
        try:
            parsed = struct.parse(data)
        except ConstructError as error:
            return unreadable(f"command 0x{data[0]:02X}", data, error)
        known = next((value for value in commands if value.number == parsed.command), None)
        if known is None:
            return Meaning(f"command 0x{data[0]:02X} is not known", data_field(data[1:]))
        name = known.name.partition("_")[2]
        fields = [Field("command", parsed.command, known.meaning, name)]
        argument = parsed.argument
        if name == "SET_KEY" and not self.show_keys:
            fields.append(Field("argument", None, "", f"{len(argument)} bytes, not shown (--show-keys)"))
        elif isinstance(argument, bytes):
            fields.append(Field("argument", argument.decode("utf-8", "replace"), ""))
        elif isinstance(argument, list):
            fields.append(Field("argument", ".".join(str(number) for number in argument), ""))
        elif argument is not None:
            fields.append(Field("argument", argument, ""))
        return Meaning(name, fields)

    def app(self, route: Any, data: bytes) -> Meaning:
        """The image stream and what belongs to it."""
        ends = (route.source, route.destination)
        if self.framing == "cpx-uart":
            data, waits = self.join(ends, route.last_packet, data)
            if waits:
                return Meaning(f"a message in pieces, {len(self.joined)} bytes so far")
        if (target(route.source), target(route.destination)) == ("GAP8", "HOST"):
            left = self.image_bytes - self.image_got
            for about, struct in HEADERS.items():
                header = None if len(data) == left else parsed_or_none(struct, data)
                if header is not None:
                    return self.image_header(about, struct, header)
            reply = len(data) == 4 and data[:2] == b"\x4e\x05"
            if left and (len(data) == left or not reply):
                return self.stock_body(len(data))
        if len(data) >= 2 and data[0] == 0x4E:
            return self.native(data)
        if target(route.destination) == "GAP8":
            settings = parsed_or_none(paper.CAMERA, data)
            if settings is not None:
                return Meaning("camera settings of the paper's firmware", list(fields_of(paper.CAMERA, settings)))
        return Meaning("no image is under way, and this begins none: the rest of one?", data_field(data))

    def join(self, ends: tuple[int, int], last: bool, data: bytes) -> tuple[bytes, bool]:
        """A native message that a router has cut for the UART: (all of it, False) with its last piece, and (b"", True)
        with the others."""
        goes_on = self.joined_route == ends and len(self.joined) + len(data) <= cpx.LIMITS[3].number
        begins = data[:1] == b"\x4e" and self.image_bytes == self.image_got
        if not goes_on:
            self.joined, self.joined_route = b"", None
        if not goes_on and not (begins and len(data) == UART_PIECE and not last):
            return data, False
        self.joined, self.joined_route = self.joined + data, ends
        if len(data) == UART_PIECE and not last:
            return b"", True
        whole, self.joined, self.joined_route = self.joined, b"", None
        return whole, False

    def image_header(self, about: str, struct: Any, header: Any) -> Meaning:
        """Of a new image, whatever became of the last one."""
        cut = self.image_bytes - self.image_got
        note = f"; the image before lacks {cut} of {self.image_bytes} bytes" if cut else ""
        self.image_bytes, self.image_got = header.size, 0
        return Meaning(f"{about}{note}", list(fields_of(struct, header)))

    def stock_body(self, size: int) -> Meaning:
        first, self.image_got = self.image_got, self.image_got + size
        total = self.image_bytes
        about = f"image body, bytes {first}..{self.image_got - 1} of {total}"
        if self.image_got > total:
            about += ": more than its header has announced"
        if self.image_got >= total:
            self.image_bytes = self.image_got = 0
        return Meaning(about + (", the last ones" if self.image_bytes == 0 else ""))

    def native(self, data: bytes) -> Meaning:
        """A message of the native dialect."""
        about, struct = MESSAGES.get(data[1], ("", None))
        if struct is None:
            return Meaning(f"native message of kind {data[1]}, which is not known", data_field(data))
        try:
            parsed = struct.parse(data)
        except ConstructError as error:
            return unreadable(about, data, error)
        if data[1] == 1:
            self.native_low, self.native_bytes = parsed.frame & 0xFFFF, parsed.body_bytes
        if data[1] == 2:
            end = parsed.offset + len(parsed.body)
            known = f" of {self.native_bytes}" if parsed.frame_low == self.native_low else ", its header is not here"
            about = f"native data of frame {parsed.frame_low}, bytes {parsed.offset}..{end - 1}{known}"
        return Meaning(about, list(fields_of(struct, parsed)))
