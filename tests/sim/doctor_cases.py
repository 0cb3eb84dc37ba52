"""Robots with one fault each, and what host doctor should find; clean robots; robots with one slow stage."""

from __future__ import annotations

import random
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from host.link.counters import SessionCounters
from host.link.listening import Listening
from host.link.session import Session
from sim.robot import Robot
from sim.world import World

NS = 1_000_000_000
STEP_NS = NS // 200
READ_BYTES = 1 << 15
FRAMINGS = {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}
Settings = dict[str, Any]
Interfere = Callable[[Robot, random.Random, float], None]
"""The robot, and the simulated second that begins; called each tenth of a second."""


@dataclass(frozen=True)
class Case:
    name: str
    stage: str
    causes: tuple[str, ...]
    """Any of them is right."""
    settings: Settings = field(default_factory=dict)
    interfere: Interfere | None = None
    slow_host_s: float = 0.0
    """Busy for so long with each READ_BYTES."""


def listen(case: Case, seed: int, seconds: float, **settings: Any) -> Listening:
    """What `host doctor` would have heard in so many simulated seconds."""
    rng = random.Random(seed)
    with World("hover", seed=seed, **settings | case.settings) as world:
        robot = world.robots[0]
        heard = Listening(FRAMINGS[robot.settings.wire])
        session, total = Session(heard.framing, "auto"), SessionCounters()
        robot.connect()
        was_connected, busy_ns, next_ns = False, 0, 0
        while world.now_ns < seconds * NS:
            if case.interfere and world.now_ns >= next_ns:
                next_ns += NS // 10
                case.interfere(robot, rng, world.seconds)
            before_ns = world.now_ns
            world.run_until(world.now_ns + STEP_NS, 0, 1)
            data = robot.read(READ_BYTES)
            heard.read(world.now_ns, world.now_ns - before_ns, busy_ns)
            busy_ns = int(case.slow_host_s * NS * len(data) / READ_BYTES)
            world.run_until(world.now_ns + busy_ns)
            heard.take(session.receive(data, world.now_ns) if data else [])
            if not data:
                session.tick(world.now_ns)
                connected = robot.connected
                if was_connected and not connected:
                    heard.ended(world.now_ns, "closed by the robot")
                    heard.take(session.finish(world.now_ns))
                    total += session.counters
                    session = Session(heard.framing, "auto")
                    robot.connect()
                was_connected = connected
            out = session.data_to_send()
            if out:
                robot.write(out)
        heard.counters = total + session.counters
        return heard


def now_and_then(chance: float, do: Callable[[Robot], object]) -> Interfere:
    """After the first three seconds; `chance` for each tenth of a second."""

    def interfere(robot: Robot, rng: random.Random, second: float) -> None:
        if second >= 3 and rng.random() < chance:
            do(robot)

    return interfere


def once(do: Callable[[Robot], object], at_s: float = 8.0) -> Interfere:
    done: set[int] = set()

    def interfere(robot: Robot, _rng: random.Random, second: float) -> None:
        if second < at_s:
            done.clear()
        elif not done:
            done.add(1)
            do(robot)

    return interfere


FAULTS = (
    Case("time messages lost", "UART1", ("uart1_loss",), {"uart1_loss": 0.1}),
    Case("time messages damaged", "UART1", ("uart1_damage",), {"uart1_flip": 0.002}),
    Case("time messages late", "UART1", ("uart1_late",), {"uart1_jitter_us": 4000}),
    Case("time messages pause", "UART1", ("uart1_pauses",), {}, now_and_then(0.02, lambda r: r.stall("uart1", 1.5))),
    Case("STM32 restarts", "STM32", ("stm32_restarts",), {}, once(lambda r: r.reboot("stm32", 0.3))),
    Case("STM32's clock set back", "STM32", ("stm32_clock_reset",), {}, once(lambda r: r.reset_stamp_clock("stm32"))),
    Case("clock counts 84 in 85", "clock", ("clock_84_85",), {"stm32_divider": 84}),
    Case("STM32's clock off", "clock", ("stm32_drift",), {"stm32_ppm": 1500}),
    Case("GAP8's clock off", "clock", ("gap8_drift",), {"gap8_ppm": -2000}),
    Case("GAP8's clock coarse", "clock", ("gap8_coarse",), {"gap8_quantum": "1ms"}),
    Case("captures fail", "camera", ("camera_fails",), {"camera_fail": 0.1}),
    Case("captures hang", "camera", ("camera_hangs",), {"camera_hang": 0.03}),
    Case("GAP8 restarts", "GAP8", ("gap8_restarts",), {}, once(lambda r: r.reboot("gap8", 0.2))),
    Case("ESP32 restarts", "ESP32", ("esp32_restarts",), {}, once(lambda r: r.reboot("esp32", 0.2))),
    Case("SPI loses packets", "SPI", ("spi_damage",), {"spi_loss": 0.0005}),
    Case("SPI damages packets", "SPI", ("spi_damage",), {"spi_flip": 0.0000005}),
    Case("UART2 damaged", "UART2", ("uart2_damage",), {"uart2_flip": 0.02}),
    Case("Wi-Fi stands still", "Wi-Fi", ("wifi_stalls",), {"tcp_stall_per_s": 0.4, "tcp_stall_ms": 700}),
    Case("Wi-Fi loses segments", "Wi-Fi", ("wifi_stalls",), {"tcp_loss": 0.02, "tcp_rto_ms": 500}),
    Case("Wi-Fi too slow", "Wi-Fi", ("wifi_slow",), {"tcp_bytes_per_s": 300_000}),
    Case("connection damages bytes", "Wi-Fi", ("tcp_damage",), {"tcp_drop": 0.000002}),
    Case("host too slow", "host", ("host_slow",), {}, None, 0.15),
)

SLOW = (
    Case("camera", "camera", ("camera",), {"camera_fps": 2}),
    Case("SPI", "SPI", ("SPI",), {"spi_hz": 4_000_000}),
    Case("Wi-Fi", "Wi-Fi", ("Wi-Fi",), {"tcp_bytes_per_s": 250_000}),
    Case("host", "host", ("host",), {}, None, 0.2),
)

CLEAN = Case("nothing", "", ())
VARIETY: tuple[Settings, ...] = (
    {},
    {"camera_fps": 5, "camera_encoding": "jpeg"},
    {"camera_fps": 3, "camera_burst": 3, "camera_width": 160, "camera_height": 120},
    {"stm32_ppm": 120, "gap8_ppm": -90, "crtp_hz": 20},
    {"camera_fps": 20, "camera_encoding": "jpeg", "uart1_jitter_us": 400},
)
"""Of clean robots."""
