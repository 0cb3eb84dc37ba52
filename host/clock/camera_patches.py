"""Where small patches of one picture are in the next: Lucas and Kanade's method, begun where the gyro expects them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .ticks import Floats

SIDE = 20
"""Pixels of a patch: it sees rows that are as many line times apart, evenly about its middle."""
COLUMNS_MAX = 6
ROUNDS = 8
SETTLED_PX = 0.02
"""A patch that moves by less is found; one that has not after all ROUNDS is lost."""
FAR = 0.6
"""Of the side: a patch that is found further off than this from where it is expected is lost."""
CONTRAST = 1.0
"""Grey levels per pixel: the smaller of a patch's two mean gradients must be that, or it has no texture."""
ALIKE = 0.5
"""Correlation below which it is not the same patch."""
WEAK = 0.2
"""Of CONTRAST: along an edge, where a patch shows nothing, it stays where it is expected."""
FLOOR_PX = 0.02
"""What interpolation costs."""

Grey = NDArray[np.float32]
Expect = Callable[[Floats], Floats]


@dataclass(frozen=True, slots=True)
class Sought:
    """Patches of a picture, and where each is expected in the next."""

    at: Floats
    """(n, 2): u, v of their middles."""
    there: Floats
    """(n, 2), expected; NaN: nowhere."""
    shape: Floats
    """(n, 2, 2): how what is around it is stretched and sheared there: by the turn, in perspective, and by the rows'
    different times."""
    curve: Floats
    """(n, 2, 3): and bent, by x x, x y and y y."""


@dataclass(frozen=True, slots=True)
class Found:
    before: Floats
    """(n, 2): u, v of patches with texture that were found again."""
    after: Floats
    information: Floats
    """(n, 2, 2)."""
    textured: int
    """Of all patches that are expected inside ..."""
    expected: int
    """... and those."""


def smooth(picture: NDArray[np.uint8]) -> Grey:
    """1 2 1 both ways: noise less, and gradients between pixels better."""
    grey = np.pad(picture.astype(np.float32), 1, mode="edge")
    grey = grey[:-2] + 2 * grey[1:-1] + grey[2:]
    return np.asarray((grey[:, :-2] + 2 * grey[:, 1:-1] + grey[:, 2:]) / 16)


def halved(grey: Grey) -> Grey:
    height, width = grey.shape
    even = grey[: height & ~1, : width & ~1]
    return np.asarray((even[::2, ::2] + even[1::2, ::2] + even[::2, 1::2] + even[1::2, 1::2]) / 4)


def sought(expect: Expect, width: int, height: int, pairs: int = 1) -> list[Sought]:
    """The patches of so many pictures of one size: a band of rows each SIDE, in it at most COLUMNS_MAX. `expect`: of
    (pairs, n, 2) places in each first picture, where they should be in the second; NaN: nowhere."""
    at, half = grid(width, height), SIDE / 2
    corners = np.stack(np.meshgrid([-half, 0, half], [-half, 0, half], indexing="ij"), axis=2).reshape(9, 1, 2)
    around = np.broadcast_to((at + corners).reshape(-1, 2), (pairs, 9 * len(at), 2))
    p = expect(around).reshape(pairs, 3, 3, len(at), 2).transpose(1, 2, 0, 3, 4)
    shape = np.stack([p[2, 1] - p[0, 1], p[1, 2] - p[1, 0]], axis=3) / SIDE
    mixed = (p[2, 2] - p[2, 0] - p[0, 2] + p[0, 0]) / 2
    curve = np.stack([p[2, 1] + p[0, 1] - 2 * p[1, 1], mixed, p[1, 2] + p[1, 0] - 2 * p[1, 1]], axis=3)
    curve /= 2 * half * half
    return [Sought(at, *each) for each in zip(p[1, 1], shape, curve, strict=True)]


def grid(width: int, height: int) -> Floats:
    """(n, 2): middles of patches."""
    rows = np.arange(SIDE // 2 + 1, height - SIDE // 2, SIDE)
    count = min(COLUMNS_MAX, (width - 2) // SIDE)
    columns = np.linspace(SIDE // 2 + 1, width - SIDE // 2 - 2, count).astype(int)
    at = np.stack(np.meshgrid(columns, rows), axis=2).reshape(-1, 2)
    # A patch has an even side: its middle lies between pixels.
    return np.asarray(at - 0.5 - [(width - 1) / 2, (height - 1) / 2])


def find(before: Grey, after: Grey, near: Sought, levels: int) -> Found:
    """`levels`: how often the pictures are halved first, so that an expectation that is far off does no harm."""
    height, width = before.shape
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    at, there, shape, curve = near.at, near.there, near.shape, near.curve
    inside = np.all(np.abs(there) < middle - 2, axis=1) & np.isfinite(curve).all(axis=(1, 2))
    inside &= np.linalg.det(np.where(inside[:, None, None], shape, 0)) > 0.2
    at, there, shape, curve = at[inside], there[inside], shape[inside], curve[inside]
    pyramid = [(before, after)]
    for _ in range(levels):
        pyramid.append((halved(pyramid[-1][0]), halved(pyramid[-1][1])))
    shift = np.zeros_like(at)
    for level in range(levels, -1, -1):
        scale = 0.5**level
        # The middle of a halved picture's pixel lies between four.
        from_, to = ((each + middle + 0.5) * scale - 0.5 for each in (at, there + shift))
        step, squares, noise, alike = track(*pyramid[level], from_, to, shape, curve / scale)
        shift = shift + np.clip(step / scale, -SIDE, SIDE)
    textured = np.linalg.eigvalsh(squares)[:, 1] > (CONTRAST * SIDE) ** 2
    sure = textured & (alike > ALIKE) & (np.abs(shift).max(axis=1) < (FAR if levels == 0 else 2.0) * SIDE)
    covariance = np.linalg.inv(squares[sure] + (WEAK * CONTRAST * SIDE) ** 2 * np.eye(2)) * noise[sure, None, None]
    information = np.linalg.inv(covariance + FLOOR_PX**2 * np.eye(2))
    return Found(at[sure], (there + shift)[sure], np.asarray(information, np.float64), int(textured.sum()), len(at))


def track(
    before: Grey, after: Grey, from_: Floats, to: Floats, shape: Floats, curve: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Patches about `from_` in one picture, sought about `to` in the other, pixels: by how much further (n, 2) they
    are; the sum of the squares of their gradients (n, 2, 2); what is left, mean square; and the correlation."""
    wide = np.arange(SIDE + 2, dtype=np.float32) - (SIDE + 1) / 2
    around = from_.T.astype(np.float32)[:, :, None, None] + np.stack(np.meshgrid(wide, wide))[:, None]
    whole, known = sample(before, *around)
    # Where the slope is known too; and the slope as the other picture has it: that is stretched.
    is_in = known[:, 1:-1, 2:] * known[:, 1:-1, :-2] * known[:, 2:, 1:-1] * known[:, :-2, 1:-1]
    right, down = whole[:, 1:-1, 2:] - whole[:, 1:-1, :-2], whole[:, 2:, 1:-1] - whole[:, :-2, 1:-1]
    slopes = np.stack([right * is_in, down * is_in], axis=1).reshape(len(from_), 2, -1)
    slopes = np.linalg.inv(2 * shape).transpose(0, 2, 1).astype(np.float32) @ slopes
    squares = (slopes @ slopes.transpose(0, 2, 1)).astype(np.float64)
    solve = np.linalg.inv(squares + (WEAK * CONTRAST * SIDE) ** 2 * np.eye(2))
    template, is_in = (each.reshape(len(from_), -1) for each in (whole[:, 1:-1, 1:-1], is_in))
    square = np.stack(np.meshgrid(wide[1:-1], wide[1:-1])).reshape(2, -1)
    terms = np.concatenate([square, [square[0] ** 2, square[0] * square[1], square[1] ** 2]])
    stretched = np.concatenate([shape, curve], axis=2).astype(np.float32) @ terms + to.astype(np.float32)[:, :, None]
    shift, noise, alike = np.zeros_like(to), np.ones(len(to)), np.zeros(len(to))
    lively = np.arange(len(to))
    for _ in range(ROUNDS):
        there = stretched[lively] + shift[lively].astype(np.float32)[:, :, None]
        other, also_in = sample(after, there[:, 0], there[:, 1])
        weight = is_in[lively] * also_in
        count = np.maximum(weight.sum(axis=1), 1)
        a, b = (centred(each, weight, count) for each in (template[lively], other))
        power_a, power_b, both = (np.einsum("np,np->n", *each) for each in ((a, a), (b, b), (a, b)))
        # Exposure may have changed.
        left = a - b * np.sqrt(power_a / np.maximum(power_b, 1e-9))[:, None]
        pull = (slopes[lively] @ left[:, :, None]).astype(np.float64)
        step = np.clip((solve[lively] @ pull)[:, :, 0], -2, 2)
        shift[lively] += step
        rests = np.abs(step).max(axis=1) < SETTLED_PX
        noise[lively] = np.einsum("np,np->n", left, left) / count
        alike[lively] = np.where(rests, both / np.sqrt(np.maximum(power_a * power_b, 1e-9)), 0)
        lively = lively[~rests]
        if not len(lively):
            break
    return shift, squares, noise, alike


def centred(values: Grey, weight: Grey, count: Grey) -> Grey:
    """Less their mean; 0 where nothing is known."""
    mean = np.einsum("np,np->n", values, weight) / count
    return np.asarray((values - mean[:, None]) * weight)


def sample(grey: Grey, x: Grey, y: Grey) -> tuple[Grey, Grey]:
    """Between the four nearest pixels; and 1 for what lies inside, else 0."""
    height, width = grey.shape
    known = ((x >= 0) & (x < width - 1) & (y >= 0) & (y < height - 1)).astype(np.float32)
    x, y = x * known, y * known
    j, i = x.astype(np.int32), y.astype(np.int32)
    # A whole number of another type would make all that follows float64, at twice the time.
    right, down = x - j.astype(np.float32), y - i.astype(np.float32)
    place, flat = i * width + j, grey.ravel()
    upper, lower = flat.take(place), flat[width:].take(place)
    upper += (flat[1:].take(place) - upper) * right
    lower += (flat[width + 1 :].take(place) - lower) * right
    return (upper + (lower - upper) * down) * known, known
