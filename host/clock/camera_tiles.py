"""How far large parts of a picture have moved, without knowing anything: phase correlation of windowed tiles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ticks import Floats

SURE = 8.0
"""A peak so many times the rest's root mean square is one."""
NOISY = 0.35
"""Of the highest frequency: above it, pictures are noise and edges of pixels."""
SIDES = 1.9
"""So many tiles are as long as the lower side of the picture, without their overlap."""
FLAT = 3.0
"""Grey levels: a tile of less contrast shows nothing."""


@dataclass(frozen=True)
class Tiles:
    """Where the tiles of pictures of one size lie, a little over each other."""

    side: int
    corners: NDArray[np.intp]
    """(tiles, 2): first row and column."""
    middles: Floats
    """(tiles, 2): u, v."""

    @classmethod
    def of(cls, width: int, height: int) -> Tiles:
        side = int(min(width, height) / SIDES) & ~1
        rows, columns = (np.linspace(0, size - side, 1 + size // side).astype(np.intp) for size in (height, width))
        corners = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=2).reshape(-1, 2)
        middles = corners[:, ::-1] + (side - 1) / 2 - [(width - 1) / 2, (height - 1) / 2]
        return cls(side, corners, middles)

    def spectra(self, picture: NDArray[np.uint8]) -> Floats:
        """(tiles, side, side / 2 + 1), complex; 0 of a flat tile."""
        tiles = np.stack([picture[i : i + self.side, j : j + self.side] for i, j in self.corners]).astype(np.float32)
        tiles -= tiles.mean(axis=(1, 2), keepdims=True)
        tiles *= tiles.std(axis=(1, 2), keepdims=True) > FLAT
        window = np.hanning(self.side + 2)[1:-1].astype(np.float32)
        return np.asarray(np.fft.rfft2(tiles * (window[:, None] * window)))

    def moved(self, before: Floats, after: Floats) -> tuple[Floats, Floats]:
        """By how many pixels (tiles, 2), and how sure that is (tiles,): below SURE it is chance."""
        cross = after * before.conj()
        cross /= np.abs(cross) + 1e-6 * np.abs(cross).max() + 1e-30
        vertical, horizontal = np.fft.fftfreq(self.side)[:, None], np.fft.rfftfreq(self.side)
        cross *= np.exp(-(vertical**2 + horizontal**2) / (NOISY / 2) ** 2)
        peaks = np.fft.irfft2(cross, (self.side, self.side))
        flat = peaks.reshape(len(peaks), -1)
        at = flat.argmax(axis=1)
        height = np.take_along_axis(flat, at[:, None], axis=1)[:, 0]
        sure = height / np.maximum(np.sqrt((flat**2).mean(axis=1)), 1e-30)
        row, column = np.divmod(at, self.side)
        tile = np.arange(len(peaks))
        shift = np.empty((len(peaks), 2))
        for axis, (i, j) in enumerate(((0, 1), (1, 0))):
            one, other = (peaks[tile, (row + d * i) % self.side, (column + d * j) % self.side] for d in (-1, 1))
            bend = one - 2 * height + other
            part = np.where(bend < 0, 0.5 * (one - other) / np.minimum(bend, -1e-30), 0)
            place = (column, row)[axis]
            shift[:, axis] = (place + self.side // 2) % self.side - self.side // 2 + np.clip(part, -0.5, 0.5)
        return shift, sure
