"""A recording that was cut off, made whole: what was written completely is copied, the end is written anew."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from ..protocol.errors import LocalError
from .mcap import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    HEADER,
    MAGIC,
    METADATA,
    RECORD,
    SCHEMA,
    Channel,
    DamagedError,
    Fields,
    Message,
    Schema,
    encode_channel,
    encode_message_index,
    encode_schema,
    read_chunk_head,
    read_messages,
    split,
    walk,
)
from .mcap_summary import finish


@dataclass(frozen=True, slots=True)
class Damage:
    """A part of the file that is not in the new one."""

    offset: int
    size: int
    why: str


@dataclass(slots=True)
class Recovery:
    """What was found in a file."""

    chunks: int = 0
    messages: dict[str, int] = field(default_factory=dict)
    """By topic."""
    damage: list[Damage] = field(default_factory=list)
    has_end: bool = False
    """Nothing was cut off."""
    left_out: int = 0
    """Attachments and metadata: recordings of ours have none."""


def recover(source: str, target: str) -> Recovery:
    """Copies every complete chunk of `source`, which is only read, into a new file."""
    try:
        with Path(source).open("rb") as file:
            size = check(source, file)
            with Path(target).open("x+b") as out:
                try:
                    recovery = Copy(file, out).everything(size)
                    if not recovery.messages:
                        raise LocalError(f"{source}: {nothing(recovery)}; {target} was not made")
                    os.fsync(out.fileno())
                except BaseException:
                    Path(target).unlink()
                    raise
    except FileExistsError as error:
        raise LocalError(f"{target}: exists, and nothing is ever overwritten: name another file with -o") from error
    except OSError as error:
        raise LocalError(f"{error.filename or target}: {error.strerror}") from error
    return recovery


def nothing(recovery: Recovery) -> str:
    """Why there is nothing in it."""
    if recovery.damage:
        worst = max(recovery.damage, key=lambda each: each.size)
        return f"nothing can be recovered: no message is whole (from byte {worst.offset} on: {worst.why})"
    if recovery.has_end:
        return "there is nothing to recover: it is whole, and no message is in it"
    return "nothing can be recovered: it was cut off before the first message"


def check(source: str, file: IO[bytes]) -> int:
    """The file's size; LocalError when there cannot be anything in it."""
    begin = file.read(len(MAGIC))
    if not begin:
        raise LocalError(f"{source}: empty: it was cut off before anything was written, nothing can be recovered")
    if not MAGIC.startswith(begin):
        raise LocalError(f"{source}: not an MCAP file: it does not begin as one")
    if len(begin) < len(MAGIC):
        raise LocalError(f"{source}: cut off after {len(begin)} bytes, nothing can be recovered")
    return file.seek(0, os.SEEK_END)


class Copy:
    """The new file as it grows."""

    def __init__(self, file: IO[bytes], out: IO[bytes]) -> None:
        self.recovery = Recovery()
        self._file = file
        self._out = out
        self._schemas: set[int] = set()
        self._channels: dict[int, Channel] = {}
        out.write(MAGIC)

    def everything(self, size: int) -> Recovery:
        """All that is whole. A damaged record costs itself, unless its length is damaged: that is the end."""
        recovery = self.recovery
        try:
            for opcode, offset, length in walk(self._file, len(MAGIC), size):
                if opcode == DATA_END:
                    recovery.has_end = True
                    break
                try:
                    self._record(opcode, offset, length)
                except DamagedError as error:
                    recovery.damage.append(Damage(offset, RECORD.size + length, error.why))
        except DamagedError as error:
            recovery.damage.append(Damage(error.offset, size - error.offset, error.why))
        finish(self._out)
        return recovery

    def _record(self, opcode: int, offset: int, length: int) -> None:
        if opcode == HEADER:
            self._as_it_is(offset, length)
        elif opcode == SCHEMA:
            self._declare(Fields(self._file.read(length), offset).schema())
        elif opcode == CHANNEL:
            self._declare(Fields(self._file.read(length), offset).channel())
        elif opcode == CHUNK:
            self._chunk(offset, length)
        elif opcode in (ATTACHMENT, METADATA):
            self.recovery.left_out += 1

    def _declare(self, each: Schema | Channel) -> None:
        if isinstance(each, Channel) and each.id not in self._channels:
            self._channels[each.id] = each
            self._out.write(encode_channel(each))
        elif isinstance(each, Schema) and each.id not in self._schemas:
            self._schemas.add(each.id)
            self._out.write(encode_schema(each))

    def _chunk(self, offset: int, length: int) -> None:
        """With its message indexes made again: the old ones may be cut off."""
        head = read_chunk_head(self._file, offset, length)
        indexes: dict[int, list[int]] = {}
        for each in split(read_messages(self._file, head, offset), offset):
            if isinstance(each, Message):
                indexes.setdefault(each.channel_id, []).extend((each.log_ns, each.offset))
            else:
                self._declare(each)
        if not indexes.keys() <= self._channels.keys():
            raise DamagedError(offset, "a chunk with messages of a channel that nothing declares")
        self._as_it_is(offset, length)
        self.recovery.chunks += 1
        for channel_id, entries in indexes.items():
            self._out.write(encode_message_index(channel_id, entries))
            topic = self._channels[channel_id].topic
            self.recovery.messages[topic] = self.recovery.messages.get(topic, 0) + len(entries) // 2

    def _as_it_is(self, offset: int, length: int) -> None:
        self._file.seek(offset)
        self._out.write(self._file.read(RECORD.size + length))
