"""What host doctor knows about time messages and clocks. Pure."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .finding import RARE, Finding
from .listening import Listening

OLD_DIVIDER_PPM = -1e6 / 85
"""crazyflie-firmware#1684: the STM32's clock counted 84 us in 85."""
DIVIDER_PPM = 1000
DRIFT_PPM = 500
"""Oscillators that are as they should be differ by 300 at most."""
LATE_US = 3000
"""Of a stamp message: the worst in twenty."""
SILENT_STAMPS_US = 500_000
STAMP_BYTES = 17


def time_wire(heard: Listening) -> Iterator[Finding]:
    """UART1."""
    numbered = heard.numbered
    grown = heard.gap8.grown
    tap = heard.framing == "stamps"
    received = heard.stamps if tap else grown["stamps_received"]
    missed = heard.stamps_missed if tap else grown["stamps_missed"]
    bad = heard.counters.bad_check + heard.garbage_bytes if tap else grown["stamps_bad"]
    bad = max(0, bad - STAMP_BYTES * (heard.stm32_restarts + heard.gap8_restarts))  # cut in the middle
    told = len(heard.frames) if heard.spoken in ("paper", "nanocockpit") else len(numbered)
    if not tap and told >= 2 and heard.never_stamped == told:
        todo = "Is the wire between the decks there? Does the STM32's firmware send time messages?"
        yield Finding("UART1", "problem", "no_stamps", "no time message has ever reached the GAP8", "", todo)
        return
    if missed + bad >= RARE and missed + bad >= 0.002 * received:
        todo = "Reseat the decks. A wire of its own next to motor wires? Keep it short, twisted with ground."
        evidence = f"{missed} of {missed + received} missing, {bad} bad ones or bytes of them"
        if bad >= missed / 2:
            yield Finding("UART1", "problem", "uart1_damage", "time messages are damaged", evidence, todo)
        else:
            yield Finding("UART1", "problem", "uart1_loss", "time messages are lost", evidence, todo)
    pauses = heard.no_stamp_us > SILENT_STAMPS_US and not heard.stm32_restarts
    if pauses:
        evidence = f"the longest pause was {heard.no_stamp_us / 1e6:.1f} s; there should be 100 a second"
        todo = "Does the STM32's task get its turn? Is the wire loose?"
        yield Finding("UART1", "problem", "uart1_pauses", "the time messages pause", evidence, todo)
    late = heard.pairs.late_us()
    if late is not None and not tap and not pauses:
        worst_us = float(np.percentile(late[1], 95))
        if worst_us > LATE_US:
            evidence = f"one in twenty is late by {worst_us / 1000:.1f} ms or more; frames' times are wrong by as much"
            todo = "Give the STM32's sending task a higher priority, and the GAP8's interrupt too."
            yield Finding("UART1", "warning", "uart1_late", "time messages are held up", evidence, todo)
    if grown["pairs_lost"]:
        todo = "Take frames more often: the GAP8 keeps 512 pairs."
        evidence = f"{grown['pairs_lost']} pairs"
        yield Finding("GAP8", "warning", "pairs_lost", "the GAP8 runs out of room for pairs", evidence, todo)


def clocks(heard: Listening) -> Iterator[Finding]:
    tap = heard.framing == "stamps"
    pairs, arrivals = heard.pairs.late_us(), heard.arrivals.late_us()
    other = "the host's" if tap else "the GAP8's"
    stm32_ppm = None if pairs is None else -pairs[0] / (1 + pairs[0] / 1e6)
    gap8_ppm = None if arrivals is None else -arrivals[0] / (1 + arrivals[0] / 1e6)
    old = stm32_ppm is not None and abs(stm32_ppm - OLD_DIVIDER_PPM) < DIVIDER_PPM
    if stm32_ppm is not None and old:
        evidence = f"it runs {stm32_ppm:+.0f} ppm against {other} clock; 84/85 is {OLD_DIVIDER_PPM:+.0f} ppm"
        todo = "Update crazyflie-firmware to August 2026 or later (#1684), or divide its times by 84/85."
        yield Finding("clock", "problem", "clock_84_85", "the STM32 counts 84 us in 85", evidence, todo)
    elif gap8_ppm is not None and abs(gap8_ppm) > DRIFT_PPM and abs(stm32_ppm or gap8_ppm) > DRIFT_PPM:
        evidence = f"it runs {gap8_ppm:+.0f} ppm against this computer's"
        todo = "Its oscillator is damaged, or its firmware counts another clock than it believes. Use the pairs."
        yield Finding("clock", "warning", "gap8_drift", "the GAP8's clock is off", evidence, todo)
    elif stm32_ppm is not None and abs(stm32_ppm) > DRIFT_PPM:
        evidence = f"it runs {stm32_ppm:+.0f} ppm against {other}"
        todo = "Its oscillator is damaged, or its firmware counts another clock than it believes. Use the pairs."
        yield Finding("clock", "warning", "stm32_drift", "the STM32's clock is off", evidence, todo)
    steps = heard.gap8_steps
    if steps.total() >= 20 and len(steps) == 1:
        todo = "Frames cannot be timed better than that. Use the microsecond timer in its firmware."
        evidence = f"its {steps.total()} readings are whole milliseconds apart"
        yield Finding("clock", "warning", "gap8_coarse", "the GAP8's clock counts milliseconds", evidence, todo)
