"""The time offset between a camera's frames and a gyro's log of the same robot, from the pictures themselves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .camera_coarse import Coarse, coarse
from .camera_fit import Fit, Part, by_part, fit, start
from .camera_model import MIDDLE, Places, expected, mount
from .camera_onset import Onsets, onsets
from .camera_patches import Sought, find, smooth, sought
from .camera_tiles import SURE, Tiles
from .gyro import DPS
from .gyro_filter import as_exposed, late_us, sample_us
from .ticks import Floats
from .turning import GAP_S, Turning

Reason = Literal[
    "too few frames",
    "the log does not cover the frames",
    "too little rotation",
    "too little texture",
    "the pictures do not move with the gyro",
    "several offsets fit",
    "not sure enough",
]
PAIRS_MIN, PLACES_MIN = 20, 200
PAIRS_MAX, FIRST_PAIRS = 600, 40
"""Of the frames' pairs, so many are looked at closely: in each of BLOCKS parts those in which the rate changes most."""
BLOCKS = 20
TOGETHER = 16
"""Pairs whose patches are looked for in a row."""
SIDE_MIN = 60
APART_S = 0.5
"""Frames further apart are no pair."""
RATE_MIN, SLOW_MIN = np.radians([2.0, 0.5])
"""rad/s, rms: least, and what a gyro at rest never shows, but one that counts radians does."""
FOCAL_MAX = 10.0
"""Of a picture's width: no lens of a drone is so long."""
SURE_MIN, TEXTURE_MIN = 0.1, 0.1
"""Of tiles, and of patches."""
COARSE_MIN, FINE_MIN = 0.8, 0.9
"""Of the motion: what must go with the gyro."""
SIGMA_MAX_S = 1e-3
LINE_S = 100e-6
"""To begin with, if it is not known."""


class Film(Protocol):
    """Frames in the order of their stamps; can be gone through more than once."""

    @property
    def width(self) -> int: ...

    @property
    def height(self) -> int: ...

    @property
    def stamp_us(self) -> Floats: ...

    def __iter__(self) -> Iterator[NDArray[np.uint8]]: ...


@dataclass(frozen=True, slots=True)
class Refused:
    reason: Reason
    detail: str


@dataclass(frozen=True, slots=True)
class Aligned:
    zero_us: float
    """The stamp at which offsets are told."""
    fitted: Fit
    """theta[MIDDLE]: from a stamp to the middle row's middle of exposure, on the log's clock less its known lag."""
    line_known: bool
    line: Fit
    """The same with the time from row to row unknown."""
    assumed: Floats
    """Mount, body to camera, that fitted.theta[MOUNT...] is added to."""
    first: Coarse
    places: Places
    moved_px: Floats
    """Of each pair of frames, by its tiles; NaN when nothing is sure."""
    explained: float
    onsets: Onsets | None
    gyro_late_us: float
    """Taken off: by its filters."""
    parts: list[Part]


def align(
    film: Film,
    gyro_us: Floats,
    rate_rad_s: Floats,
    line_s: float | None = None,
    exposure_s: float | None = None,
    filtered: bool = True,
    reach_s: float = 0.5,
) -> Aligned | Refused:
    """`line_s`: from row to row, if known; `exposure_s` likewise. `filtered`: the gyro went through the Crazyflie's
    filters. `reach_s`: offsets of the middle row that are thought of."""
    stamps = film.stamp_us
    if len(stamps) <= PAIRS_MIN:
        return Refused("too few frames", f"{len(stamps)} with a time, and {PAIRS_MIN + 1} are needed")
    if min(film.width, film.height) < SIDE_MIN:
        return Refused("too little texture", f"pictures of {film.width} x {film.height}; {SIDE_MIN} pixels are needed")
    zero_us = float(stamps[len(stamps) // 2])
    stamp_s, time_s = (stamps - zero_us) * 1e-6, (gyro_us - zero_us) * 1e-6
    pairs_s = np.stack([stamp_s[:-1], stamp_s[1:]], axis=1)
    usable = (np.diff(stamp_s) > 0) & (np.diff(stamp_s) < APART_S)
    if usable.sum() < PAIRS_MIN:
        return Refused("too few frames", f"{usable.sum()} follow another within {APART_S:g} s")
    heard = np.diff(np.searchsorted(time_s, pairs_s), axis=1)[:, 0] > 0
    if heard.sum() < PAIRS_MIN:
        rows = f"from {gyro_us[0]:.0f} to {gyro_us[-1]:.0f} us" if len(gyro_us) else "none"
        return Refused(
            "the log does not cover the frames",
            f"only {heard.sum()} of {len(stamps)} (from {stamps[0]:.0f} to {stamps[-1]:.0f} us; rows {rows}): were both"
            " made in one run, without a reset between?",
        )
    apart_s = float(np.median(np.diff(time_s)))
    if apart_s > GAP_S:
        return Refused(
            "the log does not cover the frames",
            f"its rows are {apart_s * 1e3:.0f} ms apart: log the gyro at 500 Hz or more",
        )
    near = (time_s > stamp_s[0] - reach_s - 1) & (time_s < stamp_s[-1] + reach_s + 1)
    time_s, rate_rad_s = time_s[near], rate_rad_s[near]
    during = (time_s > stamp_s[0]) & (time_s < stamp_s[-1])
    speed = float(np.sqrt(((rate_rad_s[during] - rate_rad_s[during].mean(axis=0)) ** 2).sum(axis=1).mean()))
    if speed < RATE_MIN:
        return Refused(
            "too little rotation",
            f"its rate varies by {np.degrees(speed):.2f} deg/s rms: a steady turn does not tell the time; turn it"
            f" to and fro, quickly{'' if speed < SLOW_MIN else f'; or is it in rad/s? {DPS}'}",
        )
    own_us = sample_us(gyro_us[near]) if filtered else None
    turning = Turning(time_s, as_exposed(time_s, rate_rad_s, own_us, exposure_s or 0.0))
    tiles = Tiles.of(film.width, film.height)
    moved, sure = tile_motion(film, tiles)
    sure[~usable] = 0
    part = float((sure[usable] > SURE).mean())
    if part < SURE_MIN:
        return Refused(
            "too little texture",
            f"{part:.0%} of the pictures' parts are found again in the next frame: more light, a nearer or richer"
            " scene, slower turns or a higher frame rate",
        )
    first = coarse(pairs_s, tiles.middles, moved, sure, film.width, turning, reach_s)
    if first is None or first.explained < COARSE_MIN:
        told = "none" if first is None else f"{first.explained:.0%}"
        return Refused(
            "the pictures do not move with the gyro",
            f"{told} of their motion goes with any offset within {reach_s:g} s: is it the log of this robot and run?",
        )
    if first.focal_px > FOCAL_MAX * film.width:
        return Refused(
            "the pictures do not move with the gyro",
            f"they move as far only behind a lens of {first.focal_px:.0f} px: is the gyro in rad/s? {DPS}",
        )
    if first.rival_s is not None:
        return Refused(
            "several offsets fit",
            f"{first.middle_s * 1e3:.0f} ms and {first.rival_s * 1e3:.0f} ms do: move less regularly, or look less far",
        )
    return refine(
        film, turning, zero_us, pairs_s, usable, first, line_s, moved, sure, 0.0 if own_us is None else late_us(own_us)
    )


def refine(
    film: Film, turning: Turning, zero_us: float, pairs_s: Floats, usable: NDArray[np.bool_], first: Coarse,
    line_s: float | None, moved: Floats, sure: Floats, gyro_late_us: float,
) -> Aligned | Refused:  # fmt: skip
    """By patches: a few, sought wide, and then many, sought where the few say."""
    assumed = mount(first.pitch_deg, first.roll_deg)
    theta = start(first.middle_s, LINE_S if line_s is None else line_s, first.focal_px)
    line_free = line_s is None
    fitted = None
    for count, levels in ((FIRST_PAIRS, 2), (PAIRS_MAX, 0)):
        wanted = choose(turning, pairs_s + theta[MIDDLE], usable, count)
        if wanted.sum() < PAIRS_MIN:
            return Refused(
                "the log does not cover the frames", f"{wanted.sum()} pairs of them: the others are in its gaps"
            )
        places, texture = patches(film, turning, theta, assumed, pairs_s, wanted, levels)
        if texture < TEXTURE_MIN:
            return Refused("too little texture", f"{texture:.0%} of all patches have some")
        if len(places.pair) < PLACES_MIN or len(np.unique(places.pair)) < PAIRS_MIN:
            return Refused(
                "too little texture", f"{len(places.pair)} patches were found again, in {wanted.sum()} frames"
            )
        fitted = fit(places, turning, assumed, theta, line_free)
        if fitted is None:
            return Refused("the pictures do not move with the gyro", "no lens and mount fit what patches do")
        theta = fitted.theta
    assert fitted is not None
    went = ((places.after - places.before) ** 2).sum(axis=1)
    explained = 1 - float((fitted.weight * (fitted.residual_px**2).sum(axis=1)).sum() / (fitted.weight * went).sum())
    if explained < FINE_MIN or np.mean(fitted.weight) < 0.5:
        return Refused("the pictures do not move with the gyro", f"{explained:.0%} of the patches' motion does")
    if fitted.sigma[MIDDLE] > SIGMA_MAX_S:
        return Refused(
            "not sure enough",
            f"± {fitted.sigma[MIDDLE] * 1e3:.1f} ms: a steady turn does not tell the time; turn to and fro, quickly",
        )
    line = fitted if line_free else fit(places, turning, assumed, theta, line_free=True)
    by_tile = np.where(sure > SURE, np.sqrt((moved**2).sum(axis=2)), np.nan)
    any_sure = np.isfinite(by_tile).any(axis=1)
    moved_px = np.full(len(by_tile), np.nan)
    moved_px[any_sure] = np.nanmedian(by_tile[any_sure], axis=1)
    stamp_s = np.append(pairs_s[:, 0], pairs_s[-1, 1])
    begun = onsets(turning.time_s, turning.rate_rad_s, stamp_s, moved_px)
    return Aligned(
        zero_us, fitted, not line_free, line or fitted, assumed, first, places, moved_px, explained, begun,
        gyro_late_us, by_part(places, turning, assumed, fitted),
    )  # fmt: skip


def tile_motion(film: Film, tiles: Tiles) -> tuple[Floats, Floats]:
    """Of each frame to the next."""
    moved, sure, before = [], [], None
    for picture in film:
        spectra = tiles.spectra(picture)
        if before is not None:
            found = tiles.moved(before, spectra)
            moved.append(found[0])
            sure.append(found[1])
        before = spectra
    return np.array(moved), np.array(sure)


def choose(turning: Turning, pairs_s: Floats, usable: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
    """Pairs whose frames see different rates tell the time: in each part of the recording the best are taken."""
    usable = usable & turning.is_known(pairs_s.min(axis=1) - 0.05, pairs_s.max(axis=1) + 0.05)
    rates = [
        np.stack([np.interp(pairs_s[:, each], turning.time_s, rate) for rate in turning.rate_rad_s.T], axis=1)
        for each in (0, 1)
    ]
    change = np.where(usable, np.sqrt(((rates[1] - rates[0]) ** 2).sum(axis=1)), -1.0)
    wanted = np.zeros(len(usable), np.bool_)
    for block in np.array_split(np.arange(len(usable)), BLOCKS):
        best = block[np.argsort(-change[block], kind="stable")[: -(-count // BLOCKS)]]
        wanted[best] = usable[best]
    return wanted


def patches(
    film: Film, turning: Turning, theta: Floats, assumed: Floats, pairs_s: Floats, wanted: NDArray[np.bool_],
    levels: int,
) -> tuple[Places, float]:  # fmt: skip
    """All patches of the wanted pairs, and which part of them has texture."""
    found = [Places(np.zeros(0, np.intp), *(np.zeros((0, *size)) for size in ((2,), (2,), (2,), (2, 2))))]
    textured, all_, before = 0, 0, None
    near = expectations(film, turning, theta, assumed, pairs_s[wanted])
    for number, picture in enumerate(film):
        begins, ends = number < len(wanted) and wanted[number], number > 0 and wanted[number - 1]
        if not begins and not ends:
            continue
        grey = smooth(picture)
        if ends:
            assert before is not None
            here = find(before, grey, next(near), levels)
            textured, all_ = textured + here.textured, all_ + here.expected
            pair = np.full(len(here.before), number - 1)
            found.append(Places(pair, pairs_s[pair], here.before, here.after, here.information))
        before = grey
    whole = Places(*(np.concatenate([getattr(each, name) for each in found]) for name in Places.__slots__))
    return whole, textured / max(all_, 1)


def expectations(film: Film, turning: Turning, theta: Floats, assumed: Floats, pairs_s: Floats) -> Iterator[Sought]:
    """For each pair, several worked out at once."""
    for some in np.split(pairs_s, range(TOGETHER, len(pairs_s), TOGETHER)):

        def expect(at: Floats, some: Floats = some) -> Floats:
            stamps_s = np.repeat(some, at.shape[1], axis=0)
            return expected(theta, assumed, turning, stamps_s, at.reshape(-1, 2))

        yield from sought(expect, film.width, film.height, len(some))
