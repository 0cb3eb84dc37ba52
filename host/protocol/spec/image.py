"""The stock image stream: one header packet, then the body. Both dialects share what a picture can be."""

from typing import Any

from construct import Check, Const, Int8ul, Int16ul, Int32ul, OneOf, Struct, Terminated

from .values import Value

LIMITS = (
    Value(1024, "IMAGE_SIDE_MAX", "pixels of a side; the sensor has 324"),
    Value(1048576, "IMAGE_BODY_MAX", "bytes of a body"),
)

ENCODINGS = (
    Value(0, "IMAGE_RAW", "pixels row by row"),
    Value(1, "IMAGE_JPEG", "a JPEG file"),
)

SIDE = OneOf(Int16ul, range(1, 1025))
DEPTH = OneOf(Int8ul, range(1, 5))
ENCODING = OneOf(Int8ul, (0, 1))
BODY_BYTES = OneOf(Int32ul, range(1, 1048577))


def raw_size_ok(header: Any, encoding: int, size: int) -> bool:
    """A raw body is exactly its pixels."""
    return encoding != 0 or size == header.width * header.height * header.depth


STOCK_HEADER = Struct(
    "magic" / Const(0xBC, Int8ul) * "magic",
    "width" / SIDE * "pixels, 1..1024",
    "height" / SIDE * "pixels, 1..1024",
    "depth" / DEPTH * "bytes per pixel, 1..4",
    "type" / ENCODING * "0 raw, 1 JPEG",
    "size" / BODY_BYTES * "bytes of the body, 1..1048576; raw: width x height x depth",
    Check(lambda this: raw_size_ok(this, this.type, this.size)),
    Terminated,
)
