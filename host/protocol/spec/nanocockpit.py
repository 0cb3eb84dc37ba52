"""NanoCockpit: states on UART1, a link whose length leaves out the route, and images as buffers with metadata."""

from typing import Any

from construct import (
    Array,
    Bytes,
    Checksum,
    Const,
    Float32l,
    GreedyBytes,
    Int8ul,
    Int16sl,
    Int16ul,
    Int32ul,
    OneOf,
    Padding,
    RawCopy,
    Rebuild,
    Struct,
    Terminated,
    this,
)

from .checks import crc32
from .cpx import ROUTE
from .image import DEPTH, SIDE
from .values import Value

COMMANDS = (
    Value(0x10, "NANOCOCKPIT_BEGIN", "a buffer begins"),
    Value(0x11, "NANOCOCKPIT_MORE", "the next bytes of it"),
)

TYPES = (
    Value(0x01, "NANOCOCKPIT_IMAGE", "GAP8 to host: metadata and pixels"),
    Value(0xF0, "NANOCOCKPIT_INFERENCE", "host to GAP8: the answer to a frame"),
)

LIMITS = (
    Value(4088, "NANOCOCKPIT_DATA_MAX", "data of one packet"),
    Value(4092, "NANOCOCKPIT_FRAME_MAX", "length, route and data"),
    Value(3, "NANOCOCKPIT_PADDING_MAX", "bytes added to the last packet of a buffer"),
)

STATE = Struct(
    "stm32_time" / Int32ul * "FreeRTOS ticks of 1 ms; low 32 bits of the stamp clock in us in Bitcraze's example",
    "x_mm" / Int16sl * "mm",
    "y_mm" / Int16sl * "mm",
    "z_mm" / Int16sl * "mm",
    "vx_mm_s" / Int16sl * "mm/s",
    "vy_mm_s" / Int16sl * "mm/s",
    "vz_mm_s" / Int16sl * "mm/s",
    "ax_mm_s2" / Int16sl * "mm/s^2",
    "ay_mm_s2" / Int16sl * "mm/s^2",
    "az_mm_s2" / Int16sl * "mm/s^2",
    "quat" / Int32ul * "a unit quaternion, packed",
    "roll_mrad_s" / Int16sl * "mrad/s",
    "pitch_mrad_s" / Int16sl * "mrad/s",
    "yaw_mrad_s" / Int16sl * "mrad/s",
)


def message(sign: bytes, *fields: Any) -> Any:
    """On UART1."""
    covered = Struct("sign" / Const(sign) * sign.decode(), *fields)
    return Struct(
        "covered" / RawCopy(covered),
        "crc32" / Checksum(Int32ul, crc32, this.covered.data) * "CRC-32 of every byte before it",
    )


STATE_MESSAGE = message(b"!STA", "state" / STATE)
NOISE_MESSAGE = message(b"!RNG", "noise" / Int32ul * "random")
RANGES_MESSAGE = message(
    b"!TOF",
    "count" / Int8ul * "0, 16 or 64",
    Padding(3) * "ignored",
    "ranges" / Bytes(64) * "of a distance sensor",
)

FRAME = Struct(
    "length"
    / Rebuild(OneOf(Int16ul, range(4089)), lambda this: len(this.data))
    * "data alone, 0..4088; 0: idle, on SPI",
    "route" / ROUTE * "see Route",
    "data" / Bytes(this.length) * "of the packet",
)

BEGIN = Struct(
    "command" / Const(0x10, Int8ul) * "command",
    "type" / Int8ul * "a NANOCOCKPIT_ type",
    "size" / Int32ul * "bytes of the buffer",
    "check" / Int32ul * "CRC-32 of the buffer, FFFFFFFF if that is 0; 0: none",
    Padding(2) * "written as 0, ignored",
)

MORE = Struct("command" / Const(0x11, Int8ul) * "command", Padding(3) * "written as 0, ignored")

METADATA = Struct(
    "version" / Const(10, Int8ul) * "version of this layout",
    "width" / SIDE * "pixels, 1..1024",
    "height" / SIDE * "pixels, 1..1024",
    "depth" / DEPTH * "bytes per pixel, 1..4",
    "format" / Const(0, Int8ul) * "grey",
    "frame_id" / Int8ul * "the sensor's own counter",
    "frame_gap8_us" / Int32ul * "us, GAP8 stamp clock at end of frame",
    "state_gap8_us" / Int32ul * "us, GAP8 stamp clock when the state had come in; 0: none",
    "state" / STATE * "the latest",
    "ranges_gap8_us" / Int32ul * "us, likewise for the ranges",
    "ranges_count" / Int8ul * "0, 16 or 64",
    Padding(3) * "ignored",
    "ranges" / Array(64, Int8ul) * "of a distance sensor",
    "reply_frame_gap8_us" / Int32ul * "frame_gap8_us of the frame that the host has answered last",
    "reply_gap8_us" / Int32ul * "us, GAP8 stamp clock when that answer had come in",
    "inference_stm32_time" / Int32ul * "of the state that the inference belongs to",
    "inference" / Array(4, Float32l) * "x, y, z, phi of a network on board",
)

REPLY = Struct(
    "frame_gap8_us" / Int32ul * "of the frame that is answered",
    "frame_id" / Int8ul * "likewise",
    Padding(20) * "an inference made by the host: time of the state, four floats",
    Terminated,
)

BUFFER = Struct("metadata" / METADATA, "pixels" / GreedyBytes)


def check(buffer: bytes) -> int:
    """Of a buffer, as it is sent: never 0, which would mean that there is none."""
    return crc32(buffer) or 0xFFFFFFFF


def quat(xyzw: tuple[float, ...]) -> int:
    """A unit quaternion in 32 bits: which component is the largest, then sign and size of each of the others."""
    largest = max(range(4), key=lambda place: (abs(xyzw[place]), -place))
    packed = largest
    for place, value in enumerate(xyzw):
        if place != largest:
            size = min(511, int(abs(value) * 511 * 2**0.5 + 0.5))
            packed = packed << 10 | ((value < 0) != (xyzw[largest] < 0)) << 9 | size
    return packed
