"""Records out of what the C stream reports: frames with their checks, messages, counters. Pure."""

from __future__ import annotations

import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..native import ffi, lib
from ..protocol.errors import PeerError
from .records import (
    PAIR_DTYPE,
    Console,
    Encoding,
    NativeHeader,
    Packet,
    Reply,
    SessionCounters,
    Stamp,
    Status,
    decode_jpeg,
)

TARGETS = {lib.CPX_STM32: "STM32", lib.CPX_ESP32: "ESP32", lib.CPX_HOST: "host", lib.CPX_GAP8: "GAP8"}
FUNCTIONS = {
    "system": lib.CPX_SYSTEM,
    "console": lib.CPX_CONSOLE,
    "crtp": lib.CPX_CRTP,
    "wifi_ctrl": lib.CPX_WIFI_CTRL,
    "app": lib.CPX_APP,
    "test": lib.CPX_TEST,
    "bootloader": lib.CPX_BOOTLOADER,
}
CAUSES = {
    lib.LOST_CUT_SHORT: "cut_short",
    lib.LOST_OVERRUN: "overrun",
    lib.LOST_MISSING_DATA: "missing_data",
    lib.LOST_GARBAGE: "garbage",
    lib.LOST_DISCONNECTED: "disconnected",
}
FRAME_COUNTERS = (
    "stamps_received",
    "stamps_missed",
    "stamps_bad",
    "pairs_lost",
    "captures_failed",
    "captures_late",
    "frames_unsent",
    "spi_errors",
    "packets_dropped",
)
STATUS_COUNTERS = tuple(name for name, _ in ffi.typeof("native_status_t").fields if name != "up_us")
NO_STAMP_YET = 0xFFFFFFFF
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


def encoding(frame: Any) -> Encoding:
    """Of a stream_frame_t."""
    return "jpeg" if frame.type == lib.IMAGE_JPEG else "raw"


def fault(frame: Any, body: NDArray[np.uint8]) -> str | None:
    """Why a body that came whole is not good (a key of LOSS_CAUSES), or None.

    Without a CRC a JPEG is decoded to see: that finds cut and garbled files, not every flipped bit of the contents.
    """
    if frame.native and zlib.crc32(body.data) != frame.header.body_crc32:
        return "bad_crc"
    if frame.type != lib.IMAGE_JPEG:
        return None
    if body.size < 4 or body[:2].tobytes() != JPEG_START or body[-2:].tobytes() != JPEG_END:
        return "bad_jpeg"
    if not frame.native:
        try:
            decode_jpeg(body, frame.width, frame.height)
        except PeerError:
            return "bad_jpeg"
    return None


def native_header(header: Any) -> NativeHeader:
    """Of a native_frame_t."""
    flags = header.flags
    return NativeHeader(
        frame=header.frame,
        flags=flags,
        body_crc32=header.body_crc32,
        frame_gap8_us=header.frame_gap8_us,
        frame_stm32_us=header.frame_stm32_us if flags & lib.FRAME_HAS_ESTIMATE else None,
        bound_us=header.bound_us if flags & lib.FRAME_HAS_BOUND else None,
        epoch=header.epoch,
        analog_gain=header.analog_gain,
        digital_gain=header.digital_gain,
        burst=header.burst,
        exposure_lines=header.exposure_lines,
        line_time_ns=header.line_time_ns,
        stamp_sequence=header.stamp_sequence,
        stamp_age_us=None if header.stamp_age_us == NO_STAMP_YET else header.stamp_age_us,
        counters={name: getattr(header, name) for name in FRAME_COUNTERS},
    )


def packet(route: Any, data: bytes, arrival_host_ns: int) -> Console | Packet:
    """A packet that is no image and no native message."""
    if route.function == lib.CPX_CONSOLE:
        text = data.rstrip(b"\0").decode("utf-8", errors="replace")
        return Console(arrival_host_ns, TARGETS[route.source], text)
    return Packet(arrival_host_ns, route.source, route.destination, route.function, data)


def pairs(data: bytes) -> tuple[NDArray[np.void], int]:
    """The stamp messages in a native pairs message that the C has found good, and the GAP8's count of lost ones."""
    decoded = ffi.new("native_pair_t[]", lib.NATIVE_PAIRS_MAX)
    count, lost = ffi.new("size_t *"), ffi.new("uint32_t *")
    lib.native_pairs_decode((ffi.from_buffer("uint8_t[]", data), len(data)), decoded, count, lost)
    rows = [(pair.sequence, pair.stm32_us, pair.gap8_us, pair.epoch) for pair in decoded[0 : count[0]]]
    return np.array(rows, PAIR_DTYPE), lost[0]


def status(data: bytes, arrival_host_ns: int) -> Status:
    """A native status message that the C has found good."""
    decoded = ffi.new("native_status_t *")
    lib.native_status_decode((ffi.from_buffer("uint8_t[]", data), len(data)), decoded)
    return Status(arrival_host_ns, decoded.up_us, {name: getattr(decoded, name) for name in STATUS_COUNTERS})


def reply(data: bytes, arrival_host_ns: int) -> Reply:
    """A native reply that the C has found good."""
    decoded = ffi.new("native_reply_t *")
    lib.native_reply_decode((ffi.from_buffer("uint8_t[]", data), len(data)), decoded)
    return Reply(arrival_host_ns, decoded.request, decoded.status)


def stamp(event: Any, arrival_host_ns: int) -> Stamp:
    """Of a stream_event_t."""
    return Stamp(arrival_host_ns, event.stamp.sequence, event.stamp.stm32_us, event.stamp.epoch)


def counters(stream: Any) -> SessionCounters:
    """What the C has counted; the session adds the rest."""
    return SessionCounters(
        bytes=stream.bytes,
        packets={name: stream.packets[function] for name, function in FUNCTIONS.items()},
        garbage_bytes=stream.garbage_bytes,
        bad_version=stream.bad_version + stream.uart.bad_version,
        unknown_function=stream.unknown_function,
        stray_packets=stream.stray_packets,
        bad_messages=stream.bad_messages,
        stamps=stream.stamps.received,
        bad_check=stream.uart.bad_check + stream.stamps.bad_check,
        bad_length=stream.uart.bad_length,
        credits=stream.uart.credits_in,
        gaps=stream.uart.gaps,
    )
