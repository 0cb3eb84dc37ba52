"""Power cuts of logs on the virtual card: how many, what they cost, and that nothing was lost which a sync had covered.

Without --minutes: logs of 20 s, whole and with the last writes torn, lost or out of order. With it: ten different logs
of so many minutes, damaged. A row's age is from its stamp to the last moment before the next write.

    python benchmarks/card.py [--cuts 200 of each flight | --cuts all: after every sector write]
    python benchmarks/card.py --minutes 10 --cuts 2000      (in all)
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "sim"))

import numpy as np
from card_campaign import (  # type: ignore[import-not-found]
    LONG,
    SHORT,
    every_write,
    flight_of,
    random_writes,
    run,
)


def measured(name: str, cuts: list[int], damaged: bool) -> tuple[dict[str, object], list[str]]:
    """One flight's figures, and its failures."""
    flight = flight_of(name)
    with tempfile.TemporaryDirectory() as folder:
        begin = time.perf_counter()
        result = run(name, cuts, damaged, Path(folder), others=50)
        took_ms = (time.perf_counter() - begin) * 1000 / len(cuts)
    ages_ms = result.ages_ms or [0.0]
    figures = {
        "flight": name,
        "damaged": damaged,
        "log_bytes": sum(len(file.content) for file in flight.files.values()),
        "writes": len(every_write(name)) - 1,
        "cuts": len(cuts),
        "failed": len(result.failures),
        "age_ms_median": round(float(np.median(ages_ms)), 1),
        "age_ms_p99": round(float(np.quantile(ages_ms, 0.99)), 1),
        "age_ms_max": round(max(ages_ms), 1),
        "ms_a_cut": round(took_ms, 1),
    }
    return figures, result.failures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float)
    parser.add_argument("--cuts", default="200")
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    flights: list[tuple[str, bool, int | None]]
    if arguments.minutes:
        names = [each.format(round(arguments.minutes * 60)) for each in LONG]
        flights = [(name, True, -(-int(arguments.cuts) // len(names))) for name in names]
    else:
        most = None if arguments.cuts == "all" else int(arguments.cuts)
        flights = [(name, damaged, most) for name in SHORT for damaged in (False, True)]
    failures: list[str] = []
    if not arguments.json:
        head = f"{'flight':36}{'MB':>6}{'writes':>8}{'cuts':>6}{'failed':>7}"
        print(f"{head}  last verified row, ms old: median, 99 %, most")
    for name, damaged, count in flights:
        cuts = every_write(name) if count is None else random_writes(name, min(count, len(every_write(name))))
        figures, failed = measured(name, cuts, damaged)
        failures += failed
        if arguments.json:
            print(json.dumps(figures), flush=True)
            continue
        shown = f"{name} {'damaged' if damaged else 'plain'}"
        ages = f"{figures['age_ms_median']:>9} {figures['age_ms_p99']:>9} {figures['age_ms_max']:>9}"
        size_mb = figures["log_bytes"] / 1e6  # type: ignore[operator]
        print(f"{shown:36}{size_mb:6.1f}{figures['writes']:8}{len(cuts):6}{len(failed):7}{ages}", flush=True)
    print(*failures, sep="\n", file=sys.stderr)
    return bool(failures)


if __name__ == "__main__":
    sys.exit(main())
