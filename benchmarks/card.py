"""Power cuts of logs on the virtual card: how many, what they cost, and that nothing was lost which a sync had covered.

python benchmarks/card.py [CUTS]     (default 200 of each flight; `all`: every sector write)
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "sim"))

from card_campaign import LOGGERS, every_write, random_writes, run  # type: ignore[import-not-found]

FLIGHTS = [f"{logger}-{size_mb}-20-1" for logger in LOGGERS for size_mb in (128, 4096)]


def main() -> int:
    wanted = sys.argv[1] if len(sys.argv) > 1 else "200"
    print(f"{'flight':30}{'writes':>8}{'cuts':>7}{'failed':>8}{'rows recovered beyond the sync':>32}{'ms a cut':>10}")
    failures: list[str] = []
    for name in FLIGHTS:
        for damaged in (False, True):
            writes = len(every_write(name)) - 1
            cuts = every_write(name) if wanted == "all" else random_writes(name, min(int(wanted), writes))
            with tempfile.TemporaryDirectory() as folder:
                begin = time.perf_counter()
                result = run(name, cuts, damaged, Path(folder), others=50)
                took_ms = (time.perf_counter() - begin) * 1000 / len(cuts)
            beyond = sum(each.returned - each.promised for each in result.found) / max(len(result.found), 1)
            shown = f"{name} {'damaged' if damaged else 'plain'}"
            print(f"{shown:30}{writes:8}{len(cuts):7}{len(result.failures):8}{beyond:26.0f} bytes{took_ms:10.1f}")
            failures += result.failures
    print(*failures, sep="\n")
    return bool(failures)


if __name__ == "__main__":
    sys.exit(main())
