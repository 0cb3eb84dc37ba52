"""How much faster than real time robots run whose STM32 and GAP8 are emulated, and what an emulated MCU costs.

One process; one thread for one robot, for several a thread for each core. The reference is real time; beside each
figure stands the native backend's, of the same run.
Wall time is that of the round that took least CPU time, which other programs of the machine lengthen less. An emulated
robot is an STM32 with 1700 bytes a second on UART1, each an interrupt; a GAP8 that takes an interrupt for each of them;
and a native ESP32. In the run of 30 MCUs all are emulated: 15 robots.

    python benchmarks/emulator.py [--rounds 3] [--seconds 30] [--json]
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from sim.world import World

PLAIN: dict[str, Any] = {"camera_fps": 0}
# As in benchmarks/simulator.py: at 10 MHz the windows' handshakes leave too little room.
PIXELS: dict[str, Any] = {"camera_fps": 15, "camera_width": 324, "camera_height": 244, "spi_hz": 20_000_000}
MANY: dict[str, Any] = {"camera_fps": 0, "robots": 15}
READ_EVERY_S = 0.05
WORLDS = 20
MIB = 1 << 20


def simulate(backend: str, seconds: float, settings: dict[str, Any], read_every_s: float) -> dict[str, float]:
    """Wall and CPU time of this much true time, after two seconds in which everything boots and connects."""
    with World("hover", keep_log=False, trace="hash", backend=backend, **settings) as world:
        for robot in world.robots:
            robot.connect()
        world.run(2)
        frames = len(world.truth)
        wall, cpu = time.perf_counter(), time.process_time()
        end_ns = world.now_ns + round(seconds * 1e9)
        while world.now_ns < end_ns:
            world.run(read_every_s)
            for robot in world.robots:
                robot.read()
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
        uart_bytes = sum(robot.wires["uart1_to_gap8"]["bytes"] for robot in world.robots)
        return {
            "wall_s": wall,
            "cpu_s": cpu,
            "times_real": seconds / wall,
            "times_cpu": seconds / cpu,
            "captured": len(world.truth) - frames,
            "uart1_bytes": uart_bytes,
            "trace_hash": world.trace_hash(),
        }


def best(rounds: int, *run: Any) -> dict[str, float]:
    return min((simulate(*run) for _ in range(rounds)), key=lambda result: result["cpu_s"])


def compared(
    rounds: int, seconds: float, settings: dict[str, Any], read_every_s: float = READ_EVERY_S
) -> dict[str, Any]:
    """Both backends; SystemExit if they have not done the same."""
    native, emulated = (best(rounds, backend, seconds, settings, read_every_s) for backend in ("native", "emulated"))
    if native["trace_hash"] != emulated["trace_hash"]:
        sys.exit(f"{settings}: the emulated robots have sent something else than the native ones")
    return {"native": native, "emulated": emulated}


def resident_bytes() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()


def creation(pixels: bool) -> dict[str, float]:
    """Of one MCU: CPU time from nothing until it has booted and sleeps, and the memory that the process has grown by,
    Unicorn's own included. The mean over 2 * WORLDS; with pixels after a second of streaming, which touches all its
    memory."""
    settings: dict[str, Any] = {**PIXELS, "gap8_boot_ms": 0} if pixels else {**PLAIN, "gap8_boot_ms": 0}
    World("hover", backend="emulated", **settings).close()  # built, loaded, Unicorn's library in memory

    def grown(backend: str) -> tuple[float, int]:
        before, took_s = resident_bytes(), 0.0
        worlds = []
        for _ in range(WORLDS):
            start_s = time.process_time()
            world = World("hover", keep_log=False, backend=backend, **settings)
            world.run(0)
            took_s += time.process_time() - start_s
            if pixels:
                world.robots[0].connect()
                world.run(1)
            worlds.append(world)
        grew = resident_bytes() - before
        for world in worlds:
            world.close()
        return took_s, grew

    native_s, native_bytes = grown("native")
    emulated_s, emulated_bytes = grown("emulated")
    mcus = 2 * WORLDS
    return {"ms": (emulated_s - native_s) / mcus * 1e3, "mib": (emulated_bytes - native_bytes) / mcus / MIB}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=30, help="true time of each run")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()

    plain = compared(options.rounds, options.seconds, PLAIN)
    pixels = compared(options.rounds, options.seconds, PIXELS)
    many = compared(options.rounds, options.seconds / 3, MANY)
    at_once = compared(options.rounds, options.seconds / 3, MANY, options.seconds / 3)
    booted, streaming = creation(pixels=False), creation(pixels=True)
    if options.json:
        print(
            json.dumps(
                {
                    "plain": plain,
                    "pixels": pixels,
                    "many": many,
                    "at_once": at_once,
                    "booted": booted,
                    "streaming": streaming,
                }
            )
        )
        return
    said = (
        ("one robot without pixels", plain, 100),
        (f"one robot, {pixels['emulated']['captured'] / options.seconds:.1f} raw frames a second", pixels, 20),
        ("30 MCUs with an interrupt for each byte", many, 15),
        ("the same in one run, not read every 50 ms", at_once, 15),
    )
    for what, both, bar in said:
        emulated, native = both["emulated"], both["native"]
        print(
            f"{what}: {emulated['times_real']:.3g} times real time (bar: {bar}), {emulated['times_cpu']:.3g} by the "
            f"CPU time of all threads; native {native['times_real']:.0f} and {native['times_cpu']:.0f}; traces equal"
        )
    print(
        f"creating an MCU and booting its image: {booted['ms']:.1f} ms of CPU time (bar: 10); memory "
        f"{booted['mib']:.1f} MiB, {streaming['mib']:.1f} MiB after a second of raw frames (bar: 5)"
    )


if __name__ == "__main__":
    main()
