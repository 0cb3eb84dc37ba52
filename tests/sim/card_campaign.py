"""Power cuts of recorded flights, one after the other, and what was found after each."""

import functools
import shutil
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from card_flights import CONFIG, FAST_CONFIG, Flight, model_flight, robot_flight
from card_judge import Found, Image, flies_again, fsck, judge, mended, same_as_others
from card_model import Rate

from sim.card_cuts import Cuts

RATES = {"mocap": Rate(), "fast": Rate(hz=1000, floats=20, poses_hz=50)}
CONFIGS = {"stm32": CONFIG, "stm32fast": FAST_CONFIG}
LOGGERS = ["stm32", *RATES]
"""The firmware's, and the model of one with these rows."""
STALLS = {"": {}, "prompt": {"stall_ms": 0.0}, "slow": {"stall_ms": 10.0, "stall_p99_ms": 250.0}}
SHORT = [f"{logger}-{size_mb}-20-1" for logger in LOGGERS for size_mb in (128, 4096)]
LONG = [
    "stm32-128-{}-1",
    "stm32-1024-{}-2-slow",
    "stm32-8192-{}-3",
    "stm32fast-1024-{}-4-prompt",
    "stm32fast-4096-{}-5",
    "stm32fast-8192-{}-6-slow",
    "mocap-1024-{}-7-slow",
    "mocap-8192-{}-8",
    "fast-1024-{}-9",
    "fast-8192-{}-10-slow",
]
"""Of so many seconds."""
EDGE = 16
"""The first and the last writes of a flight, in which directory and FAT change."""


@dataclass
class Result:
    found: list[Found] = field(default_factory=list)
    ages_ms: list[float] = field(default_factory=list)
    """Of the last verified row when the power went, where there is one."""
    failures: list[str] = field(default_factory=list)


@functools.lru_cache(maxsize=1)
def flight_of(name: str) -> Flight:
    """LOGGER-CARD_MB-SECONDS-SEED[-STALLS]"""
    logger, size_mb, seconds, seed, *more = name.split("-")
    stalls = STALLS["".join(more)]
    if logger in CONFIGS:
        return robot_flight(int(size_mb), float(seconds), int(seed), CONFIGS[logger], stalls)
    return model_flight(int(size_mb), float(seconds), int(seed), RATES[logger], stalls)


def run(name: str, counts: list[int], damaged: bool, folder: Path, others: int = 10) -> Result:
    """Cuts after so many writes each, in rising order; of every `others`-th one more is looked at."""
    flight = flight_of(name)
    image, cuts = Image(flight, folder / "partition"), Cuts(flight.recording)
    result = Result()
    for number, count in enumerate(counts):
        image.put(cuts.after(count))
        sectors, fates = cuts.damaged(np.random.default_rng([count, 7])) if damaged else ({}, [])
        image.put(sectors)
        try:
            if shutil.which("fsck.fat"):
                fsck(image.path)
            certain = count - 1 if fates else count
            found = judge(image, flight, certain)
            result.found.append(found)
            if found.newest_us:
                result.ages_ms.append((flight.end_us(count) - found.newest_us) / 1000)
            if number % others == 0:
                same_as_others(image)
                if shutil.which("fsck.fat"):
                    mended(image, flight, certain)
            if number % others == 0 or count < EDGE:
                flies_again(image, flight, flight.recording.base | cuts.now | sectors, certain)
        except AssertionError as error:
            again = f"python tests/sim/test_card_cuts.py {name} {count}{' damaged' * damaged}"
            result.failures.append(f"{error}\n  last writes: {fates}\n  again: {again}")
        image.put(cuts.restored(sectors))
    return result


def every_write(name: str) -> list[int]:
    return list(range(len(flight_of(name).recording.writes) + 1))


def some_writes(name: str, between: int) -> list[int]:
    """The edges, and so many in between."""
    counts = every_write(name)
    chosen = np.random.default_rng(1).choice(counts[EDGE:-EDGE], between, replace=False)
    return [*counts[:EDGE], *sorted(chosen.tolist()), *counts[-EDGE:]]


def random_writes(name: str, count: int) -> list[int]:
    return sorted(np.random.default_rng(2).choice(every_write(name), count, replace=False).tolist())
