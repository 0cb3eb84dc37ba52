"""How well the clocks of two robots are known against each other, from beacons and from the paper's one reset.

    python benchmarks/robots.py [--seeds 20]

The host broadcasts (sequence, its time), each robot notes (sequence, its own time): crystals within 250 ppm that warm
up, 300 us of delay on average and 20 % loss on each robot by itself. Offline: the whole log. Online: what has come
until then, asked 0 to 1 s after the last beacon. The reset: both clocks set to 0 by one broadcast at the start, which
each robot carries out when it has come.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "clock"))

from radio_models import Radio, Robot, fleet  # type: ignore[import-not-found]

from host.clock.beacons import BEACONS_MIN, Against, Beacons, against_host, collect, recent

ONLINE_POINTS = 60
CASES = {
    "1 Hz, 30 min": Radio(),
    "1 Hz, 30 min, the clocks count 84 of 85": Radio(divider=84),
    "1 Hz, 30 min, the host 100 us late on average": Radio(host_mu_us=100.0),
    "1 Hz, 30 min, 60 % lost": Radio(loss=0.6),
    "1 Hz, 10 min": Radio(seconds=600.0),
    "1 Hz, 2 min": Radio(seconds=120.0),
    "10 Hz, 30 min": Radio(hz=10.0),
}
OFFLINE_US, ONLINE_US, COVERED = 20.0, 100.0, 98.5


def judged(pair: list[Robot], fits: list[Against | None], at_us: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error of the second clock against the first, and its bound."""
    found = [fit.at(at_us) for fit in fits if fit is not None]
    if len(found) < 2:
        raise SystemExit("too few beacons")
    truth = pair[1].clock(at_us) - pair[0].clock(at_us)
    return np.abs(found[1][0] - found[0][0] - truth), np.hypot(found[0][1], found[1][1])


def until(robot: Robot, host_us: float) -> Beacons:
    kept = robot.host_us < host_us - 20_000
    return recent(collect(robot.sequence[kept], robot.host_us[kept], robot.local_us[kept]))


def reset(pair: list[Robot], at_us: np.ndarray, random: np.random.Generator) -> np.ndarray:
    """Error when the clocks, both set to 0 when the broadcast came to each, are taken for the same."""
    came = [np.array([at_us[0] + random.exponential(300)]) for _ in pair]
    readings = [robot.clock(at_us) - robot.clock(when) for robot, when in zip(pair, came, strict=True)]
    away: np.ndarray = np.abs(readings[1] - readings[0])
    return away


def row(name: str, radio: Radio, seeds: int) -> tuple[float, float, float]:
    """p95 offline and online, and the lesser of their coverages, printed with the rest."""
    random = np.random.default_rng(1)
    offline, online, resets = [], [], []
    spent = 0.0
    for seed in range(seeds):
        pair = fleet(radio, seed)
        begin_us, end_us = pair[0].host_us[0], pair[0].host_us[0] + radio.seconds * 1e6
        at_us = np.linspace(begin_us + 2e6, end_us - 3e6, 2000)
        whole = [against_host(collect(each.sequence, each.host_us, each.local_us)) for each in pair]
        offline.append(judged(pair, whole, at_us))
        resets.append(reset(pair, at_us, random))
        enough_us = 1.4e6 * BEACONS_MIN / (radio.hz * (1 - radio.loss))
        for now_us in random.uniform(begin_us + enough_us, end_us, ONLINE_POINTS):
            started = time.process_time()
            now = [against_host(until(each, now_us)) for each in pair]
            spent += time.process_time() - started
            online.append(judged(pair, now, np.array([now_us])))
    results = [tuple(np.concatenate(part) for part in zip(*each, strict=True)) for each in (offline, online)]
    p95 = [float(np.quantile(error, 0.95)) for error, _ in results]
    covered = [float((error <= bound).mean() * 100) for error, bound in results]
    print(
        f"{name:48}{np.quantile(np.concatenate(resets), 0.95):10.0f}"
        + "".join(
            f"{each:10.1f}{error.max():8.0f}{np.median(bound):8.0f}{inside:8.2f}"
            for each, inside, (error, bound) in zip(p95, covered, results, strict=True)
        )
        + f"{spent / (seeds * ONLINE_POINTS * 2) * 1e3:9.1f}"
    )
    return p95[0], p95[1], min(covered)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="each is a pair of robots, for each row")
    seeds = parser.parse_args().seeds
    print(f"{'us, one robot against the other':48}{'one reset':>10}{'offline':>34}{'online':>34}{'':>9}")
    columns = f"{'p95':>10}{'max':>8}{'bound':>8}{'% in':>8}"
    print(f"{'':48}{'p95':>10}{columns}{columns}{'ms each':>9}")
    good = True
    for name, radio in CASES.items():
        offline, online, covered = row(name, radio, seeds)
        good &= covered >= COVERED
        if radio.hz == 1 and radio.seconds == 1800 and radio.loss < 0.5 and not radio.host_mu_us:
            good &= offline <= OFFLINE_US and online <= ONLINE_US
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
