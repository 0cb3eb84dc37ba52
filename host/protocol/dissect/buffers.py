"""NanoCockpit's buffers: images and the answers to them, which go over several packets, with a check of the whole."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from construct import ConstructError

from ..spec import nanocockpit
from .fields import CODES, Field, Meaning, data_field, fields_of, parsed_or_none, unreadable

BEGIN, MORE = (command.number for command in nanocockpit.COMMANDS)
IMAGE, INFERENCE = (kind.number for kind in nanocockpit.TYPES)
NAMES = {IMAGE: "image", INFERENCE: "answer to a frame"}
CONTENTS: dict[int, Any] = {IMAGE: nanocockpit.METADATA, INFERENCE: nanocockpit.REPLY}
PADDING_MAX = nanocockpit.LIMITS[2].number


@dataclass
class Buffers:
    """Follows them over the packets of one capture."""

    name: str = ""
    size: int = 0
    """Of the one under way; 0: none is."""
    check: int = 0
    got: bytearray = field(default_factory=bytearray)

    def explain(self, data: bytes) -> Meaning:
        """Of a packet of function STREAMER."""
        if data[0] == BEGIN:
            return self.begin(data)
        head = parsed_or_none(nanocockpit.MORE, data)
        if data[0] == MORE and head is not None:
            rest = data[nanocockpit.MORE.sizeof() :]
            if not self.size:
                return Meaning("no buffer is under way, and this begins none: the rest of one?", data_field(rest))
            return Meaning(f"{self.name}, {self.take(rest)}")
        return Meaning(f"command 0x{data[0]:02X} is not known" if head is None else "too short", data_field(data))

    def begin(self, data: bytes) -> Meaning:
        """A new buffer, whatever became of the last one."""
        try:
            head = nanocockpit.BEGIN.parse(data)
        except ConstructError as error:
            return unreadable("a buffer begins", data, error)
        missing = self.size - len(self.got)
        note = f"; the buffer before lacks {missing} of {self.size} bytes" if self.size else ""
        self.name = NAMES.get(head.type, f"buffer of type 0x{head.type:02X}, which is not known")
        self.size, self.check, self.got = head.size, head.check, bytearray()
        rest = data[nanocockpit.BEGIN.sizeof() :]
        fields = list(fields_of(nanocockpit.BEGIN, head, {"type": nanocockpit.TYPES}))
        layout = CONTENTS.get(head.type)
        content = None if layout is None else parsed_or_none(layout, rest)
        if content is not None:
            fields += [known(each, content) for each in fields_of(layout, content, CODES)]
        elif layout is not None:
            note = f", unreadable{note}"
        return Meaning(f"{self.name}, {self.take(rest)}{note}", fields)

    def take(self, rest: bytes) -> str:
        """The next bytes of the one under way."""
        first, left = len(self.got), self.size - len(self.got)
        self.got += rest[:left]
        added = f"bytes {first}..{len(self.got) - 1}" if len(self.got) > first else "no bytes"
        about = f"{added} of {self.size}"
        if len(rest) > left + PADDING_MAX:
            about += f" and {len(rest) - left} more than announced"
        if len(self.got) < self.size:
            return about
        right = nanocockpit.check(bytes(self.got))
        self.size = 0
        if not self.check:
            return f"{about}, the last ones; no check was sent"
        return f"{about}, the last ones; the check is {'right' if self.check == right else f'wrong, {right} here'}"


def known(each: Field, content: Any) -> Field:
    """Of the distances only those that there are."""
    return each._replace(value=each.value[: content.ranges_count]) if each.name == "ranges" else each
