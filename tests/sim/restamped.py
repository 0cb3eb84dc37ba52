"""Times of frames from all of a robot's messages, as `host sync stamps` finds them afterwards, against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from host.cli.sync_stamps_read import reading_of, together
from host.clock.stamps import WIRE_US, Stamped, stamp
from sim import truth
from sim.receiver import Receiver


@dataclass(frozen=True)
class Restamped:
    found: Stamped
    error_us: np.ndarray
    """Of the frames that have a time."""

    @property
    def wrong(self) -> np.ndarray:
        """Half a us is lost where the truth is looked up."""
        return np.abs(self.error_us) > self.found.bound_us + 0.5


def restamped(robot: Receiver) -> Restamped:
    """Of the native frames."""
    frames = [frame for frame in robot.frames if frame.native]
    heads = [frame.native for frame in frames if frame.native]
    pairs = np.concatenate([frame.pairs for frame in frames if frame.pairs is not None])
    after = np.cumsum([len(frame.pairs) if frame.pairs is not None else 0 for frame in frames])
    gap8 = np.array([head.frame_gap8_us for head in heads], np.uint64)
    readings = together([reading_of(frame) for frame in frames])
    resets = pairs["epoch"].astype(np.int64)
    found = stamp(pairs["stm32_us"], pairs["gap8_us"], gap8, after, resets, WIRE_US, readings=readings)
    times = [
        truth.Stamped(round(value), (heads[place].frame, heads[place].frame_gap8_us))
        for place, value in zip(found.frame, found.stm32_us, strict=True)
    ]
    return Restamped(found, np.array(truth.errors_us(times, robot.truth, robot.settings.stm32.stamp_bits)))
