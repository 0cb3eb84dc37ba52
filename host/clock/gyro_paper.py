"""The shift between two robots' clocks as the dataset paper worked it out (arXiv 2303.03898, III-B.3).

"We compute the optimal temporal offset that minimizes the error between the gyroscope sequences in four cases": one
offset for each case, no skew, no gain, logs as they are, and the mean and scatter of the cases. What a case was it does
not say; here the log's four quarters are the cases, offsets go by 0.1 ms, and lines connect the samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from .gyro_signal import Samples

CASES = 4
STEP_US = 100.0
REACH_US = 20e3
"""About the shift that is known already."""
ROWS_MIN = 200


@dataclass(frozen=True, slots=True)
class PaperShift:
    cases_us: tuple[float, ...]
    mean_us: float
    sd_us: float


def paper_shift(first: Samples, second: Samples, near_us: float) -> PaperShift | None:
    """None where the logs have too little in common."""
    begin = max(first.time_us[0], second.time_us[0] - near_us + REACH_US)
    end = min(first.time_us[-1], second.time_us[-1] - near_us - REACH_US)
    edges = np.linspace(begin, end, CASES + 1)
    shifts = np.round(near_us / STEP_US) * STEP_US + np.arange(-REACH_US, REACH_US + 1, STEP_US)
    cases = []
    for low, high in pairwise(edges.tolist()):
        here = slice(*np.searchsorted(first.time_us, [low, high]))
        at_us, own = first.time_us[here], first.value[here]
        if len(at_us) < ROWS_MIN:
            return None
        errors = [float(np.mean((own - np.interp(at_us + each, second.time_us, second.value)) ** 2)) for each in shifts]
        cases.append(float(shifts[int(np.argmin(errors))]))
    return PaperShift(tuple(cases), float(np.mean(cases)), float(np.std(cases, ddof=1)))
