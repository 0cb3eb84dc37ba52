"""The picture of `host sync stamps --plot`: delays, how the clocks drift, and what the frames' bounds are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from ..clock.stamps import Fitted, Stamped
from ..clock.ticks import Floats
from ..usd.drawing import Box, Dots, Line, Shape, Words
from ..usd.plot import decimal, nice_step

WIDTH, HEIGHT = 1200, 760
LEFT, RIGHT, TOP, PANEL, SPACE = 96, 24, 56, 180, 48
DOTS_MAX = 4000
"""Of a panel; of more, an even choice is drawn."""
BLUE, RED, GREEN, GREY, GRID = "#0b62a4", "#c8344b", "#2a8f57", "#6b7280", "#e3e6ea"


def picture(result: Stamped) -> list[Shape]:
    """Time is the GAP8's, from the first message or frame on; a GAP8 that started anew begins anew at its left."""
    frames_us = result.sorted.frame_gap8_us.astype(np.float64)
    from_us = min(float(frames_us.min()), *(each.sent_us[0] for each in result.fitted))
    to_us = max(float(frames_us.max()), *(each.sent_us[1] for each in result.fitted))
    return list(shapes(result, from_us, max(to_us, from_us + 1)))


def shapes(result: Stamped, from_us: float, to_us: float) -> Iterator[Shape]:
    def x(at_us: Any) -> Any:
        return LEFT + (np.asarray(at_us) - from_us) * ((WIDTH - LEFT - RIGHT) / (to_us - from_us))

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
    bottom = TOP + 3 * (PANEL + SPACE) - SPACE
    yield Dots([(float(each), bottom - 4) for each in x(refused_us)][:DOTS_MAX], RED, 4)
    for each in result.fitted[1:]:
        yield Line([(float(x(each.sent_us[0])), TOP), (float(x(each.sent_us[0])), bottom)], RED, dashed=True)
    step = nice_step((to_us - from_us) * 1e-6 / 10)
    for k in range(int((to_us - from_us) * 1e-6 / step) + 1):
        yield Words(float(x(from_us + k * step * 1e6)), bottom + 18, decimal(k * step, step), 11, "middle", GREY)
    yield Words(WIDTH - RIGHT, bottom + 36, "s of the GAP8", 12, "end", GREY)


def against_stm32(rate_ppm: Floats) -> Floats:
    """Of a rate over the GAP8's time."""
    return rate_ppm / (1 - rate_ppm * 1e-6)


def delay_of(result: Stamped, each: Fitted) -> tuple[Any, Any]:
    """When each message of an epoch came, and how late it was."""
    gap8, stm32 = (of[each.epoch.messages] for of in (result.sorted.gap8_us, result.sorted.stm32_us))
    offset: Floats = (gap8 - stm32 - each.base_us).astype(np.float64)
    late = offset - each.smoothed.track.at((gap8 - each.begin_us).astype(np.float64) * 1e-6)
    return gap8.astype(np.float64), late


def panel(
    place: int, title: str, x: Any, y: Any, color: str, limits: tuple[float, float] | None = None
) -> Iterator[Shape]:
    yield from panels(place, title, [(x, y, color)], limits)


def panels(
    place: int, title: str, series: Sequence[tuple[Any, Any, str]], limits: tuple[float, float] | None = None
) -> Iterator[Shape]:
    """Several series, (x, y, color) each, in one panel."""
    top = TOP + place * (PANEL + SPACE)
    low, high = limits or (min(float(y.min()) for _, y, _ in series), max(float(y.max()) for _, y, _ in series))
    low, high = low - 0.05 * (high - low), high + 0.05 * (high - low)
    if not high > low:
        low, high = low - 1, high + 1
    yield Box(LEFT, top, WIDTH - LEFT - RIGHT, PANEL, "#f8f9fa")
    step = nice_step((high - low) / 5)
    for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1):
        level = top + PANEL * (high - k * step) / (high - low)
        yield Line([(LEFT, level), (WIDTH - RIGHT, level)], GRID)
        yield Words(LEFT - 8, level + 4, decimal(k * step, step), 11, "end", GREY)
    for x, y, color in series:
        some = slice(None, None, max(1, len(x) // DOTS_MAX))
        inside = np.clip(top + PANEL * (high - y[some]) / (high - low), top, top + PANEL)
        yield Dots(list(zip(x[some].tolist(), inside.tolist(), strict=True)), color)
    yield Words(LEFT, top - 8, title, 13)


def across(values: Floats, span: Floats) -> Floats:
    low, high = float(span.min()), float(span.max())
    return np.asarray(LEFT + (values - low) * ((WIDTH - LEFT - RIGHT) / max(high - low, 1e-9)))


def scale(place: int, span: Floats, unit: str) -> Iterator[Shape]:
    """Below a panel."""
    low, high = float(span.min()), float(span.max())
    bottom = TOP + place * (PANEL + SPACE) + PANEL + 16
    step = nice_step((high - low) / 10)
    for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1):
        yield Words(float(across(np.array([k * step]), span)[0]), bottom, decimal(k * step, step), 11, "middle", GREY)
    yield Words(WIDTH - RIGHT, bottom + 15, unit, 12, "end", GREY)
