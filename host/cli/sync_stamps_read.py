"""What `host sync stamps` reads out of a recording."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..clock.frame_ends import Readings
from ..clock.stamps import WIRE_US
from ..link.frame import PAIR_DTYPE, Frame
from ..link.headers import NativeEcho
from .row import Row

NANOCOCKPIT_WIRE_US = 40 * 10 * 365 / 42
WHAT_IS_THERE = ("HAS_ESTIMATE", "HAS_BOUND")
"""Flags that say nothing of what a time is worth."""


@dataclass(frozen=True, slots=True)
class Source:
    """One robot's frames, in their order, and all messages with both clocks."""

    robot: int
    dialects: dict[str, int]
    """Frames by firmware."""
    stm32: np.ndarray[Any, np.dtype[np.uint64]]
    gap8: np.ndarray[Any, np.dtype[np.uint64]]
    resets: np.ndarray[Any, np.dtype[np.int64]] | None
    index: list[int]
    """Of each frame with a GAP8 time, in the recording ..."""
    number: list[int]
    """... and on the robot."""
    arrival_ns: list[int]
    """On the host's clock, likewise."""
    frame_gap8: np.ndarray[Any, np.dtype[np.uint64]]
    frame_after: np.ndarray[Any, np.dtype[np.int64]]
    own_stm32_us: np.ndarray[Any, np.dtype[np.float64]]
    """The robot's estimates; NaN: none."""
    own_flags: list[tuple[str, ...]]
    """What it said of each of them, named as in docs/PROTOCOL.md without FRAME_."""
    before_end_us: np.ndarray[Any, np.dtype[np.float64]]
    """GAP8 time from the middle of the wanted row's exposure to the end of frame; NaN: not told, or no row wanted."""
    readings: Readings
    echo: NativeEcho | None
    """The last that a frame told of."""
    in_ms: bool
    wire_us: float


def read(name: str, robot: int, row: Row | None = None) -> Source:
    """All frames of one robot. LocalError when they have no such row."""
    from ..link.replay_url import to_url
    from ..link.stream import open_stream

    dialects: Counter[str] = Counter()
    pairs: list[Any] = []
    states: list[tuple[int, int]] = []
    index: list[int] = []
    numbers: list[int] = []
    arrivals: list[int] = []
    gap8: list[int] = []
    after: list[int] = []
    own: list[float] = []
    flags: list[tuple[str, ...]] = []
    before_end: list[float | None] = []
    readings: list[tuple[int, tuple[int, ...], float | None]] = []
    echo: NativeEcho | None = None
    messages = 0
    with open_stream(to_url(name, pace="max", robot=robot), timeout=None) as stream:
        for frame in stream:
            dialects[frame.dialect] += 1
            if frame.pairs is not None:
                pairs.append(frame.pairs)
                messages += len(frame.pairs)
            elif frame.nanocockpit and frame.nanocockpit.state_gap8_us:
                states.append((frame.nanocockpit.state.stm32_time, frame.nanocockpit.state_gap8_us))
                messages += 1
            if frame.native or frame.nanocockpit:
                index.append(frame.index)
                numbers.append(number_of(frame))
                arrivals.append(frame.arrival_host_ns)
                gap8.append((frame.native or frame.nanocockpit).frame_gap8_us)  # type: ignore[union-attr]
                after.append(messages)
                own.append(np.nan if frame.frame_stm32_us is None else float(frame.frame_stm32_us))
                flags.append(flags_of(frame))
                before_end.append(frame.row_before_end_us(row.of(frame.height)) if row else None)
                readings.append(reading_of(frame))
                echo = (frame.native and frame.native.echo) or echo
    in_ms = False
    if pairs:
        table = np.concatenate([np.empty(0, PAIR_DTYPE), *pairs])
        stm32, arrived, resets = table["stm32_us"], table["gap8_us"], table["epoch"].astype(np.int64)
    else:
        both = np.array(states, np.uint64).reshape(-1, 2)
        stm32, arrived, resets = both[:, 0], both[:, 1], None
        in_ms = counts_ms(stm32, arrived)
        stm32 = stm32 * np.uint64(1000 if in_ms else 1)
    return Source(
        robot, dict(dialects), stm32, arrived, resets, index, numbers, arrivals, np.array(gap8, np.uint64),
        np.array(after, np.int64), np.array(own), flags, np.array(before_end, np.float64), together(readings),
        echo, in_ms, WIRE_US if pairs else NANOCOCKPIT_WIRE_US,
    )  # fmt: skip


def reading_of(frame: Frame) -> tuple[int, tuple[int, ...], float | None]:
    """Its place in the camera's pace, the settings that move its end, and how late it was read at most."""
    if not frame.native:
        return frame.index, (), None
    at, counted = frame.native, frame.native.counters
    place = at.frame + counted["captures_late"] + counted["captures_failed"]
    settings = frame.height, at.exposure_lines, at.line_time_ns, at.burst
    return place, settings, at.clock.latency_us if at.clock else None


def flags_of(frame: Frame) -> tuple[str, ...]:
    names = frame.native.flag_names if frame.native else ()
    return tuple(name for name in names if name not in WHAT_IS_THERE)


def together(readings: list[tuple[int, tuple[int, ...], float | None]]) -> Readings:
    modes = {each: number for number, each in enumerate(dict.fromkeys(mode for _, mode, _ in readings))}
    return Readings(
        np.array([place for place, _, _ in readings], np.int64),
        np.array([modes[mode] for _, mode, _ in readings], np.int64),
        np.array([latency for _, _, latency in readings], np.float64),
    )


def number_of(frame: Frame) -> int:
    if frame.native:
        return frame.native.frame
    return frame.nanocockpit.frame_id if frame.nanocockpit else frame.index


def counts_ms(stm32: Any, gap8: Any) -> bool:
    """NanoCockpit's wire does not say whether its STM32 time is ticks of 1 ms, or us."""
    if len(stm32) < 3:
        return False
    passed = np.diff(gap8.astype(np.int64))
    return float(np.median(np.diff(stm32.astype(np.int64))[passed > 0] / passed[passed > 0])) < 0.1
