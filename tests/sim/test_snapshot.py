"""What drift and loss do to time stamps, as a table that people can read: tests/sim/snapshots/drift_loss.txt.

The table is exact. When a change is meant to alter it: python tests/sim/test_snapshot.py, and say why in the commit.
"""

import difflib
import sys
from pathlib import Path

import numpy as np

from sim.world import World

TABLE = Path(__file__).parent / "snapshots" / "drift_loss.txt"
DRIFTS_PPM = [-20000, -100, 0, 100, 20000]
LOSSES = [0, 0.2, 0.5]
SECONDS = 10
HEAD = """\
Stamp error of the built-in robot: estimate less truth at end of frame, us, over {seconds} s of hover at seed 1.
Rows: rate error of the GAP8 and loss on UART1. The first frames are in it too.

   drift ppm   loss   frames    mean      sd     p95   |worst|   stamps: sent  missed   frames lost
"""


def row(drift_ppm, loss):
    with World("hover", gap8_ppm=drift_ppm, uart1_loss=loss, seed=1) as world:
        robot = world.listen()
        robot.run(SECONDS)
        errors = robot.stamp_errors_us
        lost = sum(robot.counters.frames_lost.values())
        figures = [errors.mean(), errors.std(), np.percentile(errors, 95), np.abs(errors).max()]
        mean, sd, p95, worst = (round(float(figure)) for figure in figures)
        sent, missed = robot.stm32["stamps_sent"], robot.gap8["stamps_missed"]
    return f"{drift_ppm:12} {loss:6} {len(errors):8} {mean:7} {sd:7} {p95:7} {worst:9} {sent:14} {missed:7} {lost:13}\n"


def table():
    return HEAD.format(seconds=SECONDS) + "".join(row(drift, loss) for drift in DRIFTS_PPM for loss in LOSSES)


def test_drift_and_loss():
    kept = TABLE.read_text(encoding="utf-8")
    found = table()
    difference = "".join(difflib.unified_diff(kept.splitlines(True), found.splitlines(True), "kept", "found"))
    assert not difference, f"\n{difference}\nIf that is meant: python {Path(__file__).name} writes it anew."


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
    sys.stdout.write(TABLE.read_text(encoding="utf-8"))
