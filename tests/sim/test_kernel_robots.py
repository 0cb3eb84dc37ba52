"""Robots share nothing: in what order they run, in what portions, and by how many threads changes no byte."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from host.native import lib
from sim.world import World

SECONDS = 2
SETTINGS: dict[str, Any] = {"camera_fps": 30, "camera_width": 32, "camera_height": 24, "uart1_loss": 0.1}


def run(trace: Any, threads: int, step_s: float) -> tuple[dict[tuple[int, str], list[bytes]], Any, int]:
    """What each wire carried if the trace is full, the truth, and the hash if there is one."""
    with World("hover", robots=5, trace=trace, **SETTINGS) as world:
        lib.kernel_set_threads(world.kernel, threads)
        for robot in world.robots:
            robot.connect()
        for _ in range(round(SECONDS / step_s)):
            world.run(step_s)
        sent: dict[tuple[int, str], list[bytes]] = {}
        for one in world.take_trace() if trace == "full" else []:
            sent.setdefault((one.robot, one.wire), []).append(one.data)
        return sent, world.truth, world.trace_hash()


@pytest.mark.parametrize(("threads", "step_s"), [(1, 0.004), (2, 0.1), (16, 0.02), (1000, 2)])
def test_threads_and_portions_change_nothing(threads: int, step_s: float) -> None:
    _, truth, trace_hash = run("hash", threads, step_s)
    sent, in_order, same_hash = run("full", 1, SECONDS)
    assert len({robot for robot, _ in sent}) == 5
    assert trace_hash == same_hash
    assert len(truth) > 100
    np.testing.assert_array_equal(truth, in_order)


def test_a_full_trace_is_in_the_order_in_which_runs_end() -> None:
    with World("hover", robots=3, trace="full", **SETTINGS) as world:
        world.run(1)
        ends = [
            one.true_ns + len(one.data) * one.byte_ps / 1000
            for one in world.take_trace()
            if one.wire == "uart1_to_gap8"
        ]
    assert len(ends) > 100
    assert all(after > before - 1000 for before, after in itertools.pairwise(ends)), (
        "but for what a clock drifts in a run"
    )


def test_a_robot_that_is_waited_for_stops_all() -> None:
    stopped: list[tuple[int, list[int]]] = []
    for trace, threads in (("full", 1), ("hash", 3)):
        with World("hover", robots=3, trace=trace, **SETTINGS) as world:  # type: ignore[arg-type]
            lib.kernel_set_threads(world.kernel, threads)
            world.robots[1].connect()
            assert world.run_until(10_000_000_000, 1, 1)
            stopped.append((world.now_ns, [robot.wires["uart1_to_gap8"]["bytes"] for robot in world.robots]))
    assert stopped[0] == stopped[1]
    assert 0 < stopped[0][0] < 10_000_000_000
