"""Times that somebody wants to know something about: typed, in a file, or those of a recording's frames."""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..link.mcap import MAGIC
from ..protocol.errors import LocalError, PeerError
from ..protocol.typed import real

SIZE_MAX = 1 << 28
"""Bytes of a file of times."""


@dataclass(frozen=True, slots=True)
class Times:
    stm32_us: np.ndarray[Any, np.dtype[np.float64]]
    bound_us: np.ndarray[Any, np.dtype[np.float64]]
    """NaN where the robot gives none; of times that are typed, 0."""
    frames: list[int] | None = None
    """Of a recording: the index of each."""
    timeless: int = 0
    """Frames without a time."""


def read_times(text: str, robot: int | None) -> Times:
    """LocalError when it is neither a file nor a list of times; PeerError when no frame has a time."""
    if text == "-":
        return typed(sys.stdin.read(SIZE_MAX), "standard input")
    if re.fullmatch(r"\s*|[+-]?[0-9][-+.0-9eE,;\s]*", text):
        return typed(text, text)
    path = Path(text)
    try:
        if not path.exists():
            return typed(text, text)
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
            if head != MAGIC:
                if path.stat().st_size > SIZE_MAX:
                    raise LocalError(f"{text}: too large for a file of times")
                return typed((head + file.read()).decode("ascii"), text)
    except UnicodeDecodeError as error:
        raise LocalError(f"{text}: neither times as text nor a recording (.mcap)") from error
    except OSError as error:
        raise LocalError(f"{text}: {error.strerror}") from error
    return of_recording(text, robot)


def typed(text: str, name: str) -> Times:
    """Apart by commas, spaces or lines; # begins a comment."""
    values: list[float] = []
    for number, line in enumerate(text.splitlines(), 1):
        for word in re.split(r"[,;\s]+", line.split("#")[0].strip()):
            if word:
                values.append(one(word, name, number))
    if not values:
        raise LocalError(f"{name or 'an empty list'}: no times in it")
    times = np.array(values)
    return Times(times, np.zeros(len(times)))


def one(word: str, name: str, line: int) -> float:
    try:
        return real(word)
    except ValueError as error:
        if name == word or "," in name:
            why = f"{word[:60]}: neither a file that is there nor STM32 times in us, as 12400000,12500000"
        else:
            why = f"{name}: line {line}: {word[:60]!r} is no time: write STM32 us, as 12400000"
        raise LocalError(why) from error


def of_recording(name: str, robot: int | None) -> Times:
    from ..link.replay_url import to_url
    from ..link.stream import open_stream

    times: list[int] = []
    bounds: list[float] = []
    frames: list[int] = []
    timeless = 0
    choice = {} if robot is None else {"robot": robot}
    with open_stream(to_url(name, pace="max", **choice), timeout=None) as stream:
        for frame in stream:
            if frame.frame_stm32_us is None:
                timeless += 1
                continue
            bound = frame.native.bound_us if frame.native else None
            times.append(frame.frame_stm32_us)
            bounds.append(float("nan") if bound is None else float(bound))
            frames.append(frame.index)
    if not times:
        raise PeerError(f"{name}: none of {timeless} frames has an STM32 time: the firmware sends none")
    return Times(np.array(times, np.float64), np.array(bounds), frames, timeless)
