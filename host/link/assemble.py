"""Records out of what the C stream reports: frames with their checks, messages, counters. Pure."""

from __future__ import annotations

import math
import zlib
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..native import ffi, lib
from ..protocol.errors import PeerError
from .counters import SessionCounters
from .frame import PAIR_DTYPE, Encoding, decode_jpeg
from .headers import NanocockpitHeader, NanocockpitState, NativeClock, NativeEcho, NativeHeader, PaperHeader, Pose
from .records import Console, LogState, LogStatus, NanocockpitStamp, Packet, PaperStamp, Reply, Stamp, Status

TARGETS = {lib.CPX_STM32: "STM32", lib.CPX_ESP32: "ESP32", lib.CPX_HOST: "host", lib.CPX_GAP8: "GAP8"}
FUNCTIONS = {
    "system": lib.CPX_SYSTEM,
    "console": lib.CPX_CONSOLE,
    "crtp": lib.CPX_CRTP,
    "wifi_ctrl": lib.CPX_WIFI_CTRL,
    "app": lib.CPX_APP,
    "streamer": lib.CPX_STREAMER,
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
LOG_STATES: tuple[LogState, ...] = get_args(LogState)
LOG_COUNTERS = ("requested", "accepted", "dropped", "stall_us", "syncs", "errors", "card_errors")
STATUS_COUNTERS = tuple(name for name, _ in ffi.typeof("native_status_t").fields if name != "up_us")
FLAGS = {
    name.removeprefix("FRAME_"): getattr(lib, name)
    for name in (
        *["FRAME_HAS_ESTIMATE", "FRAME_HAS_BOUND", "FRAME_COLD", "FRAME_HOLDOVER", "FRAME_QUARANTINE", "FRAME_STUCK"],
        *["FRAME_EPOCH_NEW", "FRAME_BEFORE_EPOCH", "FRAME_QUANTISED", "FRAME_REFUSED"],
    )
}
ECHO_FIELDS = ("minimum_delay_us", "minimum_delay_error_us", "echoes")
CLOCK_FIELDS = ("window_us", "window_stamps", "delay_us", "skew_ppb", "latency_us")
NO_STAMP_YET = 0xFFFFFFFF
NO_ZERO = 0xFFFFFFFF
STATE_FIELDS = tuple(name for name, _ in ffi.typeof("nanocockpit_state_t").fields)
JPEG_START, JPEG_END = b"\xff\xd8", b"\xff\xd9"


def encoding(frame: Any) -> Encoding:
    """Of a stream_frame_t."""
    return "jpeg" if frame.type == lib.IMAGE_JPEG else "raw"


def fault(frame: Any, body: NDArray[np.uint8]) -> str | None:
    """Why a body that came whole is not good (a key of LOSS_CAUSES), or None.

    Without a CRC a JPEG is decoded to see: that finds cut and garbled files, not every flipped bit of the contents.
    """
    if frame.dialect == lib.DIALECT_NATIVE and zlib.crc32(body.data) != frame.header.body_crc32:
        return "bad_crc"
    # A computed 0 is sent as all ones: 0 means that there is none.
    if frame.check and (zlib.crc32(body.data, frame.check_so_far) or NO_ZERO) != frame.check:
        return "bad_crc"
    if frame.type != lib.IMAGE_JPEG:
        return None
    if body.size < 4 or body[:2].tobytes() != JPEG_START or body[-2:].tobytes() != JPEG_END:
        return "bad_jpeg"
    if frame.dialect != lib.DIALECT_NATIVE:
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
        flag_names=tuple(name for name, flag in FLAGS.items() if flags & flag),
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
        clock=NativeClock(*(getattr(header, name) for name in CLOCK_FIELDS)) if header.window_stamps else None,
        echo=NativeEcho(*(getattr(header, name) for name in ECHO_FIELDS)) if header.echoes else None,
        counters={name: getattr(header, name) for name in FRAME_COUNTERS},
    )


def paper_header(header: Any) -> PaperHeader:
    """Of a paper_header_t."""
    raw = header.pose
    return PaperHeader(header.frame_stm32_ms, any((raw.qx, raw.qy, raw.qz, raw.qw)), pose(raw))


def pose(raw: Any) -> Pose | None:
    """Of a pose_t."""
    values = (raw.x_m, raw.y_m, raw.z_m, raw.qx, raw.qy, raw.qz, raw.qw)
    return Pose(*values) if all(map(math.isfinite, values)) and any(values[3:]) else None


def state(raw: Any) -> NanocockpitState:
    """Of a nanocockpit_state_t."""
    return NanocockpitState(*(getattr(raw, name) for name in STATE_FIELDS))


def nanocockpit_header(frame: Any) -> NanocockpitHeader:
    """Of a stream_frame_t."""
    metadata = frame.nanocockpit
    inference = tuple(metadata.inference)
    return NanocockpitHeader(
        frame_id=metadata.frame_id,
        checked=frame.check != 0,
        frame_gap8_us=metadata.frame_gap8_us,
        state_gap8_us=metadata.state_gap8_us,
        state=state(metadata.state),
        ranges_gap8_us=metadata.ranges_gap8_us,
        ranges=tuple(metadata.ranges[0 : min(metadata.ranges_count, len(metadata.ranges))]),
        reply_frame_gap8_us=metadata.reply_frame_gap8_us,
        reply_gap8_us=metadata.reply_gap8_us,
        inference_stm32_time=metadata.inference_stm32_time,
        inference=inference if all(map(math.isfinite, inference)) else None,
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


def log_status(data: bytes, arrival_host_ns: int) -> LogStatus:
    """A native log message that the C has found good."""
    decoded = ffi.new("native_log_t *")
    lib.native_log_decode((ffi.from_buffer("uint8_t[]", data), len(data)), decoded)
    return LogStatus(
        arrival_host_ns,
        LOG_STATES[decoded.state],
        decoded.stm32_us,
        decoded.epoch,
        decoded.files,
        decoded.session,
        {name: getattr(decoded, name) for name in LOG_COUNTERS},
    )


def reply(data: bytes, arrival_host_ns: int) -> Reply:
    """A native reply that the C has found good."""
    decoded = ffi.new("native_reply_t *")
    lib.native_reply_decode((ffi.from_buffer("uint8_t[]", data), len(data)), decoded)
    return Reply(arrival_host_ns, decoded.request, decoded.status)


def stamp(message: Any, arrival_host_ns: int) -> Stamp | PaperStamp | NanocockpitStamp:
    """Of a uart1_message_t."""
    if message.kind == lib.UART1_PAPER:
        return PaperStamp(arrival_host_ns, message.paper.stm32_us, pose(message.paper.pose))
    if message.kind == lib.UART1_NANOCOCKPIT:
        return NanocockpitStamp(arrival_host_ns, state(message.state))
    return Stamp(arrival_host_ns, message.stamp.sequence, message.stamp.stm32_us, message.stamp.epoch)


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
