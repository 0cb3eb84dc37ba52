"""How well two gyros on a teeterboard tell the shift between two clocks: against the truth and the bound of theory.

    python benchmarks/gyro.py [--seeds 30]

The bound is Cramér and Rao's (sim.teeterboard.bound_us), with skew, gain and bias unknown. Noise that is white in the
logged samples comes first. Then noise that went through the sensors' filters as the signal did: of both hardly any is
left above 200 Hz, but as much of one as of the other, so that a bound can count on it (it is 0.4 of the one printed,
which stops at 200 Hz). Nobody can use it: what the board does above 500 Hz is folded onto it.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from host.clock.gyro import Gyro, Refused, compare
from host.clock.gyro_paper import paper_shift
from host.clock.gyro_signal import SMOOTH_HZ
from host.usd.decode import decode
from sim.teeterboard import DENSITY_DPS_RTHZ, Board, Teetered, bound_us, noise_dps, teeter

RATIO_MAX = 1.2
SENSOR_DPS = noise_dps(Board())
"""Of a logged sample, by the data sheet."""


def gyros(made: Teetered) -> list[Gyro]:
    found = []
    for data in made.logs:
        rows = decode(data).rows["fixedFrequency"]
        rate = np.stack([rows.data[f"gyro.{axis}"].astype(np.float64) for axis in "xyz"], axis=1)
        found.append(Gyro(rows.stamp_us.astype(np.float64), rate))
    return found


def row(name: str, seeds: int, density: float, white: float, below_hz: float = 500.0) -> float:
    """rms over bound, printed with the rest."""
    error, bound, sigma, paper = [], [], [], []
    for seed in range(seeds):
        made = teeter(Board(seed=seed, density_dps_rthz=density, white_dps=white))
        found = compare(*gyros(made))
        if isinstance(found, Refused):
            print(f"{name}, seed {seed}: {found.why}")
            return float("inf")
        error.append(found.shift_us - float(made.shift_us(found.at_us)))
        bound.append(bound_us(made, found.at_us, below_hz))
        sigma.append(found.sigma_us)
        as_paper = paper_shift(found.first, found.second, found.shift_us)
        paper.append(as_paper.sd_us if as_paper else np.nan)
    off, least, said = np.array(error), np.array(bound), np.array(sigma)
    ratio = float(np.sqrt(np.mean((off / least) ** 2)))
    print(
        f"{name:32}{np.sqrt(np.mean(off**2)):9.2f}{least.mean():9.2f}{ratio:9.2f}{np.median(said):9.2f}"
        f"{np.sqrt(np.mean((off / said) ** 2)):9.2f}{(np.abs(off) < 2 * said).mean() * 100:9.0f}{np.mean(paper):9.0f}"
    )
    return ratio


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=30, help="each is a minute with 16 impacts")
    seeds = parser.parse_args().seeds
    print(f"{'us':32}{'rms':>9}{'bound':>9}{'ratio':>9}{'sigma':>9}{'rms/sig':>9}{'% in 2':>9}{'paper sd':>9}")
    good = True
    for dps in (0.1, 0.3, 1.0, 3.0, 10.0):
        good &= row(f"white, {dps:g} deg/s", seeds, 0.0, dps) <= RATIO_MAX
    for dps in (0.1, 1.0, 10.0):
        row(f"through the filters, {dps:g} deg/s", seeds, DENSITY_DPS_RTHZ * dps / SENSOR_DPS, 0.0, SMOOTH_HZ)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
