"""What the firmwares say of a frame besides its pixels: one class per dialect, fields with their unit and clock."""

from __future__ import annotations

import math
from dataclasses import dataclass


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
