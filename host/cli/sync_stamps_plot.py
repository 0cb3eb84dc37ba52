"""The picture of `host sync stamps --plot`: delays, how the clocks drift, and what the frames' bounds and flags are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..clock.stamps import Fitted, Stamped
from ..clock.ticks import Floats
from ..link.assemble import FLAGS
from ..usd.drawing import Box, Dots, Line, Shape, Words
from .sync_plot import (
    BLUE,
    DOTS_MAX,
    GREEN,
    GREY,
    GRID,
    LEFT,
    PANEL,
    RED,
    RIGHT,
    SPACE,
    TOP,
    WIDTH,
    across,
    panel,
    scale,
)


def shapes(result: Stamped, flags: Sequence[Sequence[str]]) -> tuple[list[Shape], int]:
    """The picture, and how many panels it has: a fourth one if the robot has flagged a frame."""
    seen = {name for names in flags for name in names}
    flagged = {name: [name in names for names in flags] for name in FLAGS if name in seen}
    count = 4 if flagged else 3
    return list(drawn(result, flagged, count)), count


def drawn(result: Stamped, flagged: dict[str, list[bool]], count: int) -> Iterator[Shape]:
    """Time is the GAP8's, from the first message or frame on; a GAP8 that started anew begins anew at its left."""
    frames_us = result.sorted.frame_gap8_us.astype(np.float64)
    from_us = min(float(frames_us.min()), *(each.sent_us[0] for each in result.fitted))
    to_us = max(float(frames_us.max()), *(each.sent_us[1] for each in result.fitted))
    span_s = np.array([0.0, max(to_us - from_us, 1.0) * 1e-6])

    def x(at_us: Any) -> Any:
        return across((np.asarray(at_us) - from_us) * 1e-6, span_s)

    given_us = result.sorted.frame_gap8_us[result.frame].astype(np.float64)
    refused_us = result.sorted.frame_gap8_us[list(result.refused)].astype(np.float64)
    yield Words(LEFT, 28, f"{len(result.frame)} frames stamped, {len(refused_us)} refused", 16, bold=True)
    delays = [delay_of(result, each) for each in result.fitted]
    at = np.concatenate([each[0] for each in delays])
    late = np.concatenate([each[1] for each in delays])
    knots = np.concatenate([each.begin_us + each.smoothed.track.time_s * 1e6 for each in result.fitted])
    drift = np.concatenate([against_stm32(each.smoothed.track.rate_ppm) - each.drift_ppm for each in result.fitted])
    high = float(np.quantile(late, 0.99))
    yield from panel(0, "messages late, us", x(at), late, BLUE, (min(0.0, float(late.min())), high))
    yield from panel(1, "rate less its mean, ppm", x(knots), drift, GREEN)
    yield from panel(2, "bound of frames, ± us (99 %); red: refused", x(given_us), result.bound_us, BLUE)
    lowest = TOP + 2 * (PANEL + SPACE) + PANEL - 4
    yield Dots([(float(each), lowest) for each in x(refused_us)][:DOTS_MAX], RED, 4)
    if flagged:
        yield from flags_panel(3, x(frames_us), flagged)
    bottom = TOP + count * (PANEL + SPACE) - SPACE
    for each in result.fitted[1:]:
        yield Line([(float(x(each.sent_us[0])), TOP), (float(x(each.sent_us[0])), bottom)], RED, dashed=True)
    yield from scale(count - 1, span_s, "s of the GAP8")


def flags_panel(place: int, frames_x: Any, flagged: dict[str, list[bool]]) -> Iterator[Shape]:
    """A line for each flag, and a dot on it for each frame that has it."""
    top = TOP + place * (PANEL + SPACE)
    yield Box(LEFT, top, WIDTH - LEFT - RIGHT, PANEL, "#f8f9fa")
    for number, (name, has) in enumerate(flagged.items()):
        level = top + PANEL * (number + 0.5) / len(flagged)
        yield Line([(LEFT, level), (WIDTH - RIGHT, level)], GRID)
        yield Words(LEFT - 8, level + 4, name, 10, "end", GREY)
        at = frames_x[has]
        yield Dots([(float(each), level) for each in at[:: max(1, len(at) // DOTS_MAX)]], BLUE)
    yield Words(LEFT, top - 8, "flags that the robot gave its frames' times", 13)


def against_stm32(rate_ppm: Floats) -> Floats:
    """Of a rate over the GAP8's time."""
    return rate_ppm / (1 - rate_ppm * 1e-6)


def delay_of(result: Stamped, each: Fitted) -> tuple[Any, Any]:
    """When each message of an epoch came, and how late it was."""
    gap8, stm32 = (of[each.epoch.messages] for of in (result.sorted.gap8_us, result.sorted.stm32_us))
    offset: Floats = (gap8 - stm32 - each.base_us).astype(np.float64)
    late = offset - each.smoothed.track.at((gap8 - each.begin_us).astype(np.float64) * 1e-6)
    return gap8.astype(np.float64), late
