"""How well a log's gyro tells how late motion capture is: simulated flights of known lags.

python benchmarks/lag.py [--seeds 10]
"""

from __future__ import annotations

import argparse
import sys

import numpy as np

from host.clock.gyro import Gyro, Refused
from host.clock.lag import Attitudes, lag_of
from host.usd.decode import decode
from host.usd.log import Rows
from sim.pose_log import Flight, pose_log

RMS_US_MAX = 100.0


def columns(rows: Rows, group: str, names: str) -> np.ndarray:
    return np.stack([rows.data[f"{group}.{name}"].astype(np.float64) for name in names.split()], axis=1)


def row(name: str, seeds: int, **settings: float) -> float:
    """rms, printed with the rest."""
    error, sigma, refused = [], [], 0
    for seed in range(seeds):
        flight = Flight(seed=seed, **settings)  # type: ignore[arg-type]
        log = decode(pose_log(flight))
        fixed, told = log.rows["fixedFrequency"], log.rows["estPose"]
        gyro = Gyro(fixed.stamp_us.astype(np.float64), columns(fixed, "gyro", "x y z"))
        found = lag_of(Attitudes(told.stamp_us.astype(np.float64), columns(told, "locSrv", "qx qy qz qw")), gyro)
        if isinstance(found, Refused):
            refused += 1
            continue
        error.append(found.behind_motion_us - flight.mocap_lag_us - flight.mocap_jitter_us / 2)
        sigma.append(found.sigma_us)
    off, said = np.array(error), np.array(sigma)
    rms = float(np.sqrt(np.mean(off**2)))
    inside = float((np.abs(off) < 2 * said).mean() * 100)
    print(
        f"{name:40}{rms:9.1f}{np.median(said):9.1f}{np.sqrt(np.mean((off / said) ** 2)):9.2f}{inside:9.0f}{refused:9}"
    )
    return rms


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="each is 20 s of motion capture at 100 Hz, for each row")
    seeds = parser.parse_args().seeds
    print(f"{'us':40}{'rms':>9}{'sigma':>9}{'rms/sig':>9}{'% in 2':>9}{'refused':>9}")
    good = True
    for lag_ms in (0, 10, 20, 30):
        good &= row(f"lag of {lag_ms} ms", seeds, mocap_lag_us=lag_ms * 1000.0) < RMS_US_MAX
    row("0.2 deg of noise", seeds, mocap_noise_deg=0.2)
    row("half of the poses lost", seeds, lost=0.5)
    row("poses up to 5 ms later yet", seeds, mocap_jitter_us=5000.0)
    row("a gyro with 3 deg/s of noise", seeds, gyro_noise_dps=3.0)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
