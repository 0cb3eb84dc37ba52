"""A first offset, mount and focal length, from large tiles of the pictures and whatever offset explains them best."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from .camera_model import mount
from .camera_tiles import SURE
from .ticks import Floats
from .turning import Turning

STEP_S = 4e-3
FOCAL = 0.55
"""Of the picture's width: where in the field of view a tile is taken to be."""
MOUNTS = [(pitch_deg, roll_deg) for pitch_deg in (0.0, 45.0, 90.0) for roll_deg in (0.0, 90.0, 180.0, 270.0)]
"""The dataset paper's three, and pictures that are turned."""
AGAIN = 2.0
"""Another offset that leaves less than so many times what the best one leaves is as good."""
REWEIGHTED = 3
TURN_MAX = 0.25
"""rad, from frame to frame: of larger ones, those found by chance outweigh the others."""
TOGETHER = 10_000
"""Turns that are worked out at once."""
SOLVED = 1e-4
"""Ridge, of the mean: axes that the motion does not use."""


@dataclass(frozen=True, slots=True)
class Coarse:
    middle_s: float
    focal_px: float
    pitch_deg: float
    roll_deg: float
    explained: float
    """Part of the tiles' motion (sum of squares) that goes with the gyro."""
    rival_s: float | None
    """Another offset that does as well."""
    offsets_s: Floats
    explained_at: Floats
    """For each of them; NaN where the log has too few of the frames."""


def coarse(
    stamps_s: Floats, middles: Floats, moved: Floats, sure: Floats, width: int, turning: Turning, reach_s: float
) -> Coarse | None:
    """`stamps_s` (pairs, 2), `middles` (tiles, 2), `moved` (pairs, tiles, 2), `sure` (pairs, tiles). None when no
    offset within `reach_s` of 0 has pairs in the log whose tiles moved surely."""
    x, y = (middles / (FOCAL * width)).T
    nought = np.zeros_like(x)
    # What a turn (about right, down, ahead; times the focal length) does to a tile, to first order.
    effect = -np.stack(
        [np.stack([-x * y, 1 + x * x, -y], axis=1), np.stack([-(1 + y * y), x * y, x + nought], axis=1)], axis=1
    )
    weight = (sure > SURE).astype(np.float64)
    offsets = np.arange(-reach_s, reach_s + STEP_S / 2, STEP_S)
    turns = list(turns_of(turning, stamps_s, offsets))
    for _ in range(REWEIGHTED):
        by_pair = np.einsum("kt,tij,til->kjl", weight, effect, effect)
        pulled = np.einsum("kt,tij,kti->kj", weight, effect, moved)
        motion = np.einsum("kt,kti->k", weight, moved**2)
        explained: Floats = np.array([explain(by_pair, pulled, motion, *each)[0] for each in turns])
        if not np.isfinite(explained).any():
            return None
        best = int(np.nanargmax(explained))
        turn, known = turns[best]
        _, lens = explain(by_pair, pulled, motion, turn, known)
        left = moved - np.einsum("tij,kj->kti", effect, turn @ lens.T)
        size = np.sqrt((left**2).sum(axis=2))
        kept = size[known][weight[known] > 0]
        if not len(kept):
            return None
        usual = max(float(np.median(kept)), 0.3)
        # Far turns are beyond the first order, and beyond a tile.
        small = np.sqrt((turn**2).sum(axis=1)) < TURN_MAX
        weight = (sure > SURE) * small[:, None] / (1 + (size / (3 * usual)) ** 4)
    middle_s = float(offsets[best] + STEP_S * top(explained, best))
    pitch_deg, roll_deg, focal_px = mounted(by_pair, pulled, turn, known)
    if focal_px <= 0:
        return None
    rival = rival_of(explained, best)
    rival_s = None if rival is None else float(offsets[rival])
    return Coarse(middle_s, focal_px, pitch_deg, roll_deg, float(explained[best]), rival_s, offsets, explained)


def turns_of(turning: Turning, stamps_s: Floats, offsets_s: Floats) -> Iterator[tuple[Floats, np.ndarray]]:
    """For each offset: of each pair, zero where the log does not know it; and where it does."""
    together = max(TOGETHER // len(stamps_s), 1)
    for first in range(0, len(offsets_s), together):
        at_s = (stamps_s + offsets_s[first : first + together, None, None]).reshape(-1, 2)
        known = turning.is_known(at_s[:, 0], at_s[:, 1])
        turn = turning.between(at_s[:, 0], at_s[:, 1]) * known[:, None]
        yield from zip(turn.reshape(-1, len(stamps_s), 3), known.reshape(-1, len(stamps_s)), strict=True)


def normal(by_pair: Floats, pulled: Floats, turn: Floats) -> tuple[Floats, Floats]:
    """Of the nine entries of focal length times mount."""
    square = (turn[:, :, None] * turn[:, None]).reshape(-1, 9)
    both = (by_pair.reshape(-1, 9).T @ square).reshape(3, 3, 3, 3).transpose(0, 2, 1, 3).reshape(9, 9)
    return both, np.einsum("kj,ka->ja", pulled, turn).reshape(9)


def explain(by_pair: Floats, pulled: Floats, motion: Floats, turn: Floats, known: np.ndarray) -> tuple[float, Floats]:
    """Which part of the motion any mount and focal length explain, and they. NaN when the log has too few pairs."""
    total = float(motion[known].sum())
    if known.sum() < 0.5 * len(known) or total <= 0:
        return float("nan"), np.zeros((3, 3))
    both, right = normal(by_pair, pulled, turn)
    lens = np.linalg.solve(both + SOLVED * (np.trace(both) / 9 + 1e-30) * np.eye(9), right)
    return float((2 * right @ lens - lens @ both @ lens) / total), lens.reshape(3, 3)


def mounted(by_pair: Floats, pulled: Floats, turn: Floats, known: np.ndarray) -> tuple[float, float, float]:
    """The mount of MOUNTS that explains most, and with which focal length."""
    both, right = normal(by_pair, pulled, turn)
    found: list[tuple[float, float, float, float]] = []
    for pitch_deg, roll_deg in MOUNTS:
        vector = mount(pitch_deg, roll_deg).reshape(9)
        focal_px = float(right @ vector) / max(float(vector @ both @ vector), 1e-30)
        found.append((max(focal_px, 0) * float(right @ vector), pitch_deg, roll_deg, focal_px))
    return max(found)[1:]


def top(values: Floats, at: int) -> float:
    """Where a parabola through the highest and its neighbours is highest, in steps from it."""
    if not 0 < at < len(values) - 1 or not np.isfinite(values[at - 1 : at + 2]).all():
        return 0.0
    low, high, after = values[at - 1 : at + 2]
    bend = low - 2 * high + after
    return float(np.clip(0.5 * (low - after) / bend, -0.5, 0.5)) if bend < 0 else 0.0


def rival_of(explained: Floats, best: int) -> int | None:
    """Beyond the valleys on either side of the best."""
    values = np.nan_to_num(explained, nan=-1.0)
    left = right = best
    while left > 0 and values[left - 1] <= values[left]:
        left -= 1
    while right < len(values) - 1 and values[right + 1] <= values[right]:
        right += 1
    others = values.copy()
    others[left : right + 1] = -1
    other = int(others.argmax())
    return other if 1 - others[other] < AGAIN * (1 - values[best]) else None
