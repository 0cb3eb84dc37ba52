"""The figures of the status line and of the summary."""

import re

import numpy as np
import pytest

import host
from host.cli.show import clock_line, status_line, status_lines, summary_lines
from host.cli.stream_robot import Robot
from host.link.frame import Frame
from host.link.records import Console, LogState, LogStatus


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


@pytest.mark.parametrize(("divider", "ppm"), [(85, 40.0), (84, 40.0)])
def test_the_clocks_are_shown_live(divider: int, ppm: float) -> None:
    """Drift and offset against the simulator's truth; and what came without them has no such line."""
    url = f"sim://hover?pace=max&gap8_ppm={ppm}&stm32_ppm=0&gap8_walk_ppb=0&stm32_walk_ppb=0&stm32_divider={divider}"
    with host.open(f"{url}&seed=3", dialect="native") as stream:
        robot = Robot(0, "sim://hover", stream)
        assert clock_line(None) == clock_line(frame(0, 1)) == ""
        for each in stream:
            robot.take(each)
            if each.index == 120:
                break
        world = stream.port.world
        offset_s = (world.robots[0].stamp_us("gap8") - world.robots[0].stamp_us("stm32")) * 1e-6
    (line,) = (line for line in status_lines(robot) if "drift" in line)
    drift, offset = (float(line.split(name)[1].split()[0].rstrip("s,;")) for name in ("drift ", "offset "))
    assert drift == pytest.approx(((1 + ppm * 1e-6) * 85 / divider - 1) * 1e6, abs=5)
    assert offset == pytest.approx(offset_s, abs=2e-3)
    assert ("which counts 84 of 85" in line) == (divider == 84)
    assert robot.last_frame is not None
    assert robot.last_frame.native is not None
    echo = robot.last_frame.native.echo
    assert echo is not None
    assert line.endswith(f", the fastest by 0 to {echo.minimum_delay_us + echo.minimum_delay_error_us} us")
    summary = robot.summary()
    assert summary["echo"]["echoes"] == echo.echoes > 5
    assert any(f"by {echo.echoes} echoes" in each for each in summary_lines(summary))


@pytest.mark.parametrize(
    ("state", "files", "says"),
    [
        ("no_card", 0, None),
        ("off", 0, "off: as config.txt has it, it begins when the parameter usd.logging is set to 1"),
        ("bad_config", 0, "bad config, 0 rows, .*; config.txt says nothing that can be logged. host usd config check"),
        ("full", 1, "full, 0 rows, "),
        ("on", 1, "on, 0 rows, 0 dropped, 0 errors of the card, longest pause 0 ms$"),
        ("off", 1, "off, 0 rows, 0 dropped, 0 errors of the card, longest pause 0 ms$"),
    ],
)
def test_a_log_that_ended_or_waits_says_what_to_do(robot: Robot, state: LogState, files: int, says: str | None) -> None:
    counters = dict.fromkeys(("requested", "accepted", "dropped", "stall_us", "syncs", "errors", "card_errors"), 0)
    robot.take(frame(0, 1_000_000_000))
    robot.take(LogStatus(2_000_000_000, state, 1_000_000, 0, files, files, counters))
    said = [line.removeprefix("card's log  ") for line in summary_lines(robot.summary()) if line.startswith("card's")]
    if says is None:
        assert said == []
    else:
        assert len(said) == 1
        assert re.match(says, said[0])
