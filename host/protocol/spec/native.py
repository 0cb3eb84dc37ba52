"""The native messages: each is the data of one CPX_APP packet and starts with the magic byte and its kind."""

from typing import Any

from construct import (
    Array,
    Check,
    Checksum,
    Const,
    Container,
    Default,
    ExprAdapter,
    FocusedSeq,
    GreedyBytes,
    IfThenElse,
    Int8ul,
    Int16ul,
    Int32sl,
    Int32ul,
    Int64ul,
    OneOf,
    Padding,
    RawCopy,
    Rebuild,
    Struct,
    this,
)

from .checks import crc32
from .image import BODY_BYTES, DEPTH, ENCODING, SIDE, raw_size_ok
from .values import Value

KINDS = (
    Value(1, "NATIVE_FRAME", "GAP8 to host: starts a frame"),
    Value(2, "NATIVE_DATA", "GAP8 to host: a piece of its body"),
    Value(3, "NATIVE_PAIRS", "GAP8 to host: stamp messages with their time of arrival"),
    Value(4, "NATIVE_STATUS", "ESP32 to host: its counters"),
    Value(5, "NATIVE_REPLY", "answer to a request"),
    Value(6, "NATIVE_LOG", "STM32 to host: the log on its card"),
    Value(16, "NATIVE_STREAM", "host to GAP8, to ESP32 and to STM32: stock or native"),
    Value(17, "NATIVE_CAMERA", "host or STM32 to GAP8: camera settings"),
)

FLAGS = (
    Value(1, "FRAME_HAS_ESTIMATE", "frame_stm32_us is set"),
    Value(2, "FRAME_HAS_BOUND", "bound_us is set"),
    Value(4, "FRAME_COLD", "the first second, or the clocks' rates are not known yet"),
    Value(8, "FRAME_HOLDOVER", "no stamp for 0.25 s: the estimate runs on the last rate"),
    Value(16, "FRAME_QUARANTINE", "the last stamps contradict the ones before"),
    Value(32, "FRAME_STUCK", "the STM32's time stands still"),
    Value(64, "FRAME_EPOCH_NEW", "the epoch, not the first, is less than 1 s old"),
    Value(128, "FRAME_BEFORE_EPOCH", "the frame is older than the epoch"),
    Value(256, "FRAME_QUANTISED", "the GAP8's stamp clock counts in steps of more than 1 us"),
    Value(512, "FRAME_REFUSED", "there is a reason why no estimate is given"),
)

LIMITS = (
    Value(1012, "NATIVE_DATA_BODY_MAX", "bytes of body in a data message"),
    Value(48, "NATIVE_PAIRS_MAX", "pairs in one message"),
)


def message(kind: int, *fields: Any) -> Any:
    return Struct("magic" / Const(0x4E, Int8ul) * "magic", "kind" / Const(kind, Int8ul) * "kind", *fields)


def sealed(covered: Any, *behind: Any) -> Any:
    """That message and a check of it. `behind`: what comes after the check."""
    whole = FocusedSeq(
        "covered",
        "covered" / RawCopy(covered),
        "check32" / Checksum(Int32ul, crc32, this.covered.data) * "CRC-32 of all before it",
        *behind,
    )
    return ExprAdapter(whole, lambda found, _: found.value, lambda value, _: {"value": value})


FRAME_FIELDS = message(
    1,
    "header_bytes"
    / Default(OneOf(Int16ul, range(104, 65536)), 144)
    * "bytes of this message, 144 for what is described here; not more than there are",
    "frame" / Int32ul * "+1 for each frame that the camera completed, sent or not; wraps",
    "width" / SIDE * "pixels, 1..1024",
    "height" / SIDE * "pixels, 1..1024",
    "depth" / DEPTH * "bytes per pixel, 1..4",
    "encoding" / ENCODING * "0 raw, 1 JPEG",
    "flags" / Int16ul * "sum of FRAME_ flags",
    "body_bytes" / BODY_BYTES * "1..1048576; raw: width x height x depth",
    "body_crc32" / Int32ul * "CRC-32 of the body",
    "frame_gap8_us" / Int64ul * "us, GAP8 stamp clock at end of frame, raw",
    "frame_stm32_us" / Int64ul * "us, estimate of the STM32 stamp clock at end of frame",
    "bound_us" / Int32ul * "us, of the estimate, either side, 99 %; latency_us is in it",
    "epoch" / Int8ul * "of the STM32 stamp clock, from the stamp message",
    "analog_gain" / Int8ul * "1, 2, 4 or 8",
    "digital_gain" / Int8ul * "1/64",
    "burst" / Int8ul * "images of the burst that this frame belongs to",
    "exposure_lines" / Int32ul * "lines",
    "line_time_ns" / Int32ul * "ns of GAP8 time from row to row",
    "stamp_sequence" / Int32ul * "of the last stamp before the frame",
    "stamp_age_us" / Int32ul * "us, frame_gap8_us less its arrival; 4294967295: none yet",
    "stamps_received" / Int32ul * "good stamp messages",
    "stamps_missed" / Int32ul * "gaps in their sequence",
    "stamps_bad" / Int32ul * "CRC or garbage on UART1",
    "pairs_lost" / Int32ul * "pairs received and not reported, for want of room",
    "captures_failed" / Int32ul * "the camera said so, or never answered",
    "captures_late" / Int32ul * "captures not started: no free buffer",
    "frames_unsent" / Int32ul * "captured and not sent: nobody connected, or given up",
    "spi_errors" / Int32ul * "packets on SPI that made no sense",
    "packets_dropped" / Int32ul * "packets dropped by the GAP8, for want of room",
    Check(lambda this: raw_size_ok(this, this.encoding, this.body_bytes)),
)
CLOCK_FIELDS = Struct(
    "window_us" / Int32ul * "us, what the estimate is from: stamps of so long",
    "window_stamps" / Int32ul * "and so many; 0: nothing is said, here and in the fields below",
    "delay_us" / Int32ul * "us, mean delay of the stamps above the smallest",
    "skew_ppb" / Int32sl * "1e-9, how much faster the STM32's stamp clock is than the GAP8's",
    "latency_us" / Int32ul * "us, part of bound_us: how late the end of frame was read is known so well",
)
ECHO_FIELDS = Struct(
    "minimum_delay_us" / Int32ul * "us, of a message on UART1 one way, beyond its time on the wire",
    "minimum_delay_error_us" / Int32ul * "us, of that, either side",
    "echoes" / Int32ul * "that it is from; 0: nothing is said of it",
)
ECHO = Struct(
    "covered" / RawCopy(ECHO_FIELDS),
    "echo_check32"
    / Checksum(Int32ul, crc32, lambda this: before_echo(this) + this.covered.data)
    * "CRC-32 of all before it",
    Padding(this._._.covered.value.header_bytes - 144) * "fields of later versions, ignored",
)


def before_echo(this: Any) -> bytes:
    """The bytes of a frame message before its echo's."""
    frame, clock = this._._, this._
    checks = Int32ul.build(frame.check32), Int32ul.build(clock.clock_check32)
    return bytes(frame.covered.data + checks[0] + clock.covered.data + checks[1])


def has_echo(this: Any) -> bool:
    """In the struct of the clock."""
    return bool(this._.covered.value.header_bytes >= 144)


CLOCK = Struct(
    "covered" / RawCopy(CLOCK_FIELDS),
    "clock_check32"
    / Checksum(Int32ul, crc32, lambda this: this._.covered.data + Int32ul.build(this._.check32) + this.covered.data)
    * "CRC-32 of all before it",
    "echo" / IfThenElse(has_echo, ECHO, Padding(this._.covered.value.header_bytes - 128)),
)


def has_clock(this: Any) -> bool:
    return bool(this.covered.value.header_bytes >= 128)


def whole_frame(found: Any, _: Any) -> Any:
    clock = found.clock if has_clock(found) else None
    echo = clock.echo if clock and clock.echo else None
    parts = [
        part.covered.value if part else dict.fromkeys(each.name for each in fields.subcons)
        for part, fields in ((clock, CLOCK_FIELDS), (echo, ECHO_FIELDS))
    ]
    return Container(found.covered.value | parts[0] | parts[1])


def parts_of_frame(values: Any, _: Any) -> Any:
    clock, echo = (
        {"covered": {"value": {each.name: values.get(each.name, 0) for each in fields.subcons}}}
        for fields in (CLOCK_FIELDS, ECHO_FIELDS)
    )
    return {"covered": {"value": values}, "clock": clock | {"echo": echo}}


FRAME = ExprAdapter(
    Struct(
        "covered" / RawCopy(FRAME_FIELDS),
        "check32" / Checksum(Int32ul, crc32, this.covered.data) * "CRC-32 of all before it",
        "clock" / IfThenElse(has_clock, CLOCK, Padding(this.covered.value.header_bytes - 104)),
    ),
    whole_frame,
    parts_of_frame,
)
"""The fields from window_us on came later, and those from minimum_delay_us on later still: a message of less than 128
bytes ends with its first check, one of less than 144 with its second."""

DATA = message(
    2,
    "frame_low" / Int16ul * "low 16 bits of the frame's number",
    "offset" / Int32ul * "bytes of the body before this piece",
    "body" / GreedyBytes * "a piece of the body, never empty",
    Check(lambda this: len(this.body) > 0),
)

PAIR = Struct(
    "sequence" / Int32ul * "of the stamp message",
    "stm32_us" / Int64ul * "us, STM32 stamp clock: the time in the message",
    "gap8_us" / Int64ul * "us, GAP8 stamp clock at the last stop bit of the message",
    "epoch" / Int8ul * "of the STM32 stamp clock",
)

PAIRS = sealed(
    message(
        3,
        "count" / Rebuild(OneOf(Int8ul, range(1, 49)), lambda this: len(this.pairs)) * "pairs, 1..48",
        Padding(1) * "written as 0, ignored",
        "lost" / Int32ul * "pairs lost so far, as pairs_lost in a frame message",
        "pairs" / Array(this.count, PAIR) * "see Pair",
    )
)

STATUS = sealed(
    message(
        4,
        Padding(2) * "written as 0, ignored",
        "up_us" / Int64ul * "us, ESP32 uptime",
        "frames_forwarded" / Int32ul * "whole frames",
        "frames_dropped" / Int32ul * "whole frames, because TCP was too slow",
        "frames_cut" / Int32ul * "the GAP8 began a new frame before the last was complete",
        "packets_forwarded" / Int32ul * "packets on any link",
        "packets_dropped" / Int32ul * "packets other than images, for want of room",
        "packets_unroutable" / Int32ul * "packets with an end or a version that does not exist",
        "uart_bad_check" / Int32ul * "frames on UART2 with a bad check byte",
        "uart_bad_length" / Int32ul * "frames on UART2 with a length out of range",
        "uart_garbage_bytes" / Int32ul * "bytes on UART2 outside any frame",
        "uart_gaps" / Int32ul * "frames on UART2 given up half-way",
        "spi_errors" / Int32ul * "packets on SPI that made no sense",
        "tcp_skipped_bytes" / Int32ul * "bytes from the host skipped to find a header",
    )
)

REPLY = message(
    5,
    "request" / Int8ul * "kind of the request",
    "status" / Int8ul * "0 done; n: the n-th field of the request is out of range, nothing was changed",
)

LOG_STATES = (
    Value(0, "LOG_OFF", "nobody has told the robot to log"),
    Value(1, "LOG_STARTS", "reads config.txt, or makes the file"),
    Value(2, "LOG_ON", "logs"),
    Value(3, "LOG_CLOSES", "was told to stop, and writes the end"),
    Value(4, "LOG_NO_CARD", "there is none, or no longer"),
    Value(5, "LOG_NO_CONFIG", "no config.txt on the card"),
    Value(6, "LOG_BAD_CONFIG", "config.txt says nothing that can be logged"),
    Value(7, "LOG_NO_NAME", "all hundred names are taken"),
    Value(8, "LOG_FULL", "the card is full"),
    Value(9, "LOG_FAILED", "the card takes no log any more"),
)

LOG = sealed(
    message(
        6,
        "state" / OneOf(Int8ul, range(10)) * "one of LOG_; from LOG_NO_CARD on it has ended by itself",
        "epoch" / Int8ul * "of the STM32 stamp clock",
        "stm32_us" / Int64ul * "us, STM32 stamp clock when this message was made",
        "files" / Int32ul * "logs begun since boot",
        "session" / Int32ul * "of the log, as in its status rows; 0: none yet",
        "requested" / Int32ul * "rows that were due, and events",
        "accepted" / Int32ul * "of these, in the log or on their way",
        "dropped" / Int32ul * "of these, not in the log",
        "stall_us" / Int32ul * "us, longest operation of the card",
        "syncs" / Int32ul * "after each, all before is safe",
        "errors" / Int32ul * "operations of the card that failed",
        "card_errors" / Int32ul * "likewise, since boot: in all logs and between them",
    )
)

STREAM = message(
    16,
    "dialect" / OneOf(Int8ul, (0, 1)) * "0 stock, 1 native",
    Padding(1) * "written as 0, ignored",
    "data_max" / OneOf(Int16ul, (0, *range(144, 1021))) * "longest CPX data wanted, 144..1020 bytes; 0: 1020",
)

CAMERA = message(
    17,
    "auto_exposure" / Int8ul * "0 or 1",
    "analog_gain" / Int8ul * "1, 2, 4 or 8",
    "digital_gain" / Int8ul * "1/64, 1..255",
    "burst" / Int8ul * "images back to back, 1..3",
    "encoding" / Int8ul * "0 raw, 1 JPEG",
    Padding(1) * "written as 0, ignored",
    "exposure_lines" / Int16ul * "lines, 2..65535",
    "frame_period_us" / Int32ul * "us from burst to burst, at most 10 000 000; 0: as fast as it goes",
)

CAMERA_RANGES = (
    ("auto_exposure", (0, 1)),
    ("analog_gain", (1, 2, 4, 8)),
    ("digital_gain", range(1, 256)),
    ("burst", range(1, 4)),
    ("encoding", (0, 1)),
    ("exposure_lines", range(2, 65536)),
    ("frame_period_us", range(10_000_001)),
)


def camera_check(camera: Any) -> int:
    """0, or the 1-based place of the first field that is out of range: the status of the reply."""
    for place, (name, allowed) in enumerate(CAMERA_RANGES, 1):
        if camera[name] not in allowed:
            return place
    return 0
