"""One schedule of faults and commands against one robot, once with the native GAP8 and once with its real image.

Everything is drawn from a seed: scenario, drift, clocks, camera, wires, reboots, stamp clocks that are set, bytes that
are injected, what the host asks for. `python tests/emulator/gap8_campaign.py 0 1000` runs a thousand; one number runs
that seed alone.
"""

from __future__ import annotations

import random
import sys
from collections.abc import Callable, Iterable
from typing import Any

from host.native import ffi, lib
from sim import images, unicorn
from sim.world import World

SECONDS = 1.5
Run = tuple[int, int, int, int, bytes]
"""Wire, local and true start, byte time, bytes."""
Drive = Callable[[World], None]

SPI_PACKETS = [
    bytes.fromhex(text) for text in ("0300540f06", "040054043201", "040054043200", "0800", "ffff5c05", "00000000")
]
"""Start, a client, no client, and damage."""
NATIVE, STOCK, ECHO = map(bytes.fromhex, ("08005c054e1001000000", "08005c054e1000000000", "06005c0e01020304"))
REQUESTS = [NATIVE, STOCK, ECHO, bytes.fromhex("08005c054e1001400000")]
"""The last: native in packets of 64 bytes, which is refused."""


def settings(draw: random.Random) -> dict[str, Any]:
    chosen: dict[str, Any] = {
        "source": draw.choice(["hover", "hover", "lossy", "lossy", "paper", "stock", "nanocockpit"]),
        "seed": draw.randrange(1 << 32),
        "gap8_ppm": draw.choice([-20_000, -50, 0, 50, 2000, 20_000]),
        "gap8_walk_ppb": draw.choice([0, 10, 1000]),
        "stm32_ppm": draw.choice([-20_000, 0, 50]),
        "gap8_quantum": draw.choice(["1us", "rtc", "1ms"]),
        "gap8_stamp_bits": draw.choice([32, 48, 64]),
        "gap8_stamp_start_us": draw.choice([0, 2**32 - 700_000]),
        "camera_fps": draw.choice([0, 5, 10, 30]),
        "camera_width": draw.choice([64, 162, 324]),
        "camera_height": draw.choice([48, 162, 244]),
        "camera_line_time_ns": draw.choice([20_000, 40_000]),
        "camera_exposure_lines": draw.choice([2, 50]),
        "camera_burst": draw.choice([1, 2, 3]),
        "camera_jitter_us": draw.choice([0, 20, 300]),
        "camera_fail": draw.choice([0, 0.1]),
        "camera_hang": draw.choice([0, 0.05]),
    }
    if chosen["source"] != "nanocockpit":
        chosen["camera_encoding"] = draw.choice(["raw", "raw", "jpeg"])
    for wire in ("uart1", "spi"):
        if draw.random() < 0.5:
            chosen |= {
                f"{wire}_loss": draw.choice([0, 0.05]),
                f"{wire}_duplicate": draw.choice([0, 0.1]),
                f"{wire}_flip": draw.choice([0, 1e-4]),
                f"{wire}_drop": draw.choice([0, 1e-3]),
                f"{wire}_latency_us": draw.choice([0, 50]),
                f"{wire}_jitter_us": draw.choice([0, 30]),
                f"{wire}_stall_per_s": draw.choice([0, 3]),
                f"{wire}_stall_ms": draw.choice([1, 20]),
            }
    chosen["spi_hz"] = draw.choice([10_000_000, 1_000_000])
    return chosen


def one_event(world: World, draw: random.Random) -> None:
    robot = world.robots[0]
    event = draw.random()
    if event < 0.04:
        robot.reboot(draw.choice(["stm32", "gap8", "gap8", "esp32"]), draw.choice([0, 1e-6, 0.005, 0.1]))
    elif event < 0.10:
        robot.reset_stamp_clock(draw.choice(["stm32", "gap8", "gap8"]), draw.choice([0, 5, 2**40]))
    elif event < 0.14:
        robot.set_rate("gap8", draw.choice([-20_000, 0, 50, 2000]))
    elif event < 0.22:
        noise = draw.randbytes(draw.randrange(60))
        robot.inject(draw.choice(["spi", "uart1"]), draw.choice([*SPI_PACKETS, noise]))
    elif event < 0.26:
        robot.stall(draw.choice(["spi", "uart1"]), draw.choice([1e-6, 0.001, 0.05]))
    elif event < 0.30:
        robot.disconnect()
    elif event < 0.50:
        robot.connect()
    elif event < 0.65:
        robot.write(draw.choice(REQUESTS))


def schedule(seed: int) -> Drive:
    def drive(world: World) -> None:
        draw = random.Random(seed)
        world.robots[0].connect()
        while world.seconds < SECONDS:
            world.run(draw.choice([1e-9, 1e-6, 0.001, 0.02, 0.05, 0.12]))
            one_event(world, draw)
            for robot in world.robots:
                robot.read()

    return drive


def traced(image: images.Image | None, chosen: dict[str, Any], drive: Drive) -> list[Run]:
    """With `image` in the place of each robot's GAP8."""
    world = World(**{"source": "hover", **chosen}, trace="full")
    if image is not None:
        for robot in range(len(world.robots)):
            assert lib.kernel_emulate(world.kernel, robot, lib.MCU_GAP8, unicorn.table(), image.pointer) == 0
    drive(world)
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    runs = lib.kernel_trace_runs(world.kernel, count)
    data = bytes(ffi.buffer(lib.kernel_trace_data(world.kernel, size), size[0])) if count[0] else b""
    return [
        (run.wire, run.local_start_ns, run.true_start_ns, run.byte_ps, data[run.offset : run.offset + run.length])
        for run in runs[0 : count[0]]
    ]


def described(run: Run) -> str:
    return f"wire {run[0]} at {run[1]} ns, {run[2]} true, {run[3]} ps, {len(run[4])} bytes"


def difference(native: list[Run], emulated: list[Run]) -> str:
    """The first one, or nothing."""
    for number, (left, right) in enumerate(zip(native, emulated, strict=False)):
        if left != right:
            at = next((i for i, pair in enumerate(zip(left[4], right[4], strict=False)) if pair[0] != pair[1]), None)
            return f"run {number} of {len(native)}, byte {at}: native {described(left)}, emulated {described(right)}"
    return "" if len(native) == len(emulated) else f"{len(native)} native runs, {len(emulated)} emulated"


def compare(image: images.Image, seed: int) -> str:
    chosen = settings(random.Random(seed))
    drive = schedule(seed)
    found = difference(traced(None, chosen, drive), traced(image, chosen, drive))
    return f"{found}\n{chosen}\nreplay: python tests/emulator/gap8_campaign.py {seed}" if found else ""


def main(arguments: Iterable[str]) -> int:
    from host.firmware.build import build

    image = images.load(build("gap8").elf)
    first, *end = map(int, arguments)
    bad = 0
    for seed in range(first, *(end or [first + 1])):
        found = compare(image, seed)
        bad += bool(found)
        if found:
            print(f"seed {seed}: {found}")
    print(f"{bad} differ")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
