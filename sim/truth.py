"""Time stamps against the simulation's truth."""

from __future__ import annotations

import zlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from host.link.frame import Frame

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
PAPER_PERIOD_NS = 1_000_000 << 32
"""After which the time in the paper's image header wraps."""
RECENT = 64
"""Captures of one picture that a frame without a number may be of."""


@dataclass(frozen=True, slots=True)
class Stamped:
    """A frame's estimate of its time, and what tells which capture it is of."""

    stm32_us: int
    number: tuple[int, int] | None
    """frame and frame_gap8_us of a native frame."""
    bound_us: int | None = None
    body_crc32: int = 0
    """Of a frame without a number: its picture, and that it was taken before it came, is all there is."""
    arrival_ns: int = 0


def stamped(frames: Iterable[Frame]) -> list[Stamped]:
    """Of the frames that carry an estimate."""
    found = []
    for frame in frames:
        stm32_us = frame.frame_stm32_us
        if stm32_us is None:
            continue
        if frame.native:
            number = (frame.native.frame, frame.native.frame_gap8_us)
            found.append(Stamped(stm32_us, number, frame.native.bound_us))
        else:
            crc32 = zlib.crc32(frame.body.data)
            found.append(Stamped(stm32_us, None, body_crc32=crc32, arrival_ns=frame.arrival_host_ns))
    return found


def errors_us(
    stamps: Iterable[Stamped],
    truth: NDArray[np.void],
    stm32_bits: int,
    pictures: Mapping[int, Collection[int]] | None = None,
) -> NDArray[np.float64]:
    """Estimate less truth, in the order of `stamps`, for one robot; NaN where the truth does not know the frame.

    `pictures`: by CRC-32, their numbers in the truth (World.picture_numbers). A frame without a number is taken for
    the one of the last captures of its picture whose time is nearest. Both clocks wrap at 2^stm32_bits us: the error is
    the shorter way round.
    """
    truth = truth[truth["stm32_stamp_ns"] != NOT_UP]
    numbered = zip(truth["frame"].tolist(), truth["gap8_stamp_us"].tolist(), strict=True)
    known = dict(zip(numbered, truth["stm32_stamp_ns"].tolist(), strict=True))
    period_ns = 1000 << stm32_bits
    unnumbered = Unnumbered(truth, pictures or {}, period_ns)
    errors = []
    for stamp in stamps:
        if stamp.number is None:
            errors.append(unnumbered.error_us(stamp))
        elif stamp.number in known:
            errors.append(around(stamp.stm32_us * 1000 - known[stamp.number], period_ns) / 1000)
        else:
            errors.append(float("nan"))
    return np.array(errors, dtype=np.float64)


def around(difference_ns: int, period_ns: int) -> int:
    """The shorter way. In Python's integers: a 64-bit clock in nanoseconds does not fit int64."""
    return (difference_ns + period_ns // 2) % period_ns - period_ns // 2


class Unnumbered:
    """Captures by their picture."""

    def __init__(self, truth: NDArray[np.void], pictures: Mapping[int, Collection[int]], period_ns: int) -> None:
        self.truth = truth
        self.pictures = pictures
        self.period_ns = min(period_ns, PAPER_PERIOD_NS)
        self._of: dict[int | None, tuple[NDArray[np.int64], list[int]]] = {}

    def error_us(self, stamp: Stamped) -> float:
        """NaN when no capture can be meant."""
        # A damaged picture is none of ours: then any capture will do.
        key = stamp.body_crc32 if stamp.body_crc32 in self.pictures else None
        if key not in self._of:
            rows = self.truth if key is None else self.truth[np.isin(self.truth["image"], list(self.pictures[key]))]
            self._of[key] = (rows["true_ns"], rows["stm32_stamp_ns"].tolist())
        true_ns, stm32_ns = self._of[key]
        end = int(np.searchsorted(true_ns, stamp.arrival_ns))
        meant = [
            around(stamp.stm32_us * 1000 - each, self.period_ns) / 1000 for each in stm32_ns[max(0, end - RECENT) : end]
        ]
        return min(meant, key=abs, default=float("nan"))


def stamp_errors_us(stamps: Sequence[Stamped], world: World, robot: int) -> dict[str, float] | None:
    """n, mean, sd, worst of the errors of one robot's stamps, how many have a bound and how many are within it; None
    when there is nothing to compare."""
    truth = world.truth
    own = truth[truth["robot"] == robot]
    bits = world.scenario.robots[robot].stm32.stamp_bits
    each = errors_us(stamps, own, bits, world.picture_numbers(robot))
    known = ~np.isnan(each)
    bound = np.array([np.nan if stamp.bound_us is None else stamp.bound_us for stamp in stamps])[known]
    each = each[known]
    if not len(each):
        return None
    worst = float(each[np.argmax(np.abs(each))])
    return {
        "n": len(each),
        "bounded": int(np.count_nonzero(~np.isnan(bound))),
        "within": int(np.count_nonzero(np.abs(each) <= bound)),
        "mean": round(float(each.mean()), 1),
        "sd": round(float(each.std()), 1),
        "worst": round(worst, 1),
    }
