"""Messages of a recording and their schemas: images as Foxglove knows them and raw bytes in protobuf, times in JSON.

The protobuf is written by hand: four small messages do not need a compiler and a run-time library. Tests read it with
the real ones.
"""

from __future__ import annotations

import dataclasses
import json
import struct
import types
import typing
from typing import Any

import numpy as np

from .frame import PAIR_DTYPE, Frame

PIXELS = {1: "mono8", 3: "rgb8"}
"""By bytes per pixel."""
NS = 1_000_000_000

# Of a protobuf field: its type in a descriptor, and how it lies on the wire.
STRING, MESSAGE, BYTES, FIXED32 = 9, 11, 12, 7
VARINT, LENGTH, FOUR = 0, 2, 5
TIMESTAMP = "google.protobuf.Timestamp"

IMAGE_FIELDS = (
    ("timestamp", 1, MESSAGE), ("width", 2, FIXED32), ("height", 3, FIXED32), ("encoding", 4, STRING),
    ("step", 5, FIXED32), ("data", 6, BYTES), ("frame_id", 7, STRING),
)  # fmt: skip
COMPRESSED_FIELDS = (("timestamp", 1, MESSAGE), ("data", 2, BYTES), ("format", 3, STRING), ("frame_id", 4, STRING))
BYTES_FIELDS = (("data", 1, BYTES),)


def varint(value: int) -> bytes:
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def head(number: int, size: int) -> bytes:
    """What stands before the `size` bytes of a field."""
    return varint(number << 3 | LENGTH) + varint(size)


def piece(number: int, data: bytes) -> bytes:
    return head(number, len(data)) + data


def whole(number: int, value: int) -> bytes:
    return varint(number << 3 | VARINT) + varint(value)


def fixed32(number: int, value: int) -> bytes:
    return varint(number << 3 | FOUR) + struct.pack("<I", value)


def timestamp(time_ns: int) -> bytes:
    """As field 1."""
    return piece(1, whole(1, time_ns // NS) + whole(2, time_ns % NS))


def descriptor(name: str, fields: tuple[tuple[str, int, int], ...]) -> bytes:
    """A FileDescriptorSet of this one message, and of what it refers to."""
    package, _, message = name.rpartition(".")
    described = b"".join(piece(2, _field(*each)) for each in fields)
    file = piece(1, f"{package}/{message}.proto".encode()) + piece(2, package.encode())
    needed = b""
    if any(kind == MESSAGE for _, _, kind in fields):
        path = b"google/protobuf/timestamp.proto"
        times = piece(2, _field("seconds", 1, 3)) + piece(2, _field("nanos", 2, 5))
        stamp = piece(1, path) + piece(2, b"google.protobuf") + piece(4, piece(1, b"Timestamp") + times)
        needed = piece(1, stamp + piece(12, b"proto3"))
        file += piece(3, path)
    return needed + piece(1, file + piece(4, piece(1, message.encode()) + described) + piece(12, b"proto3"))


def _field(name: str, number: int, kind: int) -> bytes:
    optional = whole(4, 1)
    named = piece(6, b"." + TIMESTAMP.encode()) if kind == MESSAGE else b""
    return piece(1, name.encode()) + whole(3, number) + optional + whole(5, kind) + named


PROTOBUF_SCHEMAS = {
    "foxglove.RawImage": descriptor("foxglove.RawImage", IMAGE_FIELDS),
    "foxglove.CompressedImage": descriptor("foxglove.CompressedImage", COMPRESSED_FIELDS),
    "spindeck.Bytes": descriptor("spindeck.Bytes", BYTES_FIELDS),
}


def image(frame: Frame, time_ns: int, frame_id: str) -> tuple[bytes | memoryview, ...]:
    """A foxglove.RawImage or foxglove.CompressedImage, in parts: the pixels are not copied."""
    body = frame.body.data
    if frame.encoding == "jpeg":
        after = piece(3, b"jpeg") + piece(4, frame_id.encode())
        return timestamp(time_ns) + head(2, len(body)), body, after
    pixels = PIXELS.get(frame.depth, f"8UC{frame.depth}")
    before = fixed32(2, frame.width) + fixed32(3, frame.height) + piece(4, pixels.encode())
    before += fixed32(5, frame.width * frame.depth)
    return timestamp(time_ns) + before + head(6, len(body)), body, piece(7, frame_id.encode())


def raw(data: bytes) -> tuple[bytes, bytes]:
    """A spindeck.Bytes."""
    return head(1, len(data)), data


def read_raw(message: memoryview) -> memoryview:
    """The bytes in a spindeck.Bytes; ValueError if it is none."""
    at, size, shift = 1, 0, 0
    while at < len(message) and shift < 35:
        size |= (message[at] & 0x7F) << shift
        shift += 7
        at += 1
        if message[at - 1] < 0x80:
            break
    if not len(message) or message[0] != 1 << 3 | LENGTH or len(message) != at + size:
        raise ValueError("not a spindeck.Bytes")
    return message[at:]


def as_json(record: Any) -> bytes:
    """Every field of a record by its name, but pixels and what is None; pairs as a list."""
    return json.dumps(_fields(record), separators=(",", ":"), allow_nan=False, default=_plain).encode()


def _fields(record: Any) -> dict[str, Any]:
    values = ((field.name, getattr(record, field.name)) for field in dataclasses.fields(record))
    return {name: value for name, value in values if value is not None and name != "body"}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        names = value.dtype.names
        return [dict(zip(names, row, strict=True)) for row in value.tolist()] if names else value.tolist()
    return _fields(value)


def json_schema(record: type[Any]) -> bytes:
    """Of what as_json makes of records of this class. No field is ever null: Foxglove knows no such types."""
    return json.dumps({"title": f"spindeck.{record.__name__}", **_described(record)}).encode()


def _described(hint: Any) -> dict[str, Any]:
    if dataclasses.is_dataclass(hint):
        hints = typing.get_type_hints(hint)
        fields = {name: _described(each) for name, each in hints.items() if name != "body"}
        return {"type": "object", "properties": fields}
    alternatives = [each for each in typing.get_args(hint) if each is not types.NoneType]
    if isinstance(hint, types.UnionType):
        return _described(alternatives[0])
    origin = typing.get_origin(hint)
    if origin is typing.Literal:
        return {"type": "string", "enum": alternatives}
    if origin is tuple:
        return {"type": "array", "items": _described(alternatives[0])}
    if origin is dict:
        return {"type": "object", "additionalProperties": _described(alternatives[1])}
    if origin is np.ndarray:
        pair = {name: {"type": "integer"} for name in PAIR_DTYPE.names or ()}
        return {"type": "array", "items": {"type": "object", "properties": pair}}
    return {"type": {int: "integer", float: "number", bool: "boolean"}.get(hint, "string")}
