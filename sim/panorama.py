"""What a turning camera with a rolling shutter sees: a world at infinity, row by row, blurred by the exposure."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Grey = np.ndarray[Any, np.dtype[np.float32]]
WAVES, BLOBS = 24, 120
MIDDLE, SPREAD = 120, 45


@dataclass(frozen=True, slots=True)
class Optics:
    """HM01B0 behind the AI-deck's lens, at a pixel clock of 6 MHz."""

    width: int = 324
    height: int = 244
    focal_px: float = 171.0
    line_s: float = 62.667e-6
    exposure_s: float = 5e-3
    noise: float = 2.0
    """Standard deviation, in grey levels."""
    exposure_steps: int = 3
    """Instants of the exposure that are averaged."""

    @property
    def middle_to_end_s(self) -> float:
        """From the middle of the middle row's exposure to the end of frame."""
        return (self.height - 1) / 2 * self.line_s + self.exposure_s / 2


HALF = Optics(width=162, height=122, focal_px=85.5, line_s=71.667e-6)
"""Pixels binned two by two: lines of 215 clocks at 3 MHz."""


@functools.lru_cache(maxsize=4)
def panorama(seed: int, height: int = 512) -> Grey:
    """An equirectangular picture, twice as wide as high, of a bright and dark world with edges: made on the sphere, so
    that neither its seam nor its poles show."""
    rng = np.random.default_rng(seed)
    up = (0.5 - (np.arange(height, dtype=np.float32) + 0.5) / height) * np.float32(np.pi)
    around = (np.arange(2 * height, dtype=np.float32) + 0.5) / height * np.float32(np.pi)
    sphere = np.stack(
        [
            np.outer(np.cos(up), np.cos(around)),
            np.outer(np.cos(up), np.sin(around)),
            np.repeat(np.sin(up)[:, None], 2 * height, axis=1),
        ]
    ).astype(np.float32)
    grey: Grey = np.zeros(sphere.shape[1:], np.float32)
    for _ in range(WAVES):
        wave = (rng.normal(size=3) * 10 ** rng.uniform(0.5, 1.8)).astype(np.float32)
        phase = np.tensordot(wave, sphere, 1) + np.float32(rng.uniform(0, 2 * np.pi))
        grey += np.sin(phase) / np.sqrt(np.linalg.norm(wave))
    grey /= grey.std()
    for _ in range(BLOBS):
        centre, radius = rng.normal(size=3), rng.uniform(0.02, 0.25)
        centre = (centre / np.linalg.norm(centre)).astype(np.float32)
        # How far inside, in pixels: an edge is as sharp as one pixel.
        depth = (np.tensordot(centre, sphere, 1) - np.float32(np.cos(radius))) * np.float32(
            height / np.pi / np.sin(radius)
        )
        grey += np.clip(depth + np.float32(0.5), 0, 1) * np.float32(rng.uniform(-2, 2))
    return np.asarray(np.clip(grey / grey.std() * np.float32(SPREAD) + np.float32(MIDDLE), 0, 255))


def render(
    world: Grey, optics: Optics, to_world: Callable[[Floats], Floats], end_s: float, rng: np.random.Generator
) -> NDArray[np.uint8]:
    """The frame that ends at `end_s`. `to_world`: rotations (n, 3, 3) from the camera's axes (right, down, ahead) to
    the world's at the times (n,)."""
    rows = np.arange(optics.height)
    row_end_s = end_s - (optics.height - 1 - rows.astype(np.float64)) * optics.line_s
    x = ((np.arange(optics.width) - (optics.width - 1) / 2) / optics.focal_px).astype(np.float32)[None]
    y = ((rows - (optics.height - 1) / 2) / optics.focal_px).astype(np.float32)[:, None]
    picture = np.zeros((optics.height, optics.width), np.float32)
    for step in range(optics.exposure_steps):
        at_s = row_end_s - optics.exposure_s * ((step + 0.5) / optics.exposure_steps)
        r = to_world(at_s).astype(np.float32)[:, :, :, None]
        ahead = [r[:, axis, 0] * x + r[:, axis, 1] * y + r[:, axis, 2] for axis in range(3)]
        picture += look(world, *ahead)
    picture *= np.float32(1 / optics.exposure_steps)
    picture += rng.standard_normal(picture.shape, np.float32) * np.float32(optics.noise)
    return np.asarray(np.clip(picture + np.float32(0.5), 0, 255).astype(np.uint8))


def look(world: Grey, ahead: Grey, left: Grey, up: Grey) -> Grey:
    """What is seen along each ray, between the four nearest pixels."""
    height, width = world.shape
    column = np.arctan2(left, ahead) * np.float32(width / (2 * np.pi)) + np.float32(width - 0.5)
    row = np.float32(height / 2 - 0.5) - np.arctan2(up, np.sqrt(ahead * ahead + left * left)) * np.float32(
        height / np.pi
    )
    row = np.clip(row, 0, np.float32(height - 1.001))
    i, j = row.astype(np.int32), column.astype(np.int32)
    # A whole number of another type would make all that follows float64.
    down, right = row - i.astype(np.float32), column - j.astype(np.float32)
    j %= width
    here, beside = i * width + j, i * width + (j + 1) % width
    flat, below = world.ravel(), world[1:].ravel()
    top, low = flat.take(here), below.take(here)
    top += (flat.take(beside) - top) * right
    low += (below.take(beside) - low) * right
    return np.asarray(top + (low - top) * down)
