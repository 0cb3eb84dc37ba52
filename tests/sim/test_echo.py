"""The smallest delay on UART1, found by echoes, against the delays that the simulated wires have."""

from collections.abc import Callable
from typing import Any

import pytest

from host.link.headers import NativeEcho
from sim.receiver import Receiver
from sim.world import World

SMALL = {"camera_width": 32, "camera_height": 24, "camera_fps": 10}
EXACT = SMALL | {"gap8_quantum": "1us", "uart1_jitter_us": 0}
SECONDS = 14


def found(robot: Receiver) -> NativeEcho | None:
    last = robot.frames[-1].native
    assert last is not None
    return last.echo


def flown(act: Callable[[Receiver], None] | None = None, seconds: float = SECONDS, **settings: Any) -> NativeEcho:
    with World("hover", seed=3, **settings) as world:
        robot = world.listen()
        if act:
            act(robot)
        world.run(seconds)
        echo = found(robot)
    assert echo is not None
    return echo


# Oscillators apart by 2 % are in the times on the wire: 38 us in 1911.
@pytest.mark.parametrize(
    ("settings", "error_us"),
    [({}, 0), ({"stm32_divider": 84}, 1), ({"gap8_ppm": -20_000}, 39), ({"stm32_ppm": 20_000}, 39)],
)
@pytest.mark.parametrize("latency_us", [0, 500, 4100, 9000])
def test_a_constant_delay_is_found(latency_us: int, settings: dict[str, Any], error_us: int) -> None:
    """4.1 ms brings the question just when the next stamp leaves, 9 ms behind it."""
    echo = flown(uart1_latency_us=latency_us, **EXACT | settings)
    rate = 0.02 if error_us > 1 else 1e-4
    assert abs(echo.minimum_delay_us - latency_us) <= 2 + error_us / 2 + rate * latency_us
    assert latency_us * (1 - rate) - 2 <= echo.minimum_delay_error_us <= 6 + error_us + latency_us * (1 + rate)
    assert echo.echoes >= 10


@pytest.mark.parametrize("there_us", [0, 100, 1000])
@pytest.mark.parametrize("back_us", [0, 300, 2000])
def test_unequal_delays_are_within_the_error(there_us: int, back_us: int) -> None:
    def act(robot: Receiver) -> None:
        robot.set_faults("uart1_to_stm32", latency_us=there_us)
        robot.set_faults("uart1_to_gap8", latency_us=back_us)

    echo = flown(act, **EXACT)
    assert abs(echo.minimum_delay_us - (there_us + back_us) / 2) <= 2
    assert abs(echo.minimum_delay_us - back_us) <= echo.minimum_delay_error_us <= (there_us + back_us) / 2 + 6


def later(act: Callable[[Receiver], None]) -> Callable[[Receiver], None]:
    """When there have been echoes."""

    def run_and_act(robot: Receiver) -> None:
        robot.world.run(3)
        act(robot)

    return run_and_act


def reset_often(robot: Receiver) -> None:
    for n in range(40):
        robot.world.run(0.0973)
        robot.reset_stamp_clock("stm32", n * 1000)


FAULTS: dict[str, Callable[[Receiver], None]] = {
    "a third lost": lambda robot: robot.set_faults("uart1", loss=0.33),
    "duplicates": lambda robot: robot.set_faults("uart1", duplicate=0.5),
    "out of order": lambda robot: robot.set_faults("uart1", reorder=0.3),
    "damage": lambda robot: robot.set_faults("uart1", flip=0.003, drop=0.003),
    "stalls": lambda robot: robot.set_faults("uart1", stall_per_s=5, stall_ms=30),
    "jitter": lambda robot: robot.set_faults("uart1", jitter_us=300),
    "resets of the STM32's clock": later(reset_often),
    "its clock leaps on": later(lambda robot: robot.reset_stamp_clock("stm32", 2**40)),
    "the STM32 starts anew": later(lambda robot: robot.reboot("stm32", 0.3)),
    "the GAP8 starts anew": later(lambda robot: robot.reboot("gap8", 0.3)),
}


@pytest.mark.parametrize("name", FAULTS)
def test_faults_leave_it_right(name: str) -> None:
    """Delays can only be added: the smallest of some echoes may be above the wire's, and never below."""
    echo = flown(FAULTS[name], seconds=20, uart1_latency_us=400, **EXACT)
    late_us = 200 if name in ("jitter", "stalls") else 4
    assert 396 <= echo.minimum_delay_us <= 400 + late_us
    assert abs(echo.minimum_delay_us - 400) <= echo.minimum_delay_error_us
    assert echo.echoes >= 3


def test_a_clock_of_30_us_steps() -> None:
    echo = flown(uart1_latency_us=400, **EXACT | {"gap8_quantum": "rtc"})
    assert abs(echo.minimum_delay_us - 400) <= 31
    assert 400 - 31 <= echo.minimum_delay_error_us <= 400 + 70


@pytest.mark.parametrize("firmware", ["stock", "paper", "nanocockpit"])
def test_other_dialects_leave_the_wire_alone(firmware: str) -> None:
    with World("hover", firmware=firmware, **SMALL) as world:
        world.listen()
        world.run(3)
        assert world.robots[0].wires["uart1_to_stm32"]["bytes"] == 0


def test_stamps_are_what_they_are_without_echoes() -> None:
    with World("hover", seed=2, **EXACT) as world:
        robot = world.listen()
        world.run(5)
        assert robot.stm32["stamps_late"] == 0
        assert robot.wires["uart1_to_stm32"]["units"] == 5
        answers = robot.wires["uart1_to_gap8"]["bytes"] - 17 * robot.stm32["stamps_sent"]
        assert 5 * 17 <= answers < 6 * 17, "and what a stamp that is leaving has sent"
        last = robot.frames[-1].native
        assert last is not None
        assert last.counters["stamps_bad"] <= 17, "one was on the wire when the GAP8 began to listen"
        assert last.counters["stamps_missed"] == 0


def test_a_host_at_the_wire_is_not_told_of_answers() -> None:
    with World("hover", wire="uart1", **SMALL) as world:
        robot = world.listen()
        world.run(3)
        assert robot.wires["uart1_to_stm32"]["units"] == 3
        assert robot.counters.garbage_bytes == 0
        assert robot.counters.stamps == robot.stm32["stamps_sent"]
