"""The C tracker over a run of models.py, in one call."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from models import Floats, Ints, Run
from numpy.typing import NDArray

from host.native import ffi, lib

EVENT = np.dtype([("stm32_us", "u8"), ("gap8_us", "u8"), ("epoch", "u1"), ("frame", "u1")], align=True)
TIME = np.dtype(
    [
        ("flags", "u2"),
        ("epoch", "u1"),
        ("stm32_us", "u8"),
        ("bound_us", "u4"),
        ("latency_us", "u4"),
        ("age_us", "u4"),
        ("window_us", "u4"),
        ("window_count", "u4"),
        ("mean_us", "u4"),
        ("skew_ppb", "i4"),
    ],
    align=True,
)
assert EVENT.itemsize == ffi.sizeof("clock_event_t")
assert TIME.itemsize == ffi.sizeof("clock_time_t")
WRAP = 1 << 64
SEEN = 0xFFFF & ~(lib.FRAME_HAS_ESTIMATE | lib.FRAME_HAS_BOUND | lib.FRAME_QUANTISED)
"""Flags that warn: QUANTISED is a property of the clock."""


@dataclass(frozen=True)
class Tracked:
    times: NDArray[np.void]
    error_us: Floats
    """Estimate less truth; NaN where none is given."""
    at_s: Floats
    track: object

    @property
    def given(self) -> NDArray[np.bool_]:
        return (self.times["flags"] & lib.FRAME_HAS_ESTIMATE) != 0

    @property
    def flagged(self) -> NDArray[np.bool_]:
        return (self.times["flags"] & SEEN) != 0

    @property
    def covered(self) -> NDArray[np.bool_]:
        return np.abs(self.error_us) <= self.times["bound_us"]

    @property
    def wrong_unflagged(self) -> NDArray[np.bool_]:
        return self.given & ~self.flagged & ~self.covered


def onward(readings: Ints) -> Ints:
    """A clock's readings as if it had never been set back."""
    back = np.diff(readings) < -100_000
    return readings + np.concatenate(([0], np.cumsum(np.where(back, readings[:-1] - readings[1:] + 1, 0))))


def in_order(run: Run) -> NDArray[np.intp]:
    """Messages, then frames, as they come; where the GAP8 was started anew, by the number of starts."""
    messages, frames = (
        np.cumsum(np.diff(each, prepend=each[:1]) < -100_000) for each in (run.gap8_us, run.frame_gap8_us)
    )
    return np.lexsort((np.concatenate((run.gap8_us, run.frame_gap8_us)), np.concatenate((messages, frames))))


def tracked(
    run: Run,
    tick_us: float = 1,
    delay_ns: int = 0,
    epochs: Ints | None = None,
    stm32_plus: int = 0,
    gap8_plus: int = 0,
    bits: int = 64,
    latency_us: int = 0,
    regular: bool = True,
) -> Tracked:
    """`stm32_plus`, `gap8_plus`: added to each reading, before it is cut to `bits`. `latency_us`: what the tracker is
    told that 99 % of the frames' readings are not later by."""
    mask = np.uint64((1 << bits) - 1)
    count = len(run.stm32_us)
    events = np.zeros(count + len(run.frame_gap8_us), EVENT)
    gap8_us = np.concatenate((run.gap8_us, run.frame_gap8_us)).astype("u8")
    events["gap8_us"] = (gap8_us + np.uint64(gap8_plus % WRAP)) & mask
    events["stm32_us"][:count] = (run.stm32_us.astype("u8") + np.uint64(stm32_plus % WRAP)) & mask
    events["epoch"][:count] = 0 if epochs is None else epochs
    events["frame"][count:] = 1 if regular else 2
    events = np.ascontiguousarray(events[in_order(run)])
    times = np.zeros(len(run.frame_gap8_us), TIME)
    track = ffi.new("clock_track_t *")
    known = {"tick_ns": round(tick_us * 1000), "delay_ns": delay_ns, "latency_us": latency_us}
    lib.clock_track_init(track, ffi.new("clock_known_t *", known))
    n = lib.clock_run(
        track,
        ffi.cast("clock_event_t *", ffi.from_buffer(events)),
        len(events),
        ffi.cast("clock_time_t *", ffi.from_buffer(times)),
    )
    assert n == len(times)
    whole = np.floor(run.frame_true_us)
    apart = (times["stm32_us"] - (whole.astype("i8").astype("u8") + np.uint64(stm32_plus % WRAP))) & mask
    error = np.where(apart > mask >> np.uint64(1), -((~apart + np.uint64(1)) & mask).astype("f8"), apart.astype("f8"))
    error = error - (run.frame_true_us - whole)
    given = (times["flags"] & lib.FRAME_HAS_ESTIMATE) != 0
    # Frames of the first start are in order, so are those of the next.
    return Tracked(
        times, np.where(given, error, np.nan), (onward(run.frame_gap8_us) - run.frame_gap8_us[0]) / 1e6, track
    )
