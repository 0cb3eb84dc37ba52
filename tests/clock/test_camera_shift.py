"""Image shift: tiles and patches against known shifts, and against OpenCV's phase correlation and optical flow."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from host.clock.camera_patches import Expect, Found, find, smooth, sought
from host.clock.camera_tiles import SURE, Tiles
from sim.panorama import panorama

DATA = Path(os.environ.get("SPINDECK_DATA", Path(__file__).resolve().parents[3] / "shared/data"))
REAL = ("imgTest0.pgm", "imgTest1.pgm")


def cut(world: np.ndarray, left: float, top: float, width: int, height: int) -> np.ndarray:
    """A window of a picture, between its pixels, by its Fourier transform: nothing that the code under test does."""
    spectrum = np.fft.rfft2(world)
    phase = np.fft.rfftfreq(world.shape[1]) * left + np.fft.fftfreq(world.shape[0])[:, None] * top
    moved = np.fft.irfft2(spectrum * np.exp(2j * np.pi * phase), world.shape)
    return moved[40 : 40 + height, 40 : 40 + width]


def pair(seed: int, u: float, v: float, noise: float = 2.0, world: np.ndarray | None = None) -> list[np.ndarray]:
    """Two pictures of 324 x 244 (or what fits), the second one's content moved by u to the right and v down."""
    rng = np.random.default_rng(seed)
    if world is None:
        world = panorama(seed % 2, 366)[:350, :420]
    height, width = min(244, world.shape[0] - 80), min(324, world.shape[1] - 80)
    made = [cut(world, left, top, width, height) for left, top in ((0, 0), (-u, -v))]
    return [np.clip(each + rng.normal(0, noise, each.shape), 0, 255).astype(np.uint8) for each in made]


def search(before: np.ndarray, after: np.ndarray, expect: Expect, levels: int) -> Found:
    return find(before, after, sought(expect, before.shape[1], before.shape[0])[0], levels)


def tile_shift(before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tiles = Tiles.of(before.shape[1], before.shape[0])
    return tiles.moved(tiles.spectra(before), tiles.spectra(after))


@pytest.mark.parametrize(("u", "v"), [(0, 0), (0.5, -0.25), (7.3, 2.6), (-25.4, 11.2), (33.5, -30.25)])
def test_tiles_find_known_shifts(u: float, v: float) -> None:
    moved, sure = tile_shift(*pair(1, u, v))
    assert (sure > SURE).all()
    assert np.abs(moved - [u, v]).max() < 0.35


def test_tiles_of_chance_are_not_sure() -> None:
    rng = np.random.default_rng(3)
    unsure = []
    for _ in range(10):
        before, after = rng.integers(90, 130, (2, 244, 324)).astype(np.uint8)
        unsure.append(tile_shift(before, after)[1])
    assert (np.array(unsure) < SURE).all()
    flat = np.full((244, 324), 80, np.uint8)
    assert (tile_shift(flat, flat)[1] < SURE).all()


@pytest.mark.parametrize("noise", [2, 6, 12])
def test_patches_are_as_good_as_their_noise_lets_them(noise: float) -> None:
    """A band of 20 rows is good to 0.009, 0.028 and 0.053 px; a patch, which is a sixteenth of one, four times that."""
    errors, scaled = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        u, v = rng.uniform(-3, 3, 2)
        before, after = pair(seed, u, v, noise)
        found = search(smooth(before), smooth(after), lambda at: at, levels=1)
        assert len(found.before) > 0.7 * found.expected
        off = found.after - found.before - [u, v]
        errors.append(off)
        scaled.append(np.einsum("ni,nij,nj->n", off, found.information, off) / 2)
    spread = np.median(np.abs(np.concatenate(errors))) * 1.4826
    assert spread < 0.01 + 0.02 * noise
    assert np.abs(np.median(np.concatenate(errors), axis=0)).max() < 0.02
    # Smoothed noise is not white, so covariances are too small, by the same factor everywhere: the fit finds it.
    assert 0.5 < np.sqrt(np.median(np.concatenate(scaled)) / np.log(2)) < 4


def test_patches_against_a_wrong_expectation() -> None:
    before, after = pair(1, 6.0, -5.0)
    near = search(smooth(before), smooth(after), lambda at: at + np.array([6.5, -4.5]), levels=0)
    far = search(smooth(before), smooth(after), lambda at: at + np.array([-4.0, 4.0]), levels=2)
    for found in (near, far):
        off = np.abs(found.after - found.before - [6.0, -5.0]).max(axis=1)
        assert np.mean(off < 0.3) > 0.9
    lost = search(smooth(before), smooth(after[::-1, ::-1].copy()), lambda at: at, levels=0)
    assert len(lost.before) < 0.3 * lost.expected


def test_exposure_and_gain_may_change() -> None:
    before, after = pair(0, 1.4, 0.6)
    darker = (after * 0.7 + 12).astype(np.uint8)
    found = search(smooth(before), smooth(darker), lambda at: at, levels=0)
    assert np.abs(np.median(found.after - found.before, axis=0) - [1.4, 0.6]).max() < 0.03


def test_the_pattern_of_a_colour_sensor_does_not_hold_pictures_back() -> None:
    """The AI-deck's camera has coloured filters over its pixels, two by two, that do not move with the scene."""
    gain = np.tile([[1.0, 0.75], [0.7, 0.5]], (122, 162))
    before, after = ((each * gain).astype(np.uint8) for each in pair(0, 2.5, -1.5))
    found = search(smooth(before), smooth(after), lambda at: at, levels=1)
    assert np.abs(np.median(found.after - found.before, axis=0) - [2.5, -1.5]).max() < 0.02
    moved, sure = tile_shift(before, after)
    assert np.abs(moved[sure > SURE] - [2.5, -1.5]).max() < 0.35
    assert (sure > SURE).mean() > 0.9


def test_flat_pictures_have_no_texture() -> None:
    rng = np.random.default_rng(1)
    before, after = np.clip(rng.normal(100, 2, (2, 122, 162)), 0, 255).astype(np.uint8)
    found = search(smooth(before), smooth(after), lambda at: at, levels=0)
    assert found.textured < 0.1 * found.expected


def test_tiles_against_opencv() -> None:
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed: a second opinion on shifts")
    for seed in range(4):
        rng = np.random.default_rng(seed)
        before, after = pair(seed, *rng.uniform(-20, 20, 2))
        tiles = Tiles.of(324, 244)
        moved, _ = tile_shift(before, after)
        window = cv2.createHanningWindow((tiles.side, tiles.side), cv2.CV_32F)
        for (i, j), mine in zip(tiles.corners, moved, strict=True):
            one, other = (each[i : i + tiles.side, j : j + tiles.side].astype(np.float32) for each in (before, after))
            theirs, _ = cv2.phaseCorrelate(one - one.mean(), other - other.mean(), window)
            assert np.abs(mine - theirs).max() < 0.6


def test_patches_against_opencv() -> None:
    cv2 = pytest.importorskip("cv2", reason="opencv-python-headless is not installed: a second opinion on optical flow")
    for seed in range(3):
        rng = np.random.default_rng(10 + seed)
        u, v = rng.uniform(-4, 4, 2)
        before, after = pair(seed, u, v)
        found = search(smooth(before), smooth(after), lambda at: at, levels=1)
        middle = np.array([(324 - 1) / 2, (244 - 1) / 2])
        points = (found.before + middle).astype(np.float32)[:, None]
        settings = {"winSize": (19, 19), "maxLevel": 2, "criteria": (3, 30, 0.001)}
        theirs, status, _ = cv2.calcOpticalFlowPyrLK(before, after, points, None, **settings)
        good = status[:, 0] == 1
        between = (found.after + middle)[good] - theirs[good, 0]
        assert good.mean() > 0.9
        assert np.median(np.abs(between)) < 0.06
        mine, other = (np.median(np.abs(each - [u, v])) for each in
                       ((found.after - found.before)[good], (theirs - points)[good, 0]))  # fmt: skip
        assert mine < 1.2 * other


@pytest.mark.parametrize("name", REAL)
def test_real_frames_have_texture_enough(name: str) -> None:
    """Frames of a real AI-deck, moved by known parts of pixels. Recordings with a gyro's log are not known."""
    path = DATA / "images/aideck" / name
    if not path.exists():
        pytest.skip(f"{path} is not here: real frames are not part of the project (SPINDECK_DATA names their folder)")
    with Image.open(path) as image:
        world = np.asarray(image).astype(np.float64)
    before, after = pair(1, 2.3, -1.6, world=world)
    found = search(smooth(before), smooth(after), lambda at: at, levels=1)
    assert len(found.before) > 0.4 * found.expected
    off = found.after - found.before - [2.3, -1.6]
    assert np.median(np.abs(off)) < 0.1
    assert np.abs(np.median(off, axis=0)).max() < 0.04
    moved, sure = tile_shift(before, after)
    assert np.abs(moved[sure > SURE] - [2.3, -1.6]).max() < 0.5
