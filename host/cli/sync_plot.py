"""What pictures of `host sync` are made of: panels below each other, with a scale; and the file of one."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from ..clock.ticks import Floats
from ..usd.drawing import Box, Dots, Line, Shape, Words
from ..usd.plot import decimal, nice_step
from .new_file import new_file
from .usd_plot import picture_writer

PANELS = 3
LEFT, RIGHT, TOP, PANEL, SPACE = 96, 24, 56, 180, 48
WIDTH, HEIGHT = 1200, TOP + PANELS * (PANEL + SPACE) + 20
DOTS_MAX = 4000
"""Of a panel; of more, an even choice is drawn."""
BLUE, RED, GREEN, GREY, GRID = "#0b62a4", "#c8344b", "#2a8f57", "#6b7280", "#e3e6ea"
Draw = Callable[[Iterable[Shape], int], None]
"""Takes a picture and how many panels it has."""


@contextmanager
def new_picture(file: str | None, force: bool) -> Iterator[Draw | None]:
    """Into a file that is made before anything is read, and kept only if all goes well. None without one."""
    if file is None:
        yield None
        return
    write = picture_writer(file)
    with new_file(file, force) as out:

        def draw(shapes: Iterable[Shape], panels: int) -> None:
            out.write(write(WIDTH, HEIGHT - (PANELS - panels) * (PANEL + SPACE), list(shapes)))

        yield draw


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


def across(values: Floats, span: Floats | None = None) -> Floats:
    """From end to end of `span`, or of themselves."""
    span = values if span is None else span
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
