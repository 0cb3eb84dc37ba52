"""The picture of `host sync camera --plot`: the search, what patches are off by, and what each part says by itself."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..clock.camera import Aligned
from ..clock.camera_model import MIDDLE
from ..clock.ticks import Floats
from ..usd.drawing import Line, Shape, Words
from .sync_plot import BLUE, GREEN, LEFT, PANEL, RED, RIGHT, SPACE, TOP, WIDTH, across, panel, scale

OUTLIER_PX = 5.0


def shapes(found: Aligned, stm32_per_s: float) -> Iterator[Shape]:
    """`stm32_per_s`: the offset is told on the stamps' clock, as in the table."""
    offset_ms, sigma_ms = (each[MIDDLE] * 1e3 * stm32_per_s for each in (found.fitted.theta, found.fitted.sigma))
    title = f"offset {offset_ms:+.3f} ± {sigma_ms:.3f} ms (one sigma)"
    yield Words(LEFT, 28, title, 16, bold=True)
    known = np.isfinite(found.first.explained_at)
    offsets_ms = found.first.offsets_s[known] * 1e3
    yield from panel(
        0, "part of the tiles' motion that goes with the gyro, by offset", across(offsets_ms),
        np.maximum(found.first.explained_at[known], 0), BLUE, (0.0, 1.0),
    )  # fmt: skip
    at = float(across(np.array([found.first.middle_s * 1e3]), offsets_ms)[0])
    yield Line([(at, TOP), (at, TOP + PANEL)], RED, dashed=True)
    yield from scale(0, offsets_ms, "ms of offset")
    stamps = found.places.stamps_s[:, 1]
    span = np.array([stamps.min(), stamps.max()])
    away = np.sqrt((found.fitted.residual_px**2).sum(axis=1))
    limit = min(float(np.quantile(away, 0.99)) * 1.5, OUTLIER_PX)
    yield from panel(1, "patches off by, px", across(stamps, span), away, GREEN, (0.0, limit))
    yield from scale(1, span, "s of the recording, from its middle on")
    yield from parts(found, span)


def parts(found: Aligned, span: Floats) -> Iterator[Shape]:
    """With bars of one sigma; those that say nearly nothing are left out."""
    best = min(each.sigma_s for each in found.parts)
    told = [each for each in found.parts if each.sigma_s < 20 * best]
    x = across(np.array([each.stamp_s for each in told]), span)
    value = np.array([(each.middle_s - found.fitted.theta[MIDDLE]) * 1e6 for each in told])
    bar = np.array([each.sigma_s * 1e6 for each in told])
    low, high = float((value - bar).min()), float((value + bar).max())
    low, high = min(low, 0.0), max(high, 0.0)
    yield from panel(2, "offset of each part by itself, less the whole's, us", x, value, BLUE, (low, high))
    edge = 0.05 * (high - low)
    top = TOP + 2 * (PANEL + SPACE)

    def y(us: float) -> float:
        return top + PANEL * (high + edge - us) / (high - low + 2 * edge)

    for at, middle, half in zip(x.tolist(), value.tolist(), bar.tolist(), strict=True):
        yield Line([(at, y(middle - half)), (at, y(middle + half))], BLUE)
    yield Line([(LEFT, y(0.0)), (WIDTH - RIGHT, y(0.0))], RED, dashed=True)
    yield from scale(2, span, "s of the recording, from its middle on")
