"""Real images give what the model gives: every byte on every wire, at the same local time.

Every scenario, with clocks that are right and that are wrong, undisturbed and under random faults (sim/faults.py):
30 simulated seconds each; SPINDECK_EMULATED_S=600 makes them as long. To be quick, only the undisturbed runs without
drift have the scenario's own pictures and robots: in the others pictures are small, and two robots fly at most.
"""

import os
import sys

import pytest
from backend import needs
from equal import Case, difference, drawn

from sim import scenario

SECONDS = float(os.environ.get("SPINDECK_EMULATED_S", "30"))
DRIFTS_PPM = [-20_000, -50, 0, 50, 2000]
NATIVE = {"backend": "native"}
EMULATED = {"backend": "emulated"}
SCHEDULES = int(os.environ.get("SPINDECK_EMULATED_SCHEDULES", "60"))
SCHEDULE_S = 4.0
BATCH = 10
SMALL = {"camera_width": 64, "camera_height": 48}


def case(name: str, drift_ppm: int, faults: bool) -> Case:
    """Without faults the STM32 and the GAP8 are wrong alike, so that the wires still fit; with faults they differ."""
    settings = {"stm32_ppm": drift_ppm, "gap8_ppm": -drift_ppm if faults else drift_ppm}
    if drift_ppm or faults:
        settings |= SMALL
        settings["robots"] = min(2, len(scenario.load(name).robots))
    return Case(f"{name}-{drift_ppm:+}-{'faults' if faults else 'clean'}", name, settings, faults)


CASES = [case(name, drift, faults) for name in scenario.names() for drift in DRIFTS_PPM for faults in (False, True)]

STEPS = {"gap8_step_ppm": -2000, "gap8_step_s": 3, "stm32_step_ppm": 50, "stm32_step_s": 5}
CASES.append(Case("hover-steps-clean", "hover", SMALL | STEPS, False))


def again(test: str) -> str:
    longer = f"SPINDECK_EMULATED_S={SECONDS:g} " if "SPINDECK_EMULATED_S" in os.environ else ""
    return f"\nagain: {longer}python -m pytest 'tests/emulator/test_equal.py::{test}'"


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_equal(case: Case) -> None:
    needs()
    found = difference(case, SECONDS, NATIVE, EMULATED)
    assert found is None, found + again(f"test_equal[{case.name}]")


@pytest.mark.parametrize("first", range(0, SCHEDULES, BATCH))
def test_schedules(first: int) -> None:
    """Scenario, clocks, wires, camera and host at random; reboots, stamp clocks set, stalls, injected bytes."""
    needs()
    for seed in range(first, min(first + BATCH, SCHEDULES)):
        found = difference(drawn(seed), SCHEDULE_S, NATIVE, EMULATED)
        assert found is None, f"{found}\nagain: python tests/emulator/test_equal.py {seed}"


@pytest.mark.parametrize("name", scenario.names())
def test_both_compilers_images_give_the_same(name: str) -> None:
    """Not compared with the native app: an image of its own sends the same bytes at the same time."""
    needs("gcc", "zig")
    found = difference(
        case(name, 50, True), SECONDS / 3, EMULATED | {"toolchain": "gcc"}, EMULATED | {"toolchain": "zig"}
    )
    assert found is None, found + again(f"test_both_compilers_images_give_the_same[{name}]")


if __name__ == "__main__":
    for seed in map(int, sys.argv[1:]):
        print(difference(drawn(seed), SCHEDULE_S, NATIVE, EMULATED) or f"{drawn(seed)}: equal")
