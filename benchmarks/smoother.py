"""How good the times are that the host works out afterwards from all messages: against the truth, and how fast.

python benchmarks/smoother.py [--seeds 6]
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "clock"))

from models import OSCILLATORS, RTC_US, Link, Run, run  # type: ignore[import-not-found]

from host.clock.frame_ends import Readings
from host.clock.smoother import smooth
from host.clock.stamps import stamp

MANY = 10_000_000
EDGE_S = 15


def errors(link: Link, seeds: range) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Of all frames of all seeds: error, bound, whether far from the ends; and how many were refused. Where ticks are
    coarse it is known that frames are of one pace, as it is of native recordings."""
    error, bound, inner, refused = [], [], [], 0
    for seed in seeds:
        made: Run = run(link, seed)
        stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
        count = len(frames)
        paced = Readings(np.arange(count), np.zeros(count, np.int64), np.zeros(count))
        got = stamp(stm32, gap8, frames, made.frame_after, readings=paced if link.gap8_tick_us > 100 else None)
        error.append(got.stm32_us - made.frame_true_us[got.frame])
        bound.append(got.bound_us)
        at_s = made.frame_us[got.frame] * 1e-6
        inner.append((at_s > EDGE_S) & (at_s < link.seconds - EDGE_S))
        refused += len(got.refused)
    return np.concatenate(error), np.concatenate(bound), np.concatenate(inner), refused


def row(name: str, link: Link, seeds: range) -> tuple[float, float, float]:
    """rms, p95 and coverage, printed with the rest."""
    error, bound, inner, refused = errors(link, seeds)
    size = np.abs(error)
    rms, p95 = float(np.sqrt(np.mean(error[inner] ** 2))), float(np.quantile(size, 0.95))
    covered = float((size <= bound).mean() * 100)
    print(
        f"{name:34}{rms:9.2f}{np.median(size):9.2f}{p95:9.2f}{size.max():9.1f}{np.median(bound):9.2f}"
        f"{covered:9.2f}{refused:9}"
    )
    return rms, p95, covered


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6, help="each is 300 s of 100 messages a second and 30 frames")
    seeds = range(parser.parse_args().seeds)
    print(f"{'us':34}{'rms':>9}{'median':>9}{'p95':>9}{'max':>9}{'bound':>9}{'% in it':>9}{'refused':>9}")
    good = True
    for mu_us in (50.0, 200.0, 500.0, 2000.0):
        limit = 1.5 * float(np.hypot(1.35 * mu_us / 3000, 0.5))
        rms, _, covered = row(f"constant skew, mu {mu_us:g} (rms {limit:.2f})", Link("const100", mu_us), seeds)
        good &= rms <= limit and covered >= 98.5
    for oscillator in OSCILLATORS:
        _, p95, covered = row(f"{oscillator}, mu 500 (p95 5)", Link(oscillator, 500.0), seeds)
        good &= p95 <= 5 and covered >= 98.5
    for name, link in {
        "rcbad, mu 2000": Link("rcbad", 2000.0),
        "typ, half lost, 0.3 s bursts": Link("typ", 500.0, loss=0.5, burst_s=0.3),
        "presc85, half lost, 2 s bursts": Link("presc85", 500.0, loss=0.5, burst_s=2.0),
        "typ, 2 % late by 5 to 50 ms": Link("typ", 500.0, late=0.02),
        "typ, ticks of 30.5 us": Link("typ", 500.0, gap8_tick_us=RTC_US),
        "presc85, ticks of 1 ms": Link("presc85", 500.0, gap8_tick_us=1000.0),
        "typ, ticks of 1 ms": Link("typ", 500.0, gap8_tick_us=1000.0),
    }.items():
        good &= row(name, link, seeds)[2] >= 98.5
    made = run(Link("typ", 500.0, seconds=MANY / 100, fps=0.01), 1)
    started = time.process_time()
    stm32, gap8, frames = (each.astype(np.uint64) for each in (made.stm32_us, made.gap8_us, made.frame_gap8_us))
    got = stamp(stm32, gap8, frames, made.frame_after)
    all_s = time.process_time() - started
    started = time.process_time()
    smooth((made.gap8_us - made.gap8_us[0]) * 1e-6, (made.gap8_us - made.stm32_us).astype(np.float64), 1.0)
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"{MANY:,} messages: {all_s:.1f} s of one core, of which the smoother {time.process_time() - started:.1f} s;"
        f" {len(got.frame)} frames; peak {peak_mb:.0f} MB"
    )
    return 0 if good and all_s <= 10 else 1


if __name__ == "__main__":
    sys.exit(main())
