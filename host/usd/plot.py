"""Variables of a log over time, with what is missing in it: holes, drops, unverified rows and resets of the clock.

The time axis is that of the STM32's stamp clock. Each epoch has its own piece of it, as its time begins anew.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..protocol.errors import LocalError
from .drawing import Box, Dots, Line, Shape, Words
from .examine import HOLE_INTERVALS, Findings, is_regular
from .log import Log, Rows
from .units import unit_of

WIDTH, LEFT, RIGHT, TOP, BOTTOM = 1200, 84, 24, 64, 82
PANEL, SPACE = 150, 34
PANELS_MAX = 20
CURVES_MAX = 8
"""In a panel."""
FIXED = "fixedFrequency"
BETWEEN = 14
"""Two epochs."""
COLORS = ("#0b62a4", "#c8344b", "#2a8f57", "#8054b3", "#b37700", "#3f4a57", "#00868b", "#b4427f")
GRID, AXIS, GREY = "#e3e6ea", "#555b63", "#6b7280"
MARKS = {
    "unverified": ("#ebebee", "unverified: no good CRC covers these rows"),
    "hole": ("#ffdfb3", "hole: rows are missing"),
    "drop": ("#f6b8b8", "dropped: the logger had no room for rows"),
}
RESET = "#7a1fa2"
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    rows: Rows
    variable: str

    @property
    def label(self) -> str:
        unit, kind = unit_of(self.variable), self.rows.type.name
        return f"{f'{kind}: ' * (kind != FIXED)}{self.variable}{f' [{unit}]' * bool(unit)}"


@dataclass(frozen=True, slots=True)
class Span:
    """An epoch's piece of the time axis."""

    epoch: int
    from_us: float
    to_us: float
    x: float
    width: float

    def place(self, stamp_us: Any) -> Any:
        return self.x + (np.asarray(stamp_us, np.float64) - self.from_us) * (
            self.width / max(self.to_us - self.from_us, 1.0)
        )


def plot(
    log: Log,
    findings: Findings,
    panels: Sequence[Sequence[Curve]],
    title: str,
    from_us: float = -math.inf,
    to_us: float = math.inf,
) -> tuple[int, int, list[Shape]]:
    """Width, height and shapes of the picture. LocalError when there is nothing between these times."""
    spans = list(spans_of(log, from_us, to_us))
    shapes: list[Shape] = [Words(LEFT, 26, title, 15, bold=True)]
    marked: dict[str, int] = {}
    for number, curves in enumerate(panels):
        top = TOP + number * (PANEL + SPACE)
        shapes += panel(log, findings, curves, spans, top, marked)
    bottom = TOP + len(panels) * (PANEL + SPACE) - SPACE
    shapes += time_axis(spans, bottom)
    shapes += legend(marked, len(spans) > 1, bottom + 64)
    return WIDTH, bottom + BOTTOM, shapes


def spans_of(log: Log, from_us: float, to_us: float) -> Iterator[Span]:
    """From the first row of any type to the last."""
    parts = [
        (number, max(float(each.first_us), from_us), min(float(each.last_us), to_us))
        for number, each in enumerate(log.epochs)
    ]
    parts = [each for each in parts if each[2] >= each[1]]
    if not parts:
        there = ", ".join(f"{each.first_us} to {each.last_us} us" for each in log.epochs)
        raise LocalError(f"no rows between these times: the log has {there or 'none'}")
    between = min(BETWEEN, 300 / len(parts))
    room = WIDTH - LEFT - RIGHT - between * (len(parts) - 1)
    # Even the shortest epoch is to be seen.
    lengths = np.array([max(last - first, 1.0) for _, first, last in parts])
    widths = np.maximum(lengths / lengths.sum(), 0.2 / len(parts))
    x = float(LEFT)
    for (number, first, last), width in zip(parts, widths / widths.sum() * room, strict=True):
        yield Span(number, first, last, x, float(width))
        x += width + between


def panel(
    log: Log, findings: Findings, curves: Sequence[Curve], spans: Sequence[Span], top: float, marked: dict[str, int]
) -> Iterator[Shape]:
    low, high = value_range(curves, spans)
    for span in spans:
        yield Box(span.x, top, span.width, PANEL, "#fbfbfc")
    for kind in MARKS:
        for span, first, last in marks(kind, findings, {each.rows.type.name: each.rows for each in curves}, spans):
            marked[kind] = marked.get(kind, 0) + 1
            x1, x2 = (min(max(float(span.place(each)), span.x), span.x + span.width) for each in (first, last))
            yield Box(min(x1, span.x + span.width - 1), top, max(x2 - x1, 1), PANEL, MARKS[kind][0])
    step = nice_step((high - low) / 6)
    for number in range(math.ceil(low / step), math.floor(high / step) + 1):
        y = top + PANEL - (number * step - low) / (high - low) * PANEL
        for span in spans:
            yield Line([(span.x, y), (span.x + span.width, y)], GRID)
        yield Words(LEFT - 8, y + 4, decimal(number * step, step), 11, "end", AXIS)
    for span in spans:
        for _, x in ticks(span):
            yield Line([(x, top), (x, top + PANEL)], GRID)
    for number, curve in enumerate(curves):
        for span in spans:
            yield from drawn(curve, span, COLORS[number % len(COLORS)], low, high, top)
    for before, behind in pairwise(spans):
        x = (before.x + before.width + behind.x) / 2
        yield Line([(x, top - 4), (x, top + PANEL + 4)], RESET, 1.2, dashed=True)
    x = float(LEFT)
    for number, curve in enumerate(curves):
        yield Words(x, top - 8, curve.label, 12, fill=COLORS[number % len(COLORS)], bold=True)
        x += 18 + 6.8 * len(curve.label)


def value_range(curves: Sequence[Curve], spans: Sequence[Span]) -> tuple[float, float]:
    """Of the rows that are verified, if there are any: the others may be anything."""
    values = [within(curve, span) for curve in curves for span in spans]
    good = [numbers[verified] for _, numbers, verified in values]
    picked = np.concatenate(good if any(len(each) for each in good) else [numbers for _, numbers, _ in values])
    picked = picked[np.isfinite(picked)]
    if not len(picked):
        return -1.0, 1.0
    low, high = float(picked.min()), float(picked.max())
    pad = 0.06 * (high - low) or 0.05 * abs(high) or 1.0
    return low - pad, high + pad


def within(curve: Curve, span: Span) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Time, value and whether verified, of the rows in this piece; in the order of their times."""
    part = curve.rows.epochs[span.epoch] if span.epoch < len(curve.rows.epochs) else range(0)
    rows = slice(part.start, part.stop)
    stamps = curve.rows.stamp_us[rows].astype(np.float64)
    inside = (stamps >= span.from_us) & (stamps <= span.to_us)
    order = np.argsort(stamps[inside], kind="stable")
    values = curve.rows.data[curve.variable][rows][inside].astype(np.float64)
    return stamps[inside][order], values[order], curve.rows.is_verified[rows][inside][order]


def drawn(curve: Curve, span: Span, color: str, low: float, high: float, top: float) -> Iterator[Shape]:
    """A line through rows that come regularly, broken where some are missing; else dots."""
    stamps, values, _ = within(curve, span)
    x = span.place(stamps)
    y = top + PANEL - (np.clip(values, low, high) - low) / (high - low) * PANEL
    finite = np.isfinite(values)
    steps = np.diff(stamps)
    if len(stamps) < 2 or not is_regular(steps):
        points = np.unique(np.round(np.stack([x, y], axis=1)[finite] * 2) / 2, axis=0)
        if len(points):
            yield Dots([(float(a), float(b)) for a, b in points], color)
        return
    broken = (steps > HOLE_INTERVALS * np.median(steps)) | ~finite[1:] | ~finite[:-1]
    for begin, end in pairwise([0, *(np.flatnonzero(broken) + 1).tolist(), len(stamps)]):
        if end - begin > 1:
            yield Line(reduced(x[begin:end], y[begin:end]), color, 1.3)
        elif finite[begin]:
            yield Dots([(float(x[begin]), float(y[begin]))], color)


def reduced(x: Floats, y: Floats) -> list[tuple[float, float]]:
    """What looks the same: of each half pixel's rows the first, the lowest, the highest and the last."""
    column = np.floor(x * 2)
    starts = np.flatnonzero(np.diff(column, prepend=column[0] - 1))
    if len(x) <= 4 * len(starts):
        return list(zip(x.tolist(), y.tolist(), strict=True))
    ends = np.append(starts[1:], len(x)) - 1
    least, most = np.minimum.reduceat(y, starts), np.maximum.reduceat(y, starts)
    middle = (x[starts] + x[ends]) / 2
    points = np.stack(
        [np.stack([x[starts], middle, middle, x[ends]], axis=1), np.stack([y[starts], least, most, y[ends]], axis=1)],
        axis=2,
    )
    return [(float(a), float(b)) for a, b in points.reshape(-1, 2)]


def marks(
    kind: str, findings: Findings, types: dict[str, Rows], spans: Sequence[Span]
) -> Iterator[tuple[Span, float, float]]:
    """Of this kind, in a panel with rows of these types: from when to when."""
    for span in spans:
        for first, last in marked_times(kind, findings, types, span.epoch):
            if last >= span.from_us and first <= span.to_us:
                yield span, first, last


def marked_times(kind: str, findings: Findings, types: dict[str, Rows], epoch: int) -> Iterable[tuple[float, float]]:
    if kind == "hole":
        return [(each.from_us, each.to_us) for each in findings.holes if each.type in types and each.epoch == epoch]
    if kind == "drop":
        return [(each.from_us, each.to_us) for each in findings.drops if each.epoch == epoch]
    return [each for rows in types.values() for each in unverified(rows, epoch)]


def unverified(rows: Rows, epoch: int) -> Iterator[tuple[float, float]]:
    """From the verified row before to the one behind."""
    part = rows.epochs[epoch] if epoch < len(rows.epochs) else range(0)
    bad = ~rows.is_verified[part.start : part.stop]
    stamps = rows.stamp_us[part.start : part.stop].astype(np.float64)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8)))
    for first, behind in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        yield float(stamps[max(first - 1, 0)]), float(stamps[min(behind, len(stamps) - 1)])


def time_axis(spans: Sequence[Span], bottom: float) -> Iterator[Shape]:
    for span in spans:
        yield Line([(span.x, bottom), (span.x + span.width, bottom)], AXIS)
        step = tick_step(span)
        for seconds, x in ticks(span):
            yield Line([(x, bottom), (x, bottom + 5)], AXIS)
            yield Words(x, bottom + 19, decimal(seconds, step), 11, "middle", AXIS)
    yield Words((LEFT + WIDTH - RIGHT) / 2, bottom + 38, "time, s of the STM32's stamp clock", 12, "middle", AXIS)


def tick_step(span: Span) -> float:
    return nice_step(max(span.to_us - span.from_us, 1.0) / 1e6 * 90 / span.width)


def ticks(span: Span) -> Iterator[tuple[float, float]]:
    """Seconds and their place."""
    step = tick_step(span)
    for number in range(math.ceil(span.from_us / 1e6 / step), math.floor(span.to_us / 1e6 / step) + 1):
        yield number * step, float(span.place(number * step * 1e6))


def legend(marked: dict[str, int], reset: bool, y: float) -> Iterator[Shape]:
    x = float(LEFT)
    for kind, (color, text) in MARKS.items():
        if kind in marked:
            yield Box(x, y - 10, 16, 12, color)
            yield Words(x + 22, y, text, 11, fill=GREY)
            x += 46 + 5.8 * len(text)
    if reset:
        yield Line([(x, y - 4), (x + 18, y - 4)], RESET, 1.2, dashed=True)
        yield Words(x + 24, y, "the clock was reset: time begins anew", 11, fill=GREY)


def nice_step(least: float) -> float:
    """1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(each * power for each in (1, 2, 5, 10) if each * power >= least * (1 - 1e-9))


def decimal(value: float, step: float) -> str:
    """With the digits that the step needs."""
    if step >= 1e6 or step < 1e-5:
        return f"{value:.3g}"
    return f"{value:.{max(0, -math.floor(math.log10(step) + 1e-9))}f}"
