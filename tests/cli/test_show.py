"""The figures of the status line and of the summary."""

import numpy as np
import pytest

import host
from host.cli.show import status_line
from host.cli.stream_loop import Robot
from host.link.records import Console, Frame


def frame(index: int, arrival_host_ns: int) -> Frame:
    return Frame(index, arrival_host_ns, 2, 1, 1, "raw", np.zeros(2, np.uint8))


@pytest.fixture
def robot():
    with host.open("sim://hover?pace=max") as stream:
        yield Robot(0, "sim://hover", stream)


def test_the_rate_counts_periods_between_frames(robot: Robot) -> None:
    assert robot.fps is None
    robot.take(Console(0, "ESP32", "booted long before the first frame"))
    robot.take(frame(0, 60_000_000_000))
    assert robot.summary()["fps"] is None
    robot.take(frame(1, 60_100_000_000))
    robot.take(frame(2, 60_200_000_000))
    robot.take(Console(90_000_000_000, "ESP32", "and speaks long after the last"))
    assert robot.summary()["fps"] == pytest.approx(10)
    assert robot.summary()["seconds"] == 90


def test_a_status_line_costs_no_look_at_all_frames_so_far(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Robot, "stamp_error_us", lambda self: pytest.fail("computed for a status line"))
    robot.take(frame(0, 1_000_000_000))
    robot.take(frame(1, 1_100_000_000))
    assert "2 frames  10.0 fps" in status_line(robot)
