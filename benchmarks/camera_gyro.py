"""How well the offset between a camera's frames and a gyro's log is found: errors against the simulator's truth.

python benchmarks/camera_gyro.py [SEEDS]     (default 12; each is 40 s)

Places of 12 bands are given with noise of 0.2 px (bar: 0.1 ms rms).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import get_args

import numpy as np

from host.clock.camera_fit import Fit, fit, start
from host.clock.camera_model import LINE, MIDDLE, Places, mount
from host.clock.turning import Turning, unlagged
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
    turning = Turning(time_s, unlagged(time_s, np.radians(made.gyro_deg_s), made.gyro.filters_hz))
    begin = start(made.body_middle_s + 3e-3, made.optics.line_s, 150.0)
    return fit(places, turning, mount(0), begin, line_free), made.body_middle_s


def told(name: str, error_s: Sequence[float], sigma_s: Sequence[float], refused: int, more: str = "") -> float:
    """Prints a row; rms in ms."""
    error, sigma = np.array(error_s) * 1e3, np.array(sigma_s) * 1e3
    rms = float(np.sqrt(np.mean(error**2)))
    inside = np.mean(np.abs(error) < 2.58 * sigma) * 100
    print(
        f"{name:34}{rms:9.3f}{np.abs(error).max():9.3f}{error.mean():9.3f}{np.median(sigma):9.3f}{inside:9.0f}"
        f"{refused:9}{more}"
    )
    return rms


def main() -> int:
    seeds = range(int(sys.argv[1]) if len(sys.argv) > 1 else 12)
    print(f"{'ms':34}{'rms':>9}{'max':>9}{'mean':>9}{'sigma':>9}{'% 99':>9}{'refused':>9}")
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
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
