"""The best test that knows a fault: when it says so, by hand, and how often it does so without one."""

import math

import numpy as np
import oracle
import pytest
from models import Link, run

LINK = Link("typ", 500, 60)


def test_a_rate_that_rises_is_known_when_the_sum_of_what_messages_are_late_is_enough() -> None:
    link = Link("typ", 500, 60, rate_step_ppm=50)
    made = run(link, 1)
    since_s = (oracle.revealed_us(made, oracle.of_rate_step(made, link), 500, 1e-3) - 30e6) * 1e-6
    # 0.5 us more each message of 10 ms: the k-th makes it 0.5 k (k + 1) / 2.
    assert since_s == pytest.approx(0.01 * math.sqrt(2 * math.log(1000) * 500 / 0.5), abs=0.02)


def test_one_impossible_message_is_enough_and_late_ones_add_up() -> None:
    made = run(LINK, 1)
    assert oracle.revealed_us(made, oracle.of_leap(made, 300, 100_000), 500, 1e-3) == made.come_us[300]
    assert oracle.revealed_us(made, oracle.of_leap(made, 300, -3_000), 500, 1e-3) == made.come_us[301], "e^-6, e^-12"
    assert oracle.revealed_us(made, np.zeros(6000), 500, 1e-3) == math.inf


def test_false_alarms_are_as_few_as_it_says() -> None:
    """Asked about a step that there is not."""
    asked = Link("typ", 500, 60, rate_step_ppm=50)
    alpha = 0.05
    alarms = 0
    for seed in range(40):
        made = run(LINK, seed)
        late_us = oracle.of_rate_step(made, asked)
        at_once = made.come_us - made.sent_us - late_us  # so that the delays are those without it
        shifted = type(made)(**{**vars(made), "come_us": made.sent_us + at_once})
        alarms += oracle.revealed_us(shifted, late_us, 500, alpha) < math.inf
    assert alarms <= 40 * alpha + 4
