"""What a session hands out: plain records, one class per kind, each field with its unit and its clock.

`arrival_host_ns` is the host's clock when the last byte of the thing was read: monotonic time for a real port, true
time for a simulated one.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, field, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import PeerError

Encoding = Literal["raw", "jpeg"]

PAIR_DTYPE = np.dtype([("sequence", "<u4"), ("stm32_us", "<u8"), ("gap8_us", "<u8"), ("epoch", "u1")])
"""One stamp message as the GAP8 received it: its number, STM32 time in it, GAP8 time of its last stop bit."""


@dataclass(frozen=True, slots=True)
class NativeHeader:
    """The native frame header, field for field (firmware/core/image.h, native_frame_t)."""

    frame: int
    flags: int
    body_crc32: int
    frame_gap8_us: int
    """GAP8 stamp clock at end of frame, raw."""
    frame_stm32_us: int | None
    """Estimated STM32 stamp clock at end of frame; None when the robot gives none."""
    bound_us: int | None
    """Of frame_stm32_us, either side; None when the robot gives none."""
    epoch: int
    analog_gain: int
    digital_gain: int
    """In 1/64."""
    burst: int
    exposure_lines: int
    line_time_ns: int
    stamp_sequence: int
    stamp_age_us: int | None
    counters: dict[str, int]
    """The GAP8's counters since its boot, by their names in native_frame_t."""


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
    """None when the robot speaks stock: then the frame carries no time."""
    pairs: NDArray[np.void] | None = None
    """dtype PAIR_DTYPE: the stamp messages that the GAP8 reported since the frame before; native only."""

    @property
    def pixels(self) -> NDArray[np.uint8]:
        """Shape (height, width), or (height, width, depth). A JPEG is decoded at each call; PeerError if broken."""
        if self.encoding == "jpeg":
            return decode_jpeg(self.body, self.width, self.height)
        shape = (self.height, self.width) if self.depth == 1 else (self.height, self.width, self.depth)
        return self.body.reshape(shape)

    @property
    def frame_stm32_us(self) -> int | None:
        """Estimated STM32 time of the end of this frame, or None."""
        return self.native.frame_stm32_us if self.native else None


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


Event = Frame | LostFrame | Stamp | Console | Status | Reply | Packet | Garbage | Announced | State


@dataclass(slots=True)
class SessionCounters:
    """Everything that a session has counted since it began. A copy: reading it later gives later figures."""

    bytes: int = 0
    packets: dict[str, int] = field(default_factory=dict)
    """By function: system, console, crtp, wifi_ctrl, app, test, bootloader."""
    frames: int = 0
    frames_lost: dict[str, int] = field(default_factory=dict)
    """By cause: a key of LOSS_CAUSES. Each lost frame is in exactly one; only `unexplained` may shrink, when the
    ESP32's next status explains it."""
    garbage_bytes: int = 0
    bad_version: int = 0
    unknown_function: int = 0
    stray_packets: int = 0
    """Pieces of images whose frame is lost already."""
    bad_messages: int = 0
    """Native messages that cannot be decoded."""
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
    "cut_short": "stock: the next frame began before this one was complete",
    "overrun": "a piece reached beyond the size that the header announced",
    "missing_data": "native: pieces of it, or its header, never came",
    "bad_crc": "native: all came, and the CRC-32 does not match",
    "bad_jpeg": "all came, and it does not start and end as a JPEG does",
    "garbage": "stock: garbage in the middle of it",
    "disconnected": "the connection ended",
    "gap8_unsent": "captured and never sent, says the GAP8",
    "esp32_dropped": "dropped whole because the connection was too slow, says the ESP32",
    "unexplained": "its number was skipped and nobody has said why",
}
