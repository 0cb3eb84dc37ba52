"""What the rule of the paper's firmware makes of its times, part by part: tests/sim/snapshots/paper_rule.txt.

The table is exact. When a change is meant to alter it: python tests/sim/test_snapshot_paper.py; say why in the commit.
"""

import difflib
import sys
from pathlib import Path

import numpy as np

from sim.world import World

TABLE = Path(__file__).parent / "snapshots" / "paper_rule.txt"
SECONDS = 60
SI = {"stm32_divider": 85}
ROWS = [
    ("as it is", {}),
    ("with a clock that is right (85)", SI),
    ("  and not floored", SI | {"paper_floor": "no"}),
    ("  and a tick of 1 us", SI | {"paper_floor": "no", "gap8_quantum": "1us"}),
    ("  and from the first byte", SI | {"paper_floor": "no", "gap8_quantum": "1us", "paper_arrival": "first"}),
    ("bursts of three", {"camera_burst": 3, "camera_fps": 4}),
    ("half of the messages lost", {"uart1_loss": 0.5}),
    ("silent for 1 s, half of the time", {"uart1_burst_per_s": 1, "uart1_burst_ms": 1000}),
    ("  with a clock that is right", SI | {"uart1_burst_per_s": 1, "uart1_burst_ms": 1000}),
    ("middle of exposure, middle row", {"paper_instant": "middle"}),
]
HEAD = f"""\
Stamp error of the scenario `paper`: frame_stm32_ms less truth at end of frame, us, over {SECONDS} s at seed 1.

                                      frames    mean      sd     p99.5   worst
"""


def row(name, settings):
    with World("paper", **settings, seed=1) as world:
        robot = world.listen(0, "paper")
        robot.run(SECONDS)
        errors = robot.stamp_errors_us
    worst = errors[np.argmax(np.abs(errors))]
    figures = [errors.mean(), errors.std(), np.percentile(errors, 99.5), worst]
    mean, sd, high, worst = (round(float(figure)) for figure in figures)
    return f"{name:36} {len(errors):7} {mean:7} {sd:7} {high:9} {worst:7}\n"


def table():
    return HEAD + "".join(row(*each) for each in ROWS)


def test_the_rule_of_the_paper():
    kept = TABLE.read_text(encoding="utf-8")
    found = table()
    difference = "".join(difflib.unified_diff(kept.splitlines(True), found.splitlines(True), "kept", "found"))
    assert not difference, f"\n{difference}\nIf that is meant: python {Path(__file__).name} writes it anew."


def test_the_readme_says_so():
    mean, sd = TABLE.read_text(encoding="utf-8").splitlines()[3].split()[4:6]
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    assert f"{-int(mean) / 1000:.1f} ms early, {int(sd) / 1000:.1f} ms sd (sim://paper)" in readme


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
    sys.stdout.write(TABLE.read_text(encoding="utf-8"))
