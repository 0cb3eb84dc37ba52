"""What a session hands out: plain records, one class per kind, each field with its unit and its clock.

`arrival_host_ns` is the host's clock when the last byte of the thing was read: monotonic time for a real port, true
time for a simulated one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from .frame import Frame, LostFrame
from .headers import NanocockpitState, Pose


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
