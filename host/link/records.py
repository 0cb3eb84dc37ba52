"""What a session hands out: plain records, one class per kind, each field with its unit and its clock.

`arrival_host_ns` is the host's clock when the last byte of the thing was read: monotonic time for a real port, true
time for a simulated one.
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import PeerError

Encoding = Literal["raw", "jpeg"]

PAIR_DTYPE = np.dtype([("sequence", "<u4"), ("stm32_us", "<u8"), ("gap8_us", "<u8"), ("epoch", "u1")])
"""One stamp message as the GAP8 received it: its number, STM32 time in it, GAP8 time of its last stop bit."""


@dataclass(frozen=True, slots=True)
class NativeClock:
    """How the GAP8 came to its estimate of a frame's STM32 time."""

    window_us: int
    """GAP8 time over which it has used stamp messages."""
    window_stamps: int
    """How many."""
    delay_us: int
    """Their mean delay, above the smallest. The smallest itself cannot be seen."""
    skew_ppb: int
    """How much faster the STM32's stamp clock is than the GAP8's."""
    latency_us: int
    """Part of bound_us: how late the GAP8's clock was read at the end of frame is known so well."""

    @property
    def drift_ppm(self) -> float:
        """How much faster the GAP8's stamp clock is than the STM32's, as `host sync stamps` has it."""
        return (1 / (1 + self.skew_ppb * 1e-9) - 1) * 1e6


@dataclass(frozen=True, slots=True)
class NativeEcho:
    """What echoes on UART1 say of the delay that all stamp messages have, beyond their time on the wire. It is in no
    frame's time or bound: how much of a round trip is on the way of the stamps cannot be known."""

    minimum_delay_us: int
    """Half of the fastest of the last echoes."""
    minimum_delay_error_us: int
    """Of that, either side: the other half, and what the clocks' steps and rates add."""
    echoes: int
    """That it is from."""


@dataclass(frozen=True, slots=True)
class NativeHeader:
    """The native frame header, field for field (firmware/core/image.h, native_frame_t)."""

    frame: int
    flags: int
    flag_names: tuple[str, ...]
    """Of `flags`, as in docs/PROTOCOL.md without FRAME_."""
    body_crc32: int
    frame_gap8_us: int
    """GAP8 stamp clock at end of frame, raw."""
    frame_stm32_us: int | None
    """Estimated STM32 stamp clock at end of frame; None when the robot gives none."""
    bound_us: int | None
    """Of frame_stm32_us, either side, 99 %; None when the robot gives none."""
    epoch: int
    analog_gain: int
    digital_gain: int
    """In 1/64."""
    burst: int
    exposure_lines: int
    line_time_ns: int
    stamp_sequence: int
    stamp_age_us: int | None
    clock: NativeClock | None
    """None when the robot says nothing about it: no estimate, or earlier firmware."""
    echo: NativeEcho | None
    """None when no echo has come back, or of earlier firmware."""
    counters: dict[str, int]
    """The GAP8's counters since its boot, by their names in native_frame_t."""


@dataclass(frozen=True, slots=True)
class Pose:
    """Of the robot in the world, by its own estimator: metres, unit quaternion."""

    x_m: float
    y_m: float
    z_m: float
    qx: float
    qy: float
    qz: float
    qw: float


@dataclass(frozen=True, slots=True)
class PaperHeader:
    """What the dataset paper's firmware adds to the stock frame header (firmware/core/paper.h)."""

    frame_ms: int
    """STM32 stamp clock in ms, as the GAP8 has worked it out; while `heard` is False, the GAP8's own ticks."""
    heard: bool
    """The GAP8 has had a time message."""
    pose: Pose | None
    """At the time message, not at the frame; None when nothing was heard or the estimator gave no numbers."""


@dataclass(frozen=True, slots=True)
class NanocockpitState:
    """What the STM32 knew about its motion, as NanoCockpit sends it (nanocockpit_state_t)."""

    stm32_time: int
    """FreeRTOS ticks of 1 ms, or the low 32 bits of the stamp clock in us: the wire does not say which."""
    x_mm: int
    y_mm: int
    z_mm: int
    vx_mm_s: int
    vy_mm_s: int
    vz_mm_s: int
    ax_mm_s2: int
    ay_mm_s2: int
    az_mm_s2: int
    quat: int
    """A unit quaternion in 32 bits."""
    roll_mrad_s: int
    pitch_mrad_s: int
    yaw_mrad_s: int

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """x, y, z, w; each good to 0.0007."""
        largest, rest = self.quat >> 30, self.quat
        values = [0.0] * 4
        for place in (3, 2, 1, 0):
            if place != largest:
                size = (rest & 511) / 511 * math.sqrt(0.5)
                values[place] = -size if rest >> 9 & 1 else size
                rest >>= 10
        values[largest] = math.sqrt(max(0.0, 1 - sum(value * value for value in values)))
        x, y, z, w = values
        return x, y, z, w


@dataclass(frozen=True, slots=True)
class NanocockpitHeader:
    """NanoCockpit's image metadata, version 10 (nanocockpit_metadata_t). Its clock is the GAP8's, in 32 bits."""

    frame_id: int
    """The sensor's own counter, 8 bits."""
    checked: bool
    """The frame came with a CRC-32, and it matches."""
    frame_gap8_us: int
    """End of frame."""
    state_gap8_us: int
    """When `state` had come in; 0: none yet."""
    state: NanocockpitState
    ranges_gap8_us: int
    """When `ranges` had come in; 0: none yet."""
    ranges: tuple[int, ...]
    """Of a distance sensor with 16 or 64 zones, else empty."""
    reply_frame_gap8_us: int
    """frame_gap8_us of the frame that the host has answered last; 0: none."""
    reply_gap8_us: int
    """When that answer had come in."""
    inference_stm32_time: int
    inference: tuple[float, ...] | None
    """Four numbers of the network on board; None when they are none."""

    @property
    def round_trip_us(self) -> int | None:
        """From the end of the frame that the host has answered last until its answer was back, GAP8 time; None when
        the host does not answer."""
        return (self.reply_gap8_us - self.reply_frame_gap8_us) % (1 << 32) if self.reply_frame_gap8_us else None


@dataclass(slots=True)
class Frame:
    """One complete image. `body` is the receiver's own memory: keep it as long as you like."""

    index: int
    """Complete frames received before this one, on earlier connections of the same stream too."""
    arrival_host_ns: int
    width: int
    height: int
    depth: int
    """Bytes per pixel."""
    encoding: Encoding
    body: NDArray[np.uint8]
    """Shape (bytes,): pixels row by row, or a JPEG file."""
    native: NativeHeader | None = None
    """Of a native frame."""
    pairs: NDArray[np.void] | None = None
    """dtype PAIR_DTYPE: the stamp messages that the GAP8 reported since the frame before; native only."""
    paper: PaperHeader | None = None
    """Of a frame from the dataset paper's firmware."""
    nanocockpit: NanocockpitHeader | None = None
    """Of a frame from NanoCockpit. A frame with none of the three is stock: it carries no time."""

    @property
    def dialect(self) -> Literal["stock", "paper", "nanocockpit", "native"]:
        """Which firmware sends such frames."""
        if self.native:
            return "native"
        if self.nanocockpit:
            return "nanocockpit"
        return "paper" if self.paper else "stock"

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """Shape (height, width), or (height, width, depth). A JPEG is decoded at each call; PeerError if broken."""
        if self.encoding == "jpeg":
            return decode_jpeg(self.body, self.width, self.height)
        shape = (self.height, self.width) if self.depth == 1 else (self.height, self.width, self.depth)
        return self.body.reshape(shape)

    @property
    def frame_stm32_us(self) -> int | None:
        """Estimated STM32 time of the end of this frame, or None: native and paper only. NanoCockpit leaves that to
        whoever has many pairs of its state's two times."""
        if self.native:
            return self.native.frame_stm32_us
        return self.paper.frame_ms * 1000 if self.paper and self.paper.heard else None

    def row_before_end_us(self, row: float) -> float | None:
        """From the middle of a row's exposure to the end of frame, GAP8 time; row 0 is the top one, (height - 1) / 2
        the middle. None of frames that do not say how they were taken: all but native."""
        if not self.native:
            return None
        lines = self.height - 1 - row + self.native.exposure_lines / 2
        return lines * self.native.line_time_ns / 1000

    def row_stm32_us(self, row: float) -> float | None:
        """Estimated STM32 time of the middle of a row's exposure, by row_before_end_us; its bound is that of the end of
        frame. None without an estimate, or of frames that do not say how they were taken."""
        before_end_us = self.row_before_end_us(row)
        if self.native is None or self.native.frame_stm32_us is None or before_end_us is None:
            return None
        return self.native.frame_stm32_us - before_end_us * (self.stm32_per_gap8 or 1)

    @property
    def stm32_per_gap8(self) -> float | None:
        """How fast the STM32's clock runs on the GAP8's, as the GAP8 found it; None when it does not say."""
        return 1 + self.native.clock.skew_ppb * 1e-9 if self.native and self.native.clock else None


def decode_jpeg(body: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """Shape (height, width). PeerError when the file is damaged or of another size than its header said."""
    from PIL import Image

    try:
        with Image.open(io.BytesIO(body.tobytes()), formats=["JPEG"]) as image:
            if image.size != (width, height):
                raise PeerError(f"JPEG is {image.size[0]}x{image.size[1]}, its header said {width}x{height}")
            return np.asarray(image.convert("L"))
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise PeerError(f"JPEG cannot be decoded: {error}") from error


@dataclass(frozen=True, slots=True)
class LostFrame:
    """A frame that began and never came whole: what arrived is kept aside and is never shown as a picture."""

    arrival_host_ns: int
    cause: str
    """A key of SessionCounters.frames_lost."""
    received_bytes: int
    expected_bytes: int
    body: NDArray[np.uint8]
    """Shape (expected_bytes,): what came, zero elsewhere."""
    frame: int | None = None
    """native_frame_t.frame, when known."""


@dataclass(frozen=True, slots=True)
class Stamp:
    """A stamp message heard on UART1."""

    arrival_host_ns: int
    sequence: int
    stm32_us: int
    epoch: int


@dataclass(frozen=True, slots=True)
class PaperStamp:
    """A time message of the dataset paper's firmware, heard on UART1."""

    arrival_host_ns: int
    stm32_us: int
    pose: Pose | None
    """None when the estimator gave no numbers."""


@dataclass(frozen=True, slots=True)
class NanocockpitStamp:
    """A state of NanoCockpit's, heard on UART1."""

    arrival_host_ns: int
    state: NanocockpitState


@dataclass(frozen=True, slots=True)
class Console:
    """Text that an MCU printed."""

    arrival_host_ns: int
    source: str
    text: str


@dataclass(frozen=True, slots=True)
class Status:
    """The ESP32's counters since its boot (native_status_t), native only."""

    arrival_host_ns: int
    up_us: int
    counters: dict[str, int]


LogState = Literal[
    "off", "starts", "on", "closes", "no_card", "no_config", "bad_config", "no_name", "full", "failed"
]  # fmt: skip
"""By log_state_t (firmware/core/native_log.h)."""


@dataclass(frozen=True, slots=True)
class LogStatus:
    """How complete the log on the STM32's card is (native_log_t), native only."""

    arrival_host_ns: int
    state: LogState
    stm32_us: int
    """STM32 stamp clock when it was so."""
    epoch: int
    files: int
    """Logs begun since boot."""
    session: int
    """Of the log, as in its status rows; 0: there was none yet."""
    counters: dict[str, int]
    """Of this log: requested, accepted, dropped (rows), stall_us, syncs, errors. Since boot: card_errors."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The GAP8's answer to a request."""

    arrival_host_ns: int
    request: int
    status: int
    """0 done; n: the n-th field of the request was out of range."""


@dataclass(frozen=True, slots=True)
class Packet:
    """Any other CPX packet."""

    arrival_host_ns: int
    source: int
    destination: int
    function: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Garbage:
    """Bytes that are no part of anything, skipped to find the next packet."""

    arrival_host_ns: int
    offset: int
    """Of the first such byte in the stream."""
    size: int


@dataclass(frozen=True, slots=True)
class Announced:
    """The robot speaks native and would do so if asked."""

    arrival_host_ns: int


Condition = Literal[
    "waiting", "streaming", "no_bytes", "no_packets", "no_frames", "broken_frames", "no_stamps", "disconnected"
]


@dataclass(frozen=True, slots=True)
class State:
    """Which side is silent has changed. Of a port's stream only: a session alone does not judge."""

    arrival_host_ns: int
    """When it was noticed."""
    state: Condition
    since_host_ns: int
    """Since when it has been so."""
    reason: str
    """Why there is no connection; empty while there is one."""


Event = (
    Frame
    | LostFrame
    | Stamp
    | PaperStamp
    | NanocockpitStamp
    | Console
    | Status
    | LogStatus
    | Reply
    | Packet
    | Garbage
    | Announced
    | State
)


@dataclass(slots=True)
class SessionCounters:
    """Everything that a session has counted since it began. A copy: reading it later gives later figures."""

    bytes: int = 0
    packets: dict[str, int] = field(default_factory=dict)
    """By function: system, console, crtp, wifi_ctrl, app, streamer, test, bootloader."""
    frames: int = 0
    frames_lost: dict[str, int] = field(default_factory=dict)
    """By cause: a key of LOSS_CAUSES. Each lost frame is in exactly one; only `unexplained` may shrink, when the
    ESP32's next status explains it."""
    garbage_bytes: int = 0
    cut_bytes: int = 0
    """Of garbage_bytes: the beginning of a packet whose rest never came, as the connection, or a recording, ended."""
    bad_version: int = 0
    unknown_function: int = 0
    stray_packets: int = 0
    """Pieces of images whose frame is lost already."""
    bad_messages: int = 0
    """Messages of the native dialect and of NanoCockpit that cannot be decoded."""
    renumbered: int = 0
    """Native frame numbers began anew or jumped: the GAP8 has restarted, or had taken this host for gone. What was
    lost there is not known."""
    stamps: int = 0
    pairs: int = 0
    pairs_lost: int = 0
    """By the GAP8 since the first report, or here because no frame came that could carry them."""
    bad_check: int = 0
    """Packets (CPX over UART) or stamp messages with a wrong checksum."""
    bad_length: int = 0
    """CPX over UART: a length byte out of range."""
    credits: int = 0
    """CPX over UART: heard from the other end."""
    gaps: int = 0
    """CPX over UART: packets that stopped half-way."""

    def __add__(self, other: SessionCounters) -> SessionCounters:
        """Of two connections together."""
        total = SessionCounters()
        for each in fields(self):
            mine, theirs = getattr(self, each.name), getattr(other, each.name)
            if isinstance(mine, dict):
                setattr(total, each.name, {key: mine.get(key, 0) + theirs.get(key, 0) for key in {**mine, **theirs}})
            else:
                setattr(total, each.name, mine + theirs)
        return total


LOSS_CAUSES = {
    "cut_short": "not native: the next frame began before this one was complete",
    "overrun": "a piece reached beyond the size that the header announced",
    "missing_data": "native: pieces of it, or its header, never came",
    "bad_crc": "native, NanoCockpit: all came, and the CRC-32 does not match",
    "bad_jpeg": "all came, and it does not start and end as a JPEG does",
    "garbage": "not native: garbage in the middle of it",
    "disconnected": "the connection ended",
    "gap8_unsent": "captured and never sent, says the GAP8",
    "esp32_dropped": "dropped whole because the connection was too slow, says the ESP32",
    "unexplained": "its number was skipped and nobody has said why",
}
