"""Two worlds of one scenario side by side, under the same faults: where their traces first differ, if they do.

Hashes of what every sender has sent, byte for byte and with the local and true time of every run, are compared every
STEP_S; only when they differ are both run again, with whole traces kept from shortly before.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import zip_longest
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sim"))

from campaign import Host
from faults import Faults

from host.native import lib
from host.protocol.errors import LocalError
from sim import scenario, trace
from sim.trace import Run
from sim.world import World

NS = 1_000_000_000
STEP_S = 0.01
"""Hosts read, and faults happen, this often."""
BEFORE_S = 2.0
"""Whole traces are kept for so long before a difference."""
FAULTS_PER_S = 2.0
KINDS = {"loss": 0.05, "drop": 0.002, "flip": 0.002, "duplicate": 0.05, "stall_per_s": 2, "stall_ms": 20}

Settings = dict[str, Any]


@dataclass(frozen=True)
class Case:
    """A scenario with some keys set anew, and perhaps random faults."""

    name: str
    scenario: str
    settings: Settings = field(default_factory=dict)
    faults: bool = False
    seed: int = 1
    dialect: str = "auto"


def drawn(seed: int) -> Case:
    """Clocks, wires, camera and host at random, and random faults."""
    draw = random.Random(seed)
    settings: Settings = {
        "wire": draw.choice(["tcp"] * 6 + ["uart2", "uart1"]),
        "stm32_divider": draw.choice([84, 85]),
        "crtp_hz": draw.choice([0, 50, 200]),
        "spi_hz": draw.choice([1_000_000, 10_000_000, 30_000_000]),
        "wifi_up_ms": draw.choice([0, 100, 500]),
        "camera_fps": draw.choice([0, 5, 20, 60]),
        "camera_width": draw.choice([32, 64, 128]),
        "camera_height": draw.choice([16, 48]),
        "camera_encoding": draw.choice(["raw", "raw", "jpeg"]),
        "camera_burst": draw.choice([1, 2, 3]),
        "camera_exposure_lines": 20,
        "camera_line_time_ns": 35_833,
    }
    for mcu in ("stm32", "gap8"):
        settings |= {
            f"{mcu}_ppm": draw.choice([-20_000, -50, 0, 50, 2000, 20_000]),
            f"{mcu}_walk_ppb": draw.choice([0, 10, 100_000]),
            f"{mcu}_ramp_ppm": draw.choice([0, 100]),
            f"{mcu}_boot_ms": draw.choice([0, 0, 80, 333.3]),
            f"{mcu}_stamp_bits": draw.choice([32, 48, 64]),
            f"{mcu}_stamp_start_us": draw.choice([0, 2**32 - 2_000_000]),
            f"{mcu}_quantum": draw.choice(["1us", "1us", "rtc", "1ms"] if mcu == "gap8" else ["1us"]),
        }
    for link in ("uart1", "uart2", "spi"):
        if draw.random() < 0.5:
            settings |= {f"{link}_latency_us": draw.choice([0, 100, 5000]), f"{link}_jitter_us": draw.choice([0, 100])}
            settings |= {f"{link}_{kind}": draw.choice([0, amount]) for kind, amount in KINDS.items()}
    while True:
        name = draw.choice(scenario.names())
        kept = {key: value for key, value in settings.items() if (name, key) != ("nanocockpit", "camera_encoding")}
        if name == "stock" and not settings["camera_fps"]:  # says nothing at all
            continue
        try:
            scenario.load(name, robots=1, **kept)
        except LocalError:  # not with this firmware
            continue
        return Case(f"seed {seed}", name, {"robots": 1, **kept}, True, seed, draw.choice(["auto", "native", "stock"]))


class Listener(Host):
    """Reads, answers and connects again. What comes is judged elsewhere: here only the bytes count."""

    def _take(self, events: list[Any]) -> None:
        pass


class Side:
    """One of the two."""

    def __init__(self, case: Case, own: Settings) -> None:
        self.world = World(case.scenario, trace="hash", seed=case.seed, **case.settings | own)
        self.hosts = [Listener(self.world, case.dialect, robot) for robot in range(len(self.world.robots))]
        draw = random.Random(f"{case.name} {case.seed}")
        self.faults = Faults(draw, self.world, self.hosts[0]) if case.faults else None
        self.next_s = 1.0

    def step(self, until_ns: int) -> None:
        self.world.run_until(until_ns)
        for host in self.hosts:
            host.poll()
        if self.faults is None:
            return
        self.faults.due()
        while self.next_s * NS <= until_ns:
            self.faults.something(2.0)
            self.next_s += self.faults.random.expovariate(FAULTS_PER_S)

    def hashes(self) -> list[int]:
        robots, wires = range(len(self.hosts)), range(lib.WIRE_COUNT)
        return [lib.kernel_trace_hash(self.world.kernel, robot, wire) for robot in robots for wire in wires]


def until_they_differ(sides: list[Side], seconds: float) -> Iterator[bool]:
    """After each step, whether they still agree."""
    for number in range(1, round(seconds / STEP_S) + 1):
        for side in sides:
            side.step(round(number * STEP_S * NS))
        yield sides[0].hashes() == sides[1].hashes()


def difference(case: Case, seconds: float, first: Settings, second: Settings) -> str | None:
    """None when the traces are equal; else what differs first, and what had been done until then."""
    sides = [Side(case, own) for own in (first, second)]
    steps = 0
    for equal in until_they_differ(sides, seconds):
        steps += 1
        if not equal:
            break
    else:
        moved = sum(wire["bytes"] for wire in sides[0].world.robots[0].wires.values())
        assert moved > 100 * seconds, (
            f"{case}: {moved} bytes in {seconds} s: a run in which nothing happens proves nothing"
        )
        return None
    done = sides[0].faults.done[-5:] if sides[0].faults else []
    for side in sides:
        side.world.close()
    sides = [Side(case, own) for own in (first, second)]
    again = until_they_differ(sides, steps * STEP_S + BEFORE_S)
    for number in range(steps + round(BEFORE_S / STEP_S)):
        if number == max(0, steps - round(BEFORE_S / STEP_S)):
            for side in sides:
                lib.kernel_trace(side.world.kernel, lib.TRACE_FULL)
        next(again)
    return "\n".join([f"{case}: they differ by {steps * STEP_S:.2f} s", *compared(sides, (first, second)), *done])


def by_sender(runs: list[Run]) -> dict[tuple[int, str], list[Run]]:
    of: dict[tuple[int, str], list[Run]] = {}
    for run in runs:
        of.setdefault((run.robot, run.wire), []).append(run)
    return of


def compared(sides: list[Side], names: tuple[Settings, Settings]) -> list[str]:
    """The first byte in true time, of any wire, that is not the same or not at the same time."""
    traces = [by_sender(trace.take(side.world.kernel)) for side in sides]
    found = []
    for key in sorted(set(traces[0]) | set(traces[1])):
        pairs = zip_longest(*(trace.get(key, []) for trace in traces))
        for number, pair in enumerate(pairs):
            if pair[0] != pair[1]:
                found.append((min(run.true_ns for run in pair if run), key, number, pair))
                break
    if not found:
        return ["only in runs that had not ended: nothing to show"]
    _, (robot, wire), number, pair = min(found, key=lambda each: each[0])
    lines = [f"robot {robot}, {wire}, run {number} since the trace began:"]
    if None not in pair:
        at = next((i for i, (a, b) in enumerate(zip_longest(*(run.data for run in pair))) if a != b), None)
        lines.append("  their bytes are equal" if at is None else f"  first byte that differs: {at}")
    for name, run in zip(names, pair, strict=True):
        if run is None:
            lines.append(f"  {name}: nothing")
            continue
        lines.append(
            f"  {name}: local {run.local_ns} ns, true {run.true_ns} ns, {run.byte_ps} ps a byte, "
            f"{len(run.data)} bytes: {run.data[:48].hex(' ')}{' …' if len(run.data) > 48 else ''}"
        )
    return lines
