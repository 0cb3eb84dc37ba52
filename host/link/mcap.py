"""MCAP (https://mcap.dev/spec), the container of recordings: its records as bytes, written and read. No I/O but on the
file that it is handed.

Written here and not with the package of that name: that one brings 30 MB of compressors, and remembers every chunk
until the end. It is the tests' independent reader.
"""

from __future__ import annotations

import importlib
import io
import struct
import zlib
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import IO

from ..protocol.errors import LocalError

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
ATTACHMENT, ATTACHMENT_INDEX, STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(9, 16)

RECORD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_FIXED = MESSAGE_HEAD.size - RECORD.size
CHUNK_HEAD = struct.Struct("<QQQI")
CHUNK_MAX = 1 << 30
"""A chunk that claims to be larger is damaged: it is never read into memory."""

Bytes = bytes | memoryview


class DamagedError(LocalError):
    """What begins at this byte of the file cannot be read."""

    def __init__(self, offset: int, why: str) -> None:
        super().__init__(f"byte {offset}: {why}")
        self.offset = offset
        self.why = why


@dataclass(frozen=True, slots=True)
class Schema:
    id: int
    name: str
    encoding: str
    data: bytes


@dataclass(frozen=True, slots=True)
class Channel:
    id: int
    schema_id: int
    topic: str
    encoding: str
    metadata: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class Message:
    channel_id: int
    log_ns: int
    publish_ns: int
    data: memoryview
    offset: int
    """Of its record in the chunk's."""


def record(opcode: int, content: bytes) -> bytes:
    return RECORD.pack(opcode, len(content)) + content


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def mapping(items: Mapping[str, str]) -> bytes:
    data = b"".join(text(key) + text(value) for key, value in items.items())
    return struct.pack("<I", len(data)) + data


def encode_header(library: str) -> bytes:
    return record(HEADER, text("") + text(library))


def encode_schema(schema: Schema) -> bytes:
    data = struct.pack("<I", len(schema.data)) + schema.data
    return record(SCHEMA, struct.pack("<H", schema.id) + text(schema.name) + text(schema.encoding) + data)


def encode_channel(channel: Channel) -> bytes:
    head = struct.pack("<HH", channel.id, channel.schema_id)
    return record(CHANNEL, head + text(channel.topic) + text(channel.encoding) + mapping(channel.metadata))


class Chunk:
    """Messages on their way into the file. Its memory is used again for the next chunk: new pages cost more than the
    copying."""

    def __init__(self) -> None:
        self._messages = io.BytesIO()
        self.clear()

    def clear(self) -> None:
        self.size = 0
        self._messages.seek(0)
        self._index: defaultdict[int, list[int]] = defaultdict(list)
        self._first_ns = (1 << 64) - 1
        self._last_ns = 0

    def add(self, channel_id: int, sequence: int, log_ns: int, publish_ns: int, parts: tuple[Bytes, ...]) -> None:
        """A message of these parts, in one."""
        size = sum(map(len, parts)) + MESSAGE_FIXED
        self._messages.write(MESSAGE_HEAD.pack(MESSAGE, size, channel_id, sequence, log_ns, publish_ns))
        self._messages.writelines(parts)
        self._index[channel_id] += log_ns, self.size
        self.size += RECORD.size + size
        self._first_ns = min(self._first_ns, log_ns)
        self._last_ns = max(self._last_ns, log_ns)

    def encode(self) -> tuple[Bytes, ...]:
        """The chunk and its message indexes, as they follow each other in the file: to be written before clear()."""
        messages = self._messages.getbuffer()[: self.size]
        head = CHUNK_HEAD.pack(self._first_ns, self._last_ns, self.size, zlib.crc32(messages))
        head += text("") + struct.pack("<Q", self.size)
        indexes = (encode_message_index(channel_id, entries) for channel_id, entries in self._index.items())
        return RECORD.pack(CHUNK, len(head) + self.size) + head, messages, b"".join(indexes)


def encode_message_index(channel_id: int, entries: list[int]) -> bytes:
    """`entries`: time and offset in turn."""
    return record(MESSAGE_INDEX, struct.pack(f"<HI{len(entries)}Q", channel_id, 8 * len(entries), *entries))


class Fields:
    """Reads one record's content. DamagedError when it ends too early."""

    def __init__(self, content: Bytes, offset: int) -> None:
        self._content = memoryview(content)
        self._at = 0
        self._offset = offset

    @property
    def left(self) -> int:
        return len(self._content) - self._at

    def take(self, size: int) -> memoryview:
        taken = self._content[self._at : self._at + size]
        if len(taken) < size:
            raise DamagedError(self._offset, "a record is shorter than what it says it holds")
        self._at += size
        return taken

    def numbers(self, layout: str) -> tuple[int, ...]:
        layout = "<" + layout
        return struct.unpack(layout, self.take(struct.calcsize(layout)))

    def text(self) -> str:
        return bytes(self.take(self.numbers("I")[0])).decode("utf-8", errors="replace")

    def mapping(self) -> dict[str, str]:
        inner = Fields(self.take(self.numbers("I")[0]), self._offset)
        items = {}
        while inner.left:
            key = inner.text()
            items[key] = inner.text()
        return items

    def schema(self) -> Schema:
        return Schema(self.numbers("H")[0], self.text(), self.text(), bytes(self.take(self.numbers("I")[0])))

    def channel(self) -> Channel:
        channel_id, schema_id = self.numbers("HH")
        return Channel(channel_id, schema_id, self.text(), self.text(), self.mapping())


def walk(file: IO[bytes], begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """(opcode, offset, size of the content) of each record; the file then stands at the content."""
    at = begin
    while at < end:
        file.seek(at)
        head = file.read(min(RECORD.size, end - at))
        if len(head) < RECORD.size:
            raise DamagedError(at, "cut off inside a record's head")
        opcode, size = RECORD.unpack(head)
        if not opcode:
            raise DamagedError(at, "no record begins here")
        if at + RECORD.size + size > end:
            raise DamagedError(at, f"a record of {size} bytes is cut off, or its length is damaged")
        yield opcode, at, size
        at += RECORD.size + size


@dataclass(frozen=True, slots=True)
class ChunkHead:
    first_ns: int
    last_ns: int
    size: int
    """Of the messages, uncompressed."""
    crc32: int
    compression: str
    stored: int
    """Bytes in the file."""


def read_chunk_head(file: IO[bytes], offset: int, size: int) -> ChunkHead:
    """Of the chunk record at `offset` with this much content, where the file stands; then it stands at the messages."""
    fields = Fields(file.read(CHUNK_HEAD.size), offset)
    first_ns, last_ns, plain, crc32 = fields.numbers("QQQI")
    length = Fields(file.read(4), offset).numbers("I")[0]
    if length > size:
        raise DamagedError(offset, "a chunk that names no compression")
    compression = file.read(length).decode("utf-8", errors="replace")
    stored = Fields(file.read(8), offset).numbers("Q")[0]
    if CHUNK_HEAD.size + 4 + length + 8 + stored != size or plain > CHUNK_MAX or stored > CHUNK_MAX:
        raise DamagedError(offset, "a chunk whose lengths contradict each other")
    return ChunkHead(first_ns, last_ns, plain, crc32, compression, stored)


def read_messages(file: IO[bytes], head: ChunkHead, offset: int) -> bytes:
    """The messages of a chunk as one piece, checked. DamagedError when the check fails."""
    data = decompress(head.compression, file.read(head.stored), head.size, offset)
    if len(data) != head.size or (head.crc32 and zlib.crc32(data) != head.crc32):
        raise DamagedError(offset, "a chunk whose check fails")
    return data


def decompress(compression: str, data: bytes, size: int, offset: int) -> bytes:
    """Recordings of ours are not compressed: noise of a sensor gains nothing. Others' tools may have done it."""
    if not compression:
        return data
    package = {"zstd": "zstandard", "lz4": "lz4.frame"}.get(compression)
    if package is None:
        raise LocalError(f"compressed with {compression!r}, which is not known here")
    try:
        library = importlib.import_module(package)
    except ImportError as error:
        name = package.partition(".")[0]
        raise LocalError(f"compressed with {compression}: run 'pip install {name}', then again") from error
    try:
        if compression == "zstd":
            return bytes(library.ZstdDecompressor().decompress(data, max_output_size=size))
        return bytes(library.decompress(data))
    except (RuntimeError, getattr(library, "ZstdError", ValueError)) as error:
        raise DamagedError(offset, f"a chunk that cannot be decompressed: {error}") from error


def split(data: Bytes, offset: int) -> Iterator[Message | Schema | Channel]:
    """What is in a chunk's messages, in its order. `offset` is the chunk's, for the report of damage."""
    view, at = memoryview(data), 0
    while at < len(view):
        if at + RECORD.size > len(view):
            raise DamagedError(offset, "a chunk that ends inside a record")
        opcode, size = RECORD.unpack_from(view, at)
        begin, end = at + RECORD.size, at + RECORD.size + size
        if end > len(view) or (opcode == MESSAGE and size < MESSAGE_FIXED):
            raise DamagedError(offset, "a chunk that ends inside a record")
        if opcode == MESSAGE:
            _, _, channel_id, _, log_ns, publish_ns = MESSAGE_HEAD.unpack_from(view, at)
            yield Message(channel_id, log_ns, publish_ns, view[begin + MESSAGE_FIXED : end], at)
        elif opcode == SCHEMA:
            yield Fields(view[begin:end], offset).schema()
        elif opcode == CHANNEL:
            yield Fields(view[begin:end], offset).channel()
        at = end
