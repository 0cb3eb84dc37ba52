"""Robots that hear one host's broadcasts: clocks, delays, losses, repeats. What host.clock.beacons is tried on.

The host's clock is the reference. A robot's runs at (1 + rate): a crystal's error, warming up by 2 ppm, and a random
walk of 1e-9 per root second. A beacon is late by the host (the same for all robots), by a floor of each robot's and by
an exponential delay of each robot's own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
STEP_S = 0.1


@dataclass(frozen=True)
class Radio:
    seconds: float = 1800.0
    hz: float = 1.0
    ppm: float = 250.0
    """Crystals are within so much of the host's, either way."""
    mu_us: float = 300.0
    """Mean delay of each robot's own."""
    host_mu_us: float = 0.0
    """Mean delay of the host's, before it sends."""
    loss: float = 0.2
    repeats: int = 1
    """Times that each beacon is sent, 1 ms apart, as it is."""
    divider: int = 85
    """84: the robots' clocks count 84 where 85 have passed."""


@dataclass(frozen=True)
class Robot:
    """What it noted, and beside it the truth."""

    sequence: NDArray[np.int64]
    host_us: NDArray[np.int64]
    local_us: NDArray[np.int64]
    clock: Callable[[Floats], Floats]
    """Its reading at a time of the host's."""


def fleet(radio: Radio, seed: int, robots: int = 2) -> list[Robot]:
    random = np.random.default_rng(seed)
    host_us = np.floor(np.arange(0, radio.seconds * 1e6, 1e6 / radio.hz) + 1e9)
    sent_us = host_us + random.exponential(1, len(host_us)) * radio.host_mu_us
    return [robot(radio, host_us, sent_us, random) for _ in range(robots)]


def robot(radio: Radio, host_us: Floats, sent_us: Floats, random: np.random.Generator) -> Robot:
    clock = crystal(radio, host_us[0], random)
    sequence, heard, came = [], [], []
    for each in range(radio.repeats):
        here = random.random(len(sent_us)) >= radio.loss
        sequence.append(np.flatnonzero(here))
        heard.append(host_us[here])
        came.append((sent_us + 1000.0 * each + random.exponential(1, len(sent_us)) * radio.mu_us)[here])
    order = np.argsort(np.concatenate(came), kind="stable")
    local_us = np.floor(clock(np.concatenate(came)))
    columns = (np.concatenate(sequence), np.concatenate(heard), local_us)
    return Robot(*(column[order].astype(np.int64) for column in columns), clock)


def crystal(radio: Radio, start_us: float, random: np.random.Generator) -> Callable[[Floats], Floats]:
    at_s = np.arange(0, radio.seconds + 10, STEP_S)
    walk = np.cumsum(random.normal(0, 1e-3, len(at_s))) * np.sqrt(STEP_S)
    rate = random.uniform(-radio.ppm, radio.ppm) + 2 * (1 - np.exp(-at_s / 60)) + walk
    ahead_us = np.concatenate(([0.0], np.cumsum((rate[1:] + rate[:-1]) / 2 * STEP_S)))
    first_us = random.uniform(1e6, 1e8)

    def read(host_us: Floats) -> Floats:
        since = host_us - start_us
        return first_us + (since + np.interp(since * 1e-6, at_s, ahead_us)) * radio.divider / 85

    return read
