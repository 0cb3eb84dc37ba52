"""The frames of a recording that have a picture and a time, for `host sync camera`."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..clock.ticks import SLOW, Floats
from ..link.frame import Frame
from ..link.replay_url import to_url
from ..link.stream import open_stream
from ..protocol.errors import PeerError

KEPT_BYTES = 256 << 20
"""Of pictures, for they are gone through three times. More are not kept, but read anew each time."""
NOTHING = np.zeros((0, 0), np.uint8)


@dataclass(frozen=True)
class Recorded:
    """Frames of one size, in order, each with a picture and a time."""

    file: str
    robot: int
    width: int
    height: int
    index: NDArray[np.int64]
    """Of each frame, in the recording."""
    stamp_us: Floats
    """As stamped, divided by `stm32_per_s`; of the middle of the middle row's exposure, if the frames tell how far that
    is before their end."""
    before_end_us: float | None
    """From that to the end of frame: the median. As the stamps, these count the STM32's time, made right if it is slow;
    where frames do not say how their robot's two clocks run, the GAP8's."""
    line_us: float | None
    """From row to row."""
    exposure_us: float | None
    """Median."""
    bound_us: float | None
    """Of the stamps: median."""
    stm32_per_s: float
    """Seconds that the STM32's clock counts in one: 1, or 84/85 when the GAP8's says so."""
    left_out: Counter[str] = field(default_factory=Counter)
    pictures: list[NDArray[np.uint8]] | None = None
    """None when they are too many."""

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        if self.pictures is not None:
            yield from self.pictures
            return
        wanted = set(self.index.tolist())
        for frame in frames(self.file, self.robot):
            if frame.index in wanted:
                yield grey(frame)


@dataclass(frozen=True, slots=True)
class Told:
    """What one frame says of itself."""

    index: int
    size: tuple[int, int]
    stamp_us: float
    bound_us: float | None
    before_end_us: float | None
    line_us: float | None
    exposure_us: float | None
    stm32_per_gap8: float | None
    picture: NDArray[np.uint8]


def frames(file: str, robot: int) -> Iterator[Frame]:
    with open_stream(to_url(file, pace="max", robot=robot), timeout=None) as stream:
        yield from stream


def grey(frame: Frame) -> NDArray[np.uint8]:
    """PeerError when a JPEG is broken."""
    pixels = frame.pixels
    return pixels if pixels.ndim == 2 else pixels.mean(axis=2).astype(np.uint8)


def read(file: str, robot: int, times_us: dict[int, tuple[float, float]] | None, line_us: float | None,
         exposure_us: float | None) -> Recorded:  # fmt: skip
    """`times_us`: times and bounds by the frames' index, instead of the robot's own. `line_us`, `exposure_us`: of
    frames that do not say. PeerError when no frame has picture and time."""
    left_out: Counter[str] = Counter()
    told, room = [], KEPT_BYTES
    for frame in frames(file, robot):
        one = tell(frame, times_us, line_us, exposure_us)
        if isinstance(one, str):
            left_out[one] += 1
            continue
        room -= one.picture.nbytes
        told.append(one if room >= 0 else dataclasses.replace(one, picture=NOTHING))
    if not told:
        why = ", ".join(f"{count} {each}" for each, count in left_out.items())
        raise PeerError(f"{file}: robot {robot}: no frame with a picture and a time ({why or 'no frame came whole'})")
    size = Counter(each.size for each in told).most_common(1)[0][0]
    left_out["of another size"] += sum(each.size != size for each in told)
    told = [each for each in told if each.size == size]
    kept = longest_rise(told)
    left_out["before or after a reset of the clock"] += len(told) - len(kept)
    told_rates = [each.stm32_per_gap8 for each in kept if each.stm32_per_gap8 is not None]
    rate = float(np.median(told_rates)) if told_rates else 1.0
    stm32_per_s = min(1.0, SLOW, key=lambda each: abs(rate - each))
    rate /= stm32_per_s
    before_end_us, row_us, exposed_us = (
        None if value is None else value * rate
        for value in (
            usual([each.before_end_us for each in kept]),
            usual([each.line_us for each in kept]),
            usual([each.exposure_us for each in kept]),
        )
    )
    shift = np.array([(each.before_end_us or 0.0) * rate for each in kept]) if before_end_us else np.zeros(len(kept))
    return Recorded(
        file, robot, *size, np.array([each.index for each in kept]),
        np.array([each.stamp_us for each in kept]) / stm32_per_s - shift, before_end_us,
        row_us, exposed_us, usual([each.bound_us for each in kept]),
        stm32_per_s, +left_out, [each.picture for each in kept] if room >= 0 else None,
    )  # fmt: skip


def usual(values: list[float | None]) -> float | None:
    """Their median; None when one of them is."""
    known = [each for each in values if each is not None]
    return float(np.median(known)) if len(known) == len(values) else None


def tell(
    frame: Frame, times_us: dict[int, tuple[float, float]] | None, line_us: float | None, exposure_us: float | None
) -> Told | str:
    """Or why it is left out."""
    if times_us is None:
        stamp_us: float | None = frame.frame_stm32_us
        bound_us: float | None = frame.native.bound_us if frame.native else None
    else:
        stamp_us, bound_us = times_us.get(frame.index, (None, None))
    if stamp_us is None:
        return "without a time"
    try:
        picture = grey(frame)
    except PeerError:
        return "with a broken JPEG"
    before_end_us = frame.row_before_end_us((frame.height - 1) / 2)
    if frame.native:
        line_us = frame.native.line_time_ns / 1000
        exposure_us = frame.native.exposure_lines * line_us
    elif line_us is not None and exposure_us is not None:
        before_end_us = (frame.height - 1) / 2 * line_us + exposure_us / 2
    return Told(frame.index, (frame.width, frame.height), float(stamp_us), bound_us, before_end_us, line_us,
                exposure_us, frame.stm32_per_gap8, picture)  # fmt: skip


def longest_rise(told: list[Told]) -> list[Told]:
    """Where a stamp is not later than the one before, the clock has been reset, or a stamp is wrong."""
    stamps = np.array([each.stamp_us for each in told])
    ends = np.flatnonzero(np.diff(stamps) <= 0) + 1
    parts = np.split(np.arange(len(told)), ends)
    best = max(parts, key=len)
    return told[best[0] : best[-1] + 1]
