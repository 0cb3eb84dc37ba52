"""How often host doctor is right: faults one by one, clean robots, slow stages, each with seeds of its own.

python benchmarks/doctor.py [--seeds 5]
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "sim"))

from doctor_cases import CLEAN, FAULTS, SLOW, VARIETY, listen  # type: ignore[import-not-found]

from host.link.diagnosis import Diagnosis, diagnose

SECONDS = 60.0
CLEAN_RUNS = 20


def named(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    return [(finding.stage, finding.cause) for finding in diagnosis.findings if finding.severity != "note"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="of each fault, a minute of a simulated robot")
    seeds = range(100, 100 + parser.parse_args().seeds)
    print(f"{'fault':28}{'where':10}{'found':>8}{'also blamed':>16}")
    always = 0
    for case in FAULTS:
        found = also = 0
        for seed in seeds:
            causes = named(diagnose(listen(case, seed, SECONDS)))
            found += any(stage == case.stage and cause in case.causes for stage, cause in causes)
            also += any(stage != case.stage for stage, _ in causes)
        always += found == len(seeds)
        print(f"{case.name:28}{case.stage:10}{found:5}/{len(seeds)}{also:16}")
    print(f"{always} of {len(FAULTS)} kinds always found")
    alarms = sum(
        bool(named(diagnose(listen(CLEAN, seed, SECONDS, **VARIETY[seed % len(VARIETY)]))))
        for seed in range(200, 200 + CLEAN_RUNS)
    )
    print(f"{alarms} alarms in {CLEAN_RUNS} minutes with clean robots")
    limits = 0
    for case in SLOW:
        diagnosis = diagnose(listen(case, 300, SECONDS))
        limits += diagnosis.bottleneck == case.stage
        print(f"slow {case.stage:8}{diagnosis.bottleneck:8}{diagnosis.rate}")
    return 0 if alarms == 0 and always >= len(FAULTS) * 11 / 12 and limits == len(SLOW) else 1


if __name__ == "__main__":
    sys.exit(main())
