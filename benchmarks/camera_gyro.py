"""How well the offset between a camera's frames and a gyro's log is found: errors against the simulator's truth.

    python benchmarks/camera_gyro.py [--seeds 24] [--rendered 3]

First places of 12 bands are given with noise of 0.05, 0.2 and 1 px, 40 s of them (bar: 0.1 ms rms at 0.2 px). Then
pictures alone, 20 s of 324 x 244 pixels with noise of 2 grey levels; a picture is rendered in some 15 ms.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from host.clock.camera import Refused, align
from host.clock.camera_fit import Fit, fit, start
from host.clock.camera_model import LINE, MIDDLE, Places, mount
from host.clock.gyro_filter import NOMINAL_US, as_exposed
from host.clock.turning import Turning
from sim.turned_camera import Flight, Motion, flight

BANDS, BAR_MS = 12, 0.1


def given(made: Flight, px: float, line_free: bool) -> tuple[Fit | None, float]:
    """The estimate from bands with noise, and its true value."""
    index, before, after = made.band_shifts(BANDS, px)
    zero_s = float(made.stamp_s.mean())
    stamps = np.stack([made.stamp_s[index], made.stamp_s[index + 1]], axis=1) - zero_s
    sure = np.tile(np.eye(2) / px**2, (len(index), 1, 1))
    inside = np.all(np.abs(after) < [made.optics.width / 2, made.optics.height / 2], axis=1)
    places = Places(index, stamps, before, after, sure).some(np.asarray(inside))
    time_s = made.gyro_time_s - zero_s
    turning = Turning(time_s, as_exposed(time_s, np.radians(made.gyro_deg_s), NOMINAL_US, 0.0))
    begin = start(made.body_middle_s + 3e-3, made.optics.line_s, 150.0)
    return fit(places, turning, mount(0), begin, line_free), made.body_middle_s


def told(name: str, error_s: Sequence[float], sigma_s: Sequence[float], refused: int, more: str = "") -> float:
    """Prints a row; rms in ms."""
    if not error_s:
        print(f"{name:34}{refused:63}")
        return float("inf")
    error, sigma = np.array(error_s) * 1e3, np.array(sigma_s) * 1e3
    rms = float(np.sqrt(np.mean(error**2)))
    inside = np.mean(np.abs(error) < 2.58 * sigma) * 100
    print(
        f"{name:34}{rms:9.3f}{np.abs(error).max():9.3f}{error.mean():9.3f}{np.median(sigma):9.3f}"
        f"{np.sqrt(np.mean((error / sigma) ** 2)):9.2f}{inside:9.0f}{refused:9}{more}"
    )
    return rms


@dataclass(frozen=True)
class Film:
    made: Flight
    pictures: list[NDArray[np.uint8]]

    @property
    def width(self) -> int:
        return self.made.optics.width

    @property
    def height(self) -> int:
        return self.made.optics.height

    @property
    def stamp_us(self) -> NDArray[np.float64]:
        return self.made.stamp_s * 1e6

    def __iter__(self) -> Iterator[NDArray[np.uint8]]:
        return iter(self.pictures)


def rendered(motion: Motion, fps: float, seeds: range) -> bool:
    """Prints a row, and whether it reaches the bar."""
    error, sigma, late, refused = [], [], [], 0
    for seed in seeds:
        made = flight(seed, motion, seconds=20, fps=fps)
        film = Film(made, [made.frame(index) for index in range(len(made.stamp_s))])
        rates, optics = np.radians(made.gyro_deg_s), made.optics
        got = align(film, made.gyro_time_s * 1e6, rates, optics.line_s, optics.exposure_s)
        if isinstance(got, Refused):
            refused += 1
            continue
        error.append(float(got.fitted.theta[MIDDLE]) - made.body_middle_s)
        sigma.append(float(got.fitted.sigma[MIDDLE]))
        if got.onsets:
            late += ((got.onsets.late_s + made.offset_s) * 1e3).tolist()
    paper = f"   the paper's procedure: {np.mean(late):+.1f} +- {np.std(late):.1f} ms" if late else ""
    rms = told(f"{motion}, {fps:g} fps, from pictures", error, sigma, refused, paper)
    return rms <= BAR_MS and not refused


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=24, help="of bands, for each row")
    parser.add_argument("--rendered", type=int, default=3, help="of pictures alone")
    options = parser.parse_args()
    seeds, few = range(options.seeds), range(options.rendered)
    print(f"{'ms':34}{'rms':>9}{'max':>9}{'mean':>9}{'sigma':>9}{'rms/sig':>9}{'% 99':>9}{'refused':>9}")
    good = True
    for motion in get_args(Motion)[:2]:
        for fps in (30, 6):
            for px in (0.05, 0.2, 1.0):
                error, sigma, readout, refused = [], [], [], 0
                for seed in seeds:
                    made = flight(seed, motion, fps=fps)
                    got, true_s = given(made, px, line_free=False)
                    free, _ = given(made, px, line_free=True)
                    if got is None or free is None:
                        refused += 1
                        continue
                    error.append(float(got.theta[MIDDLE]) - true_s)
                    sigma.append(float(got.sigma[MIDDLE]))
                    readout.append((float(free.theta[LINE]) - made.optics.line_s) * made.optics.height * 1e3)
                line = f"   readout if free: {np.sqrt(np.mean(np.square(readout))):.3f} ms rms"
                rms = told(f"{motion}, {fps} fps, {px} px a band", error, sigma, refused, line)
                good &= px > 0.2 or (rms <= BAR_MS and not refused)
    for motion in get_args(Motion)[:2]:
        for fps in (30, 6):
            good &= rendered(motion, fps, few)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
