"""The dataset paper's firmware: its time message, its image header and its camera settings."""

from construct import (
    Check,
    Checksum,
    Const,
    Float32l,
    Int8ul,
    Int16ul,
    Int32ul,
    Int64ul,
    RawCopy,
    Struct,
    Terminated,
    this,
)

from .checks import xor8
from .image import BODY_BYTES, DEPTH, ENCODING, SIDE, raw_size_ok
from .values import Value

LIMITS = (
    Value(2, "PAPER_CAMERA_LINES_MIN", "lines of exposure: fewer are made so many"),
    Value(532, "PAPER_CAMERA_LINES_MAX", "lines of exposure: more are made so many"),
)

POSE = (
    "x_m" / Float32l * "m",
    "y_m" / Float32l * "m",
    "z_m" / Float32l * "m",
    "qx" / Float32l * "unit quaternion",
    "qy" / Float32l,
    "qz" / Float32l,
    "qw" / Float32l,
)

STAMP = Struct(
    "start" / Const(0xBC, Int8ul) * "start",
    "length" / Const(37, Int8ul) * "bytes that follow, less one",
    "covered"
    / RawCopy(
        Struct(
            "command" / Const(1, Int8ul) * "command",
            "stm32_us" / Int64ul * "us, STM32 stamp clock, read before the first byte leaves",
            *POSE,
        )
    ),
    "check" / Checksum(Int8ul, xor8, this.covered.data) * "XOR of the 37 bytes from the command on",
)

HEADER = Struct(
    "magic" / Const(0xBC, Int8ul) * "magic",
    "width" / SIDE * "pixels, 1..1024",
    "height" / SIDE * "pixels, 1..1024",
    "depth" / DEPTH * "bytes per pixel, 1..4",
    "type" / ENCODING * "0 raw, 1 JPEG",
    "size" / BODY_BYTES * "bytes of the body, 1..1048576; raw: width x height x depth",
    "frame_stm32_ms" / Int32ul * "ms, STM32 stamp clock, by the GAP8's reckoning",
    *POSE,
    Check(lambda this: raw_size_ok(this, this.type, this.size)),
    Terminated,
)

CAMERA = Struct(
    "command" / Const(0, Int8ul) * "command",
    "auto_exposure" / Int8ul * "0 or 1",
    "analog_gain" / Int8ul * "1, 2, 4 or 8",
    "digital_gain" / Int8ul * "1/64",
    "exposure_lines" / Int16ul * "lines, 2..532",
    "burst" / Int8ul * "images back to back, 1..3",
    "encoding" / Int8ul * "0 raw, 1 JPEG",
    Terminated,
)
