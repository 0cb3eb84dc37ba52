"""Times of frames on the GAP8: the tracker of firmware/core/clock.h beside the paper's rule, on simulated clocks.

100 messages a second, their delays exponential with the mean `mu` over a fixed floor; 30 frames a second where nothing
else is said. Errors are of all frames with a time after 20 s; coverage, bound and flags of those after the first
second. The paper's rule is idealised: the last stamp, and what has passed since, with the fixed delay removed and
clocks of 1 us.

    python benchmarks/clock.py [--seconds 120] [--seeds 3] [--json]
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests/clock"))

import numpy as np
from models import RTC_US, Link, Run, run  # type: ignore[import-not-found]
from track import tracked  # type: ignore[import-not-found]

CASES: dict[str, dict[str, Any]] = {
    **{f"constant skew, mu {mu} us": {"oscillator": "const100", "mu_us": mu} for mu in (50, 200, 500, 2000)},
    "constant -20000 ppm, mu 500 us": {"oscillator": "const-20000"},
    "typical, mu 500 us": {"oscillator": "typ"},
    "typical, mu 2000 us": {"oscillator": "typ", "mu_us": 2000},
    "84/85, mu 500 us": {"oscillator": "presc85"},
    "5000 ppm, warming up, mu 500 us": {"oscillator": "fll5000"},
    "RC-like, mu 500 us": {"oscillator": "rcbad"},
    "84/85, half lost in bursts of 2 s": {"oscillator": "presc85", "loss": 0.5, "burst_s": 2},
    "typical, 2 % 5 to 50 ms late": {"oscillator": "typ", "late": 0.02},
    "typical, ticks of 30.5 us": {"oscillator": "typ", "gap8_tick_us": RTC_US},
    "84/85, ticks of 1 ms": {"oscillator": "presc85", "gap8_tick_us": 1000},
    "typical, ticks of 1 ms": {"oscillator": "typ", "gap8_tick_us": 1000},
    "84/85, ticks of 1 ms, 50 fps": {"oscillator": "presc85", "gap8_tick_us": 1000, "fps": 50},
    "typical, ticks of 1 ms, 50 fps": {"oscillator": "typ", "gap8_tick_us": 1000, "fps": 50},
}


def paper_errors_us(made: Run) -> Any:
    last = np.searchsorted(made.gap8_us, made.frame_gap8_us, side="right") - 1
    here = last >= 0
    stamped = made.stm32_us[last] + made.frame_gap8_us - made.gap8_us[last]
    return (stamped - made.frame_true_us)[here & (made.frame_gap8_us - made.frame_gap8_us[0] > 20e6)]


def figures(link: Link, seeds: int) -> dict[str, float]:
    ours, paper, covered, bounds, flagged = [], [], [], [], []
    for seed in range(seeds):
        made = run(link, seed)
        found = tracked(made, link.gap8_tick_us)
        later = found.at_s > 1
        ours.append(found.error_us[(found.at_s > 20) & found.given])
        paper.append(paper_errors_us(made))
        covered.append(found.covered[later & found.given])
        bounds.append(found.times["bound_us"][later & found.given])
        flagged.append(found.flagged[later])
    error, theirs = np.concatenate(ours), np.abs(np.concatenate(paper))
    return {
        "rms_us": float(np.sqrt((error**2).mean())),
        "p95_us": float(np.percentile(np.abs(error), 95)),
        "worst_us": float(np.abs(error).max()),
        "paper_p95_us": float(np.percentile(theirs, 95)),
        "covered_percent": 100 * float(np.concatenate(covered).mean()),
        "bound_us": float(np.median(np.concatenate(bounds))),
        "flagged_percent": 100 * float(np.concatenate(flagged).mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=120, help="length of each run, more than 20")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if options.seconds <= 20 or options.seeds < 1:
        parser.error("--seconds must be more than 20, --seeds at least 1")
    rows = {name: figures(Link(**{"seconds": options.seconds, **case}), options.seeds) for name, case in CASES.items()}
    if options.json:
        print(json.dumps(rows))
        return
    print(f"{'online, us':36}{'rms':>8}{'p95':>8}{'worst':>8}{'paper p95':>11}{'covered':>9}{'bound':>7}{'flagged':>9}")
    for name, row in rows.items():
        print(
            f"{name:36}{row['rms_us']:8.2f}{row['p95_us']:8.1f}{row['worst_us']:8.0f}{row['paper_p95_us']:11.0f}"
            f"{row['covered_percent']:8.2f}%{row['bound_us']:7.0f}{row['flagged_percent']:8.2f}%"
        )


if __name__ == "__main__":
    main()
