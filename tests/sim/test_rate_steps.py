"""An oscillator whose rate steps in flight, end to end: the GAP8's times of frames, and those from the recording.

tests/clock has the tracker and the smoother alone, against the best test that knows of the step.
"""

from __future__ import annotations

import numpy as np
import pytest
from restamped import restamped

from sim.receiver import Receiver
from sim.world import World

STEP_S, SECONDS = 12.0, 24.0
SMALL = {"camera_width": 32, "camera_height": 24, "camera_fps": 30, "uart1_jitter_us": 500}
SEEN = {"HAS_ESTIMATE", "HAS_BOUND"}


def flown(mcu: str, ppm: float) -> tuple[Receiver, np.ndarray]:
    """After it; and each frame's end on the STM32's clock."""
    keys = {f"{mcu}_step_ppm": ppm, f"{mcu}_step_s": STEP_S, "stm32_divider": 84, "seed": 3}
    with World("hover", **SMALL, **keys) as world:  # type: ignore[arg-type]
        robot = world.listen(0, "native")
        world.run(SECONDS)
        ends_us = {int(each["frame"]): each["stm32_stamp_ns"] / 1000 for each in robot.truth}
        return robot, np.array([ends_us[frame.native.frame] for frame in robot.frames if frame.native])


# Of the GAP8's rate against the STM32's; a step makes messages late if that rises. `late`: frames that are wrong until
# messages tell, about as many as tests/clock finds.
@pytest.mark.parametrize(
    ("mcu", "ppm", "late"),
    [("gap8", 50, 50), ("gap8", -50, 20), ("gap8", 2000, 10), ("gap8", -2000, 6),
     ("stm32", 50, 20), ("stm32", -50, 50), ("stm32", 2000, 6), ("stm32", -2000, 10)],
)  # fmt: skip
def test_wrong_times_have_a_flag_soon_and_the_recording_has_none(mcu: str, ppm: float, late: int) -> None:
    robot, true_us = flown(mcu, ppm)
    frames = [frame for frame in robot.frames if frame.native]
    at_s = np.array([frame.native.frame_gap8_us for frame in frames if frame.native]) * 1e-6
    own_us = np.array([np.nan if frame.frame_stm32_us is None else frame.frame_stm32_us for frame in frames], float)
    bound_us = np.array([frame.native.bound_us or 0 for frame in frames if frame.native], float)
    flagged = np.array([bool(set(frame.native.flag_names) - SEEN) for frame in frames if frame.native])
    wrong = ~np.isnan(own_us) & (np.abs(own_us - true_us) > bound_us) & ~flagged
    near = (at_s > STEP_S - 0.1) & (at_s < STEP_S + 3.5)
    assert wrong[near].sum() <= late
    assert wrong[~near].sum() <= 0.01 * len(wrong)
    assert flagged[near].any(), "it is told"
    assert np.nanmedian(np.abs(own_us - true_us)[-60:]) < 30, "and got over"

    later = restamped(robot)
    assert len(later.found.fitted) == 1
    assert later.wrong.mean() <= 0.01
    assert not later.wrong[near[later.found.frame]].any()
