"""The picture of `host sync mocap --plot`: for each source of attitudes, what is left over time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..clock.lag import Lag
from ..usd.drawing import Shape, Words
from .sync_plot import BLUE, GREEN, LEFT, across, panel, scale

SHOWN = 2
"""Sources that fit the page: motion capture, and the first estimate."""


def shapes(found: dict[str, Lag]) -> Iterator[Shape]:
    found = dict(list(found.items())[:SHOWN])
    said = "; ".join(
        f"{name} {each.behind_motion_us / 1000:+.2f} ± {each.sigma_us / 1000:.2f} ms" for name, each in found.items()
    )
    yield Words(LEFT, 28, f"behind the motion: {said}", 16, bold=True)
    first = next(iter(found.values()))
    turning = np.sqrt((first.turning_dps**2).sum(axis=1))
    yield from panel(0, "turning, deg/s, less the mean of each second", across(first.at_us), turning, GREEN)
    for place, (name, each) in enumerate(found.items(), 1):
        left = np.sqrt((each.left_deg**2).sum(axis=1))
        limits = 0.0, float(np.quantile(left, 0.999))
        yield from panel(place, f"{name}: what is left, deg", across(each.at_us), left, BLUE, limits)
        yield from scale(place, each.at_us * 1e-6, "s of the log")
