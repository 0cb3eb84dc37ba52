"""The end of an MCAP file, which lets a reader find what it wants without reading everything: written and read.

A recording is written in one direction: schemas and channels at the top, then chunks, each followed by its message
indexes. While it grows nothing is remembered: `finish` reads the chunks' heads back from the file itself. So memory
stays bounded, and a file that lost its end is finished in the same way.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO

from ..protocol.errors import LocalError
from .mcap import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    MAGIC,
    MESSAGE_INDEX,
    RECORD,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    Channel,
    ChunkHead,
    Fields,
    Schema,
    encode_channel,
    encode_schema,
    read_chunk_head,
    record,
    text,
    walk,
)

FOOTER_HEAD = struct.Struct("<BQQQ")
FOOTER_SIZE = RECORD.size + 20


@dataclass(frozen=True, slots=True)
class ChunkIndex:
    """Where a chunk is, and which channels have messages in it."""

    head: ChunkHead
    offset: int
    length: int
    message_indexes: Mapping[int, int]
    """Channel to the offset of its message index."""
    message_index_length: int

    def encode(self) -> bytes:
        indexes = b"".join(struct.pack("<HQ", *item) for item in self.message_indexes.items())
        head = self.head
        return record(
            CHUNK_INDEX,
            struct.pack("<QQQQI", head.first_ns, head.last_ns, self.offset, self.length, len(indexes))
            + indexes
            + struct.pack("<Q", self.message_index_length)
            + text(head.compression)
            + struct.pack("<QQ", head.stored, head.size),
        )


@dataclass
class Summary:
    """What is at the end of a file: everything that a reader needs to find the messages that it wants."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    chunks: list[ChunkIndex] = field(default_factory=list)
    message_counts: dict[int, int] = field(default_factory=dict)

    def encode(self, at: int) -> bytes:
        """The end of a file of which the data ends at byte `at`, closing magic included."""
        out = bytearray(record(DATA_END, bytes(4)))
        start = at + len(out)
        offsets = b""
        for opcode, records in (
            (SCHEMA, [encode_schema(each) for each in self.schemas.values()]),
            (CHANNEL, [encode_channel(each) for each in self.channels.values()]),
            (STATISTICS, [self._statistics()]),
            (CHUNK_INDEX, [each.encode() for each in self.chunks]),
        ):
            group = b"".join(records)
            if group:
                offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", opcode, at + len(out), len(group)))
            out += group
        offsets_at = at + len(out)
        out += offsets
        footer = FOOTER_HEAD.pack(FOOTER, FOOTER_SIZE - RECORD.size, start, offsets_at)
        crc = zlib.crc32(footer, zlib.crc32(memoryview(out)[start - at :]))
        return bytes(out) + footer + struct.pack("<I", crc) + MAGIC

    def _statistics(self) -> bytes:
        counts = b"".join(struct.pack("<HQ", *item) for item in self.message_counts.items())
        return record(
            STATISTICS,
            struct.pack(
                "<QHIIIIQQI",
                sum(self.message_counts.values()), len(self.schemas), len(self.channels), 0, 0, len(self.chunks),
                min((each.head.first_ns for each in self.chunks), default=0),
                max((each.head.last_ns for each in self.chunks), default=0), len(counts),
            ) + counts,
        )  # fmt: skip


def finish(file: IO[bytes]) -> Summary:
    """Closes a file, opened for reading and writing, that has everything but its end."""
    summary = Summary()
    end = file.seek(0, 2)
    chunk: tuple[ChunkHead, int, int] | None = None
    indexes: dict[int, int] = {}
    indexes_length = 0

    def close_chunk() -> None:
        if chunk is not None:
            summary.chunks.append(ChunkIndex(*chunk, dict(indexes), indexes_length))

    for opcode, offset, size in walk(file, len(MAGIC), end):
        if opcode == SCHEMA:
            schema = Fields(file.read(size), offset).schema()
            summary.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            channel = Fields(file.read(size), offset).channel()
            summary.channels[channel.id] = channel
        elif opcode == CHUNK:
            close_chunk()
            chunk = read_chunk_head(file, offset, size), offset, RECORD.size + size
            indexes.clear()
            indexes_length = 0
        elif opcode == MESSAGE_INDEX:
            channel_id, length = struct.unpack("<HI", file.read(6))
            indexes[channel_id] = offset
            indexes_length += RECORD.size + size
            summary.message_counts[channel_id] = summary.message_counts.get(channel_id, 0) + length // 16
    close_chunk()
    file.seek(end)
    file.write(summary.encode(end))
    file.flush()
    return summary


def read_summary(file: IO[bytes]) -> Summary:
    """Of a whole file. LocalError says what is wrong with another one."""
    size = file.seek(0, 2)
    file.seek(0)
    if not size:
        raise LocalError("empty")
    if file.read(len(MAGIC)) != MAGIC:
        raise LocalError("not an MCAP file: it does not begin as one")
    end = size - len(MAGIC)
    file.seek(max(0, end - FOOTER_SIZE))
    footer = file.read(FOOTER_SIZE)
    if file.read() != MAGIC or len(footer) < FOOTER_SIZE or footer[0] != FOOTER:
        raise LocalError("cut off: it has no end; 'host recover' makes it whole")
    start = FOOTER_HEAD.unpack_from(footer)[2]
    if not start:
        raise LocalError("has no index; 'host recover' makes one")
    summary = Summary()
    for opcode, offset, length in walk(file, start, end):
        fields = Fields(file.read(length), offset)
        if opcode == SCHEMA:
            schema = fields.schema()
            summary.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            channel = fields.channel()
            summary.channels[channel.id] = channel
        elif opcode == CHUNK_INDEX:
            first_ns, last_ns, at, chunk_length = fields.numbers("QQQQ")
            entries = Fields(fields.take(fields.numbers("I")[0]), offset)
            pairs = {}
            while entries.left:
                channel_id, index_at = entries.numbers("HQ")
                pairs[channel_id] = index_at
            index_length = fields.numbers("Q")[0]
            compression = fields.text()
            stored, plain = fields.numbers("QQ")
            head = ChunkHead(first_ns, last_ns, plain, 0, compression, stored)
            summary.chunks.append(ChunkIndex(head, at, chunk_length, pairs, index_length))
    summary.chunks.sort(key=lambda each: each.offset)
    return summary
