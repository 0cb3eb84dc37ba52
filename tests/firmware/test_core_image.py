"""The image stream's messages, stock and native: a literal for each."""

import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from c_memory import POISONS, Bytes, Room, poisoned, untouched

from host.native import ffi, lib


def sealed(covered: bytes) -> bytes:
    return covered + zlib.crc32(covered).to_bytes(4, "little")


@dataclass(frozen=True)
class Message:
    name: str  # of the C functions, and with _t of the struct
    wire: bytes
    fields: dict[str, int]


FRAME_FIELDS = {
    "frame": 0x04030201,
    "width": 324,
    "height": 244,
    "depth": 1,
    "encoding": 0,
    "flags": 0x0103,
    "body_bytes": 79056,
    "body_crc32": 0x14131211,
    "frame_gap8_us": 0x1817161514131211,
    "frame_stm32_us": 0x2827262524232221,
    "bound_us": 0x34333231,
    "epoch": 0x41,
    "analog_gain": 0x42,
    "digital_gain": 0x43,
    "burst": 0x44,
    "exposure_lines": 0x54535251,
    "line_time_ns": 0x64636261,
    "stamp_sequence": 0x74737271,
    "stamp_age_us": 0x84838281,
    "stamps_received": 0x91,
    "stamps_missed": 0x92,
    "stamps_bad": 0x93,
    "pairs_lost": 0x94,
    "captures_failed": 0x95,
    "captures_late": 0x96,
    "frames_unsent": 0x97,
    "spi_errors": 0x98,
    "packets_dropped": 0x99,
    "window_us": 0xA4A3A2A1,
    "window_stamps": 0xB4B3B2B1,
    "delay_us": 0xC4C3C2C1,
    "skew_ppb": -0x01020304,
    "latency_us": 0xE4E3E2E1,
    "minimum_delay_us": 0xF4F3F2F1,
    "minimum_delay_error_us": 0xF8F7F6F5,
    "echoes": 0x0D0C0B0A,
}
FRAME_WIRE = bytes.fromhex(
    "4e 01 90 00 01 02 03 04 44 01 f4 00 01 00 03 01 d0 34 01 00 11 12 13 14"
    "11 12 13 14 15 16 17 18 21 22 23 24 25 26 27 28 31 32 33 34 41 42 43 44"
    "51 52 53 54 61 62 63 64 71 72 73 74 81 82 83 84"
    "91 00 00 00 92 00 00 00 93 00 00 00 94 00 00 00 95 00 00 00 96 00 00 00 97 00 00 00 98 00 00 00 99 00 00 00"
    "5e 21 8e e3 a1 a2 a3 a4 b1 b2 b3 b4 c1 c2 c3 c4 fc fc fd fe e1 e2 e3 e4 02 16 a7 9c"
    "f1 f2 f3 f4 f5 f6 f7 f8 0a 0b 0c 0d 4b 89 47 a3"
)
CLOCK = ["window_us", "window_stamps", "delay_us", "skew_ppb", "latency_us"]
ECHO = ["minimum_delay_us", "minimum_delay_error_us", "echoes"]
STATUS_COUNTERS = [
    "frames_forwarded",
    "frames_dropped",
    "frames_cut",
    "packets_forwarded",
    "packets_dropped",
    "packets_unroutable",
    "uart_bad_check",
    "uart_bad_length",
    "uart_garbage_bytes",
    "uart_gaps",
    "spi_errors",
    "tcp_skipped_bytes",
]

STOCK = Message(
    "image_stock",
    bytes.fromhex("bc 44 01 f4 00 01 00 d0 34 01 00"),
    {"width": 324, "height": 244, "depth": 1, "type": 0, "size": 79056},
)
NATIVE = [
    Message("native_frame", FRAME_WIRE, FRAME_FIELDS),
    Message(
        "native_status",
        bytes.fromhex("4e 04 00 00 01 02 03 04 05 06 07 08")
        + b"".join(bytes([0x21 + i, 0, 0, 0x31]) for i in range(12))
        + bytes.fromhex("9f 90 1b 8a"),
        {"up_us": 0x0807060504030201, **{name: 0x31000021 + i for i, name in enumerate(STATUS_COUNTERS)}},
    ),
    Message(
        "native_log",
        bytes.fromhex(
            "4e 06 08 07 11 12 13 14 15 16 17 18 21 22 23 24 31 32 33 34 41 42 43 44 51 52 53 54"
            "61 62 63 64 71 72 73 74 81 82 83 84 91 92 93 94 a1 a2 a3 a4 bb 68 08 25"
        ),
        {
            "state": 8,
            "epoch": 7,
            "stm32_us": 0x1817161514131211,
            "files": 0x24232221,
            "session": 0x34333231,
            "requested": 0x44434241,
            "accepted": 0x54535251,
            "dropped": 0x64636261,
            "stall_us": 0x74737271,
            "syncs": 0x84838281,
            "errors": 0x94939291,
            "card_errors": 0xA4A3A2A1,
        },
    ),
    Message("native_stream", bytes.fromhex("4e 10 01 00 fc 03"), {"dialect": 1, "data_max": 1020}),
    Message("native_stream", bytes.fromhex("4e 10 00 00 00 00"), {"dialect": 0, "data_max": 0}),
    Message(
        "native_camera",
        bytes.fromhex("4e 11 01 08 40 03 01 00 fa 00 40 42 0f 00"),
        {
            "auto_exposure": 1,
            "analog_gain": 8,
            "digital_gain": 64,
            "burst": 3,
            "encoding": 1,
            "exposure_lines": 250,
            "frame_period_us": 1_000_000,
        },
    ),
    Message("native_reply", bytes.fromhex("4e 05 11 07"), {"request": 17, "status": 7}),
]
MESSAGES = [STOCK, *NATIVE]

messages = pytest.mark.parametrize("message", MESSAGES, ids=lambda message: message.name)
native_messages = pytest.mark.parametrize("message", NATIVE, ids=lambda message: message.name)
poisons = pytest.mark.parametrize("poison", POISONS)


def decoder(message: Message) -> Callable[[bytes, Any], int]:
    decode = getattr(lib, f"{message.name}_decode")
    return lambda data, out: int(decode(Bytes(data).view, out))


def fields(message: Message, out: Any) -> dict[str, int]:
    return {name: getattr(out, name) for name in message.fields}


@messages
@poisons
def test_encode(message: Message, poison: int) -> None:
    room = Room(len(message.wire) + 1, poison)
    getattr(lib, f"{message.name}_encode")(ffi.new(f"{message.name}_t *", message.fields), room.memory)
    assert bytes(room) == message.wire + bytes([poison])


@messages
@poisons
def test_decode(message: Message, poison: int) -> None:
    out = poisoned(f"{message.name}_t", poison)
    assert decoder(message)(message.wire, out) == len(message.wire)
    assert fields(message, out) == message.fields


@native_messages
def test_native_messages_may_grow(message: Message) -> None:
    out = ffi.new(f"{message.name}_t *")
    assert decoder(message)(message.wire + b"\xff" * 30, out) == len(message.wire)
    assert fields(message, out) == message.fields


@messages
@poisons
def test_refusals_leave_the_struct_alone(message: Message, poison: int) -> None:
    out = poisoned(f"{message.name}_t", poison)
    decode = decoder(message)
    for size in range(len(message.wire)):
        has_length = message is STOCK or (message is NATIVE[0] and size >= 104)
        assert decode(message.wire[:size], out) == (lib.ERR_LENGTH if has_length else lib.ERR_SHORT), size
    assert decode(b"\x00" + message.wire[1:], out) == lib.ERR_START
    if message is STOCK:
        assert decode(message.wire + b"\x00", out) == lib.ERR_LENGTH
    else:
        assert decode(b"\x00", out) == lib.ERR_START
        assert decode(b"\x4e\x07" + message.wire[2:], out) == lib.ERR_START
    assert untouched(out, poison)


@pytest.mark.parametrize("message", NATIVE[:3], ids=lambda message: message.name)
def test_no_bit_of_a_checked_message_may_change(message: Message) -> None:
    out = poisoned(f"{message.name}_t", 0xA5)
    for bit in range(32, 8 * len(message.wire)):  # what comes before says what it is, and how long
        wire = bytearray(message.wire)
        wire[bit // 8] ^= 1 << bit % 8
        assert decoder(message)(bytes(wire), out) == lib.ERR_CHECK, bit
    assert untouched(out, 0xA5)


def sealed_frame(wire: bytes) -> bytes:
    """With all its checks set right."""
    return sealed(sealed(sealed(wire[:100]) + wire[104:124]) + wire[128:140]) + wire[144:]


PICTURES = [
    # width, height, depth, encoding, size, good
    (1, 1, 1, 0, 1, True),
    (1024, 1024, 1, 0, 1024 * 1024, True),
    (512, 512, 4, 0, 1024 * 1024, True),
    (324, 244, 1, 1, 1, True),
    (324, 244, 1, 1, 1024 * 1024, True),
    (0, 244, 1, 1, 1, False),
    (324, 0, 1, 1, 1, False),
    (0, 0, 1, 0, 0, False),
    (1025, 1, 1, 0, 1025, False),
    (1, 1025, 1, 0, 1025, False),
    (65535, 65535, 1, 1, 1, False),
    (324, 244, 0, 1, 1, False),
    (10, 10, 5, 0, 500, False),
    (324, 244, 1, 2, 79056, False),
    (324, 244, 1, 1, 0, False),
    (324, 244, 1, 1, 1024 * 1024 + 1, False),
    (324, 244, 1, 0, 79055, False),
    (324, 244, 1, 0, 79057, False),
    (1024, 1024, 2, 0, 2 * 1024 * 1024, False),
]


@pytest.mark.parametrize(("width", "height", "depth", "encoding", "size", "good"), PICTURES)
def test_what_a_picture_can_be(width: int, height: int, depth: int, encoding: int, size: int, good: bool) -> None:
    geometry = width.to_bytes(2, "little") + height.to_bytes(2, "little") + bytes([depth, encoding])
    stock = b"\xbc" + geometry + size.to_bytes(4, "little")
    native = bytearray(FRAME_WIRE)
    native[8:14] = geometry
    native[16:20] = size.to_bytes(4, "little")
    for wire, message in ((stock, STOCK), (sealed_frame(bytes(native)), NATIVE[0])):
        out = poisoned(f"{message.name}_t", 0xA5)
        assert decoder(message)(wire, out) == (len(wire) if good else lib.ERR_VALUE), message.name
        assert good or untouched(out, 0xA5)


@pytest.mark.parametrize(
    ("stated", "size", "result"),
    [
        *[
            (104, 104, 104),
            (105, 105, 105),
            (127, 174, 127),
            (128, 128, 128),
            (143, 143, 143),
            (144, 144, 144),
            (160, 174, 160),
        ],
        *[(103, 174, -3), (0, 104, -3), (105, 104, -3), (128, 127, -3), (144, 143, -3), (65535, 174, -3)],
    ],
)
def test_native_frame_says_how_long_its_header_is(stated: int, size: int, result: int) -> None:
    wire = sealed_frame(FRAME_WIRE[:2] + stated.to_bytes(2, "little") + FRAME_WIRE[4:]) + bytes(30)
    out = ffi.new("native_frame_t *")
    assert decoder(NATIVE[0])(wire[:size], out) == result
    assert lib.ERR_LENGTH == -3
    for names, least in ((CLOCK, 128), (ECHO, 144)):
        said = {name: FRAME_FIELDS[name] if result >= least else 0 for name in names}
        assert {name: getattr(out, name) for name in names} == said


@pytest.mark.parametrize(
    ("dialect", "data_max", "good"),
    [
        (0, 0, True),
        (1, 144, True),
        (1, 1020, True),
        (2, 0, False),
        (255, 144, False),
        (1, 127, False),
        (1, 1021, False),
    ],
)
def test_native_stream_ranges(dialect: int, data_max: int, good: bool) -> None:
    wire = b"\x4e\x10" + bytes([dialect, 0]) + data_max.to_bytes(2, "little")
    out = poisoned("native_stream_t", 0xA5)
    result = lib.native_stream_decode(Bytes(wire).view, out)
    assert result == (6 if good else lib.ERR_VALUE)
    assert good or untouched(out, 0xA5)


CAMERA = {
    "auto_exposure": ((0, 1), (2, 255)),
    "analog_gain": ((1, 2, 4, 8), (0, 3, 5, 6, 7, 9, 16, 255)),
    "digital_gain": ((1, 64, 255), (0,)),
    "burst": ((1, 2, 3), (0, 4, 255)),
    "encoding": ((0, 1), (2, 255)),
    "exposure_lines": ((2, 65535), (0, 1)),
    "frame_period_us": ((0, 1, 10_000_000), (10_000_001, 2**32 - 1)),
}


def test_native_camera_check_names_the_first_field_out_of_range() -> None:
    good = {name: allowed[0] for name, (allowed, _) in CAMERA.items()}
    for place, (name, (allowed, refused)) in enumerate(CAMERA.items(), 1):
        for value in allowed:
            assert lib.native_camera_check(ffi.new("native_camera_t *", {**good, name: value})) == 0, (name, value)
        for value in refused:
            assert lib.native_camera_check(ffi.new("native_camera_t *", {**good, name: value})) == place, (name, value)
    all_bad = {name: refused[0] for name, (_, refused) in CAMERA.items()}
    assert lib.native_camera_check(ffi.new("native_camera_t *", all_bad)) == 1


def test_native_camera_decode_judges_no_range() -> None:
    out = ffi.new("native_camera_t *")
    assert lib.native_camera_decode(Bytes(b"\x4e\x11" + b"\xff" * 12).view, out) == 14
    assert lib.native_camera_check(out) == 1
