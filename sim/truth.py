"""Time stamps against the simulation's truth."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from host.link.records import Frame

if TYPE_CHECKING:
    from .world import World

TRUTH_DTYPE = np.dtype(
    [
        ("true_ns", "i8"),
        ("stm32_stamp_ns", "i8"),
        ("gap8_stamp_us", "u8"),
        ("frame", "u4"),
        ("boot", "u4"),
        ("image", "u4"),
        ("robot", "i4"),
    ],
    align=True,
)
"""frame_truth_t of sim/kernel/kernel.h: one completed capture."""

NOT_UP = np.iinfo(np.int64).min
Stamped = tuple[int, int, int]
"""frame, frame_gap8_us, frame_stm32_us of a native frame."""


def stamped(frames: Iterable[Frame]) -> list[Stamped]:
    """Of the frames that carry an estimate."""
    return [
        (frame.native.frame, frame.native.frame_gap8_us, frame.native.frame_stm32_us)
        for frame in frames
        if frame.native is not None and frame.native.frame_stm32_us is not None
    ]


def errors_us(stamps: Iterable[Stamped], truth: NDArray[np.void], stm32_bits: int) -> NDArray[np.float64]:
    """Estimate less truth, in the order of `stamps`, for one robot; NaN where the truth does not know the frame.

    Both clocks wrap at 2^stm32_bits us: the error is the shorter way round.
    """
    known = {
        (int(frame), int(gap8_us)): int(stamp_ns)
        for frame, gap8_us, stamp_ns in zip(
            truth["frame"], truth["gap8_stamp_us"], truth["stm32_stamp_ns"], strict=True
        )
        if stamp_ns != NOT_UP
    }
    period_ns = 1000 << stm32_bits
    errors = []
    for frame, gap8_us, stm32_us in stamps:
        true_ns = known.get((frame, gap8_us))
        if true_ns is None:
            errors.append(float("nan"))
            continue
        # In Python's integers: a 64-bit clock in nanoseconds does not fit int64.
        around_ns = (stm32_us * 1000 - true_ns + period_ns // 2) % period_ns - period_ns // 2
        errors.append(around_ns / 1000)
    return np.array(errors, dtype=np.float64)


def stamp_errors_us(stamps: Iterable[Stamped], world: World, robot: int) -> dict[str, float] | None:
    """n, mean, sd, worst of the errors of one robot's stamps; None when there is nothing to compare."""
    truth = world.truth
    each = errors_us(stamps, truth[truth["robot"] == robot], world.scenario.robots[robot].stm32.stamp_bits)
    each = each[~np.isnan(each)]
    if not len(each):
        return None
    worst = float(each[np.argmax(np.abs(each))])
    return {
        "n": len(each),
        "mean": round(float(each.mean()), 1),
        "sd": round(float(each.std()), 1),
        "worst": round(worst, 1),
    }
