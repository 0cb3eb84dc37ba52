"""When messages first tell of a fault: the message at which the best possible test says so.

It knows the clock before the fault exactly, the mean delay mu, and of the fault its kind, its size and when it began.
So no tracker, which knows none of these, can be sooner with as few false alarms. A fault that makes the i-th message
late by s_i (early: s_i < 0) turns the density of its delay d from exp(-d / mu) to exp(-(d - s_i) / mu): each message
adds s_i / mu to the logarithm of the likelihoods' ratio, and one that comes before it could, without the fault, adds
infinity, with it takes infinity away. The fault is revealed when that sum is ln(1 / alpha) for the first time;
without one it ever gets there with a probability of at most alpha (Ville's inequality).
"""

from __future__ import annotations

import math

import numpy as np
from models import Floats, Link, Run

READING_US = 1.0
"""Two clocks that are read in whole us say of no message that it is early by less."""


def of_leap(run: Run, at: int, by_us: float) -> Floats:
    """By how much messages are late if the STM32's clock leaps from message `at` on."""
    return np.where(np.arange(len(run.sent_us)) >= at, -by_us, 0.0)


def of_rate_step(run: Run, link: Link) -> Floats:
    """If the GAP8's rate steps in the middle of the run."""
    return link.rate_step_ppm * np.maximum(run.sent_us * 1e-6 - link.seconds / 2, 0.0)


def revealed_us(run: Run, late_us: Floats, mu_us: float, alpha: float) -> float:
    """When the message comes that reveals it, on the clock of `come_us`; infinite: none does."""
    delay_us = run.come_us - run.sent_us + late_us
    gain = np.where(delay_us < -READING_US, math.inf, late_us / mu_us)
    gain = np.where(delay_us < late_us - READING_US, -math.inf, gain)
    sum_ = np.cumsum(np.where(late_us == 0, 0.0, gain))
    told = np.flatnonzero(sum_ >= math.log(1 / alpha))
    return float(run.come_us[told[0]]) if len(told) else math.inf
