"""Robots whose clocks were set to 0 by one broadcast: what their logs say of it, and how far that can be trusted.

A robot notes no reset. Its log has one where its times begin anew near 0; or none, where logging began afterwards.
A packet that comes late sets a clock to 0 late, one that does not come leaves it as it was, and of a reset that is
broadcast several times each robot keeps the last one that it has heard. None of that shows in a single log: only what
all have heard tells how far apart their resets really were.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

START_US = 2_000_000
"""What begins later on its own clock was not set to 0."""
SPREAD_US = 1400.0
"""Two robots carry out the same packet within this of each other in 99 %, if each takes 300 us on average (nobody has
published what it really is; three real robots were within 0.2 ms)."""
DRIFT_PPM = 500.0
"""By which two crystals may differ; three real pairs did by 54 to 237."""
SAME_SPAN = 0.002
SAME_US = 1_000_000
"""Logs that tell of the same resets agree within these: robots begin to log at different times, and rows may be far
apart."""


@dataclass(frozen=True, slots=True)
class Reset:
    """One broadcast, as one log shows it."""

    epoch: int
    """That it began."""
    before_us: int
    """What the clock had counted to."""


def resets(spans_us: Sequence[tuple[int, int]]) -> list[Reset]:
    """Of one log. `spans_us`: first and last time of each of its epochs."""
    return [
        Reset(number, spans_us[number - 1][1])
        for number, (first, _) in enumerate(spans_us)
        if number and first < START_US
    ]


def missed(found: Sequence[Sequence[Reset]]) -> int | None:
    """The log that has not the resets that another one has."""
    most = max(found, key=len)
    for number, each in enumerate(found):
        if len(each) != len(most):
            return number
        # What comes before the first is the robot's own boot.
        for mine, other in zip(each[1:], most[1:], strict=True):
            if abs(mine.before_us - other.before_us) > SAME_SPAN * other.before_us + SAME_US:
                return number
    return None


def late(first_us: Sequence[int]) -> int | None:
    """Of logs that began soon after a reset, together: the one whose clock had counted on."""
    latest = max(range(len(first_us)), key=first_us.__getitem__)
    return latest if first_us[latest] - min(first_us) > SAME_US else None


def bound_us(after_s: float) -> float:
    """Of the difference of two robots' clocks, so long after a reset that both carried out."""
    return SPREAD_US + DRIFT_PPM * after_s


@dataclass(frozen=True, slots=True)
class Taken:
    """When one robot's clock was at 0, after that of the robot that was the first of all."""

    after_us: float
    bound_us: float
    """99 %."""
    repeat: int | None
    """Which of the repeats it kept, counted from the first robot's; None: not told, or between two."""

    @property
    def is_other(self) -> bool:
        """Too late to have come from the same packet."""
        return self.after_us - self.bound_us > SPREAD_US


def taken(zero_us: Sequence[float], bounds_us: Sequence[float], every_us: float | None) -> list[Taken]:
    """`zero_us`: when each robot's clock was at 0, on one clock; `every_us`: from repeat to repeat, if known."""
    first = min(range(len(zero_us)), key=zero_us.__getitem__)
    made = []
    for number, (zero, bound) in enumerate(zip(zero_us, bounds_us, strict=True)):
        after = zero - zero_us[first]
        both = 0.0 if number == first else (bound**2 + bounds_us[first] ** 2) ** 0.5
        nearest = round(after / every_us) if every_us else 0
        away = abs(after - nearest * every_us) if every_us else 0.0
        is_told = every_us and away + both < every_us / 2 and away <= SPREAD_US + both
        made.append(Taken(after, both, nearest if is_told else None))
    return made
