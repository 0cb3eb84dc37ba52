"""The three apps, compiled for their instruction sets and run by QEMU, give what the native ones gave in the simulator.

QEMU shares nothing with the project's emulator: no CPU model, no peripheral, no scheduler. What it is fed is a
recording of all calls that each app got in simulated runs with faults, linked into the image; what it answers comes out
of a UART, and every byte of that is compared. By hand, with any scenario and keys:

    python tests/referee/test_replayed_apps.py gap8 lossy 2 seed=7 gap8_ppm=80
"""

import functools
import sys
import tempfile
from pathlib import Path

import machines
import pytest
import recording
from recording import Recording

from sim.scenario import from_url
from sim.world import World

SECONDS = 1.5
SMALL = "camera_width=96&camera_height=72&camera_fps=8"
CASES = [
    f"lossy?{SMALL}&seed=7&stm32_ppm=2000&gap8_ppm=-2000",
    f"lossy?{SMALL}&seed=8&camera_encoding=jpeg&stm32_divider=84&gap8_quantum=1ms&spi_loss=0.02&spi_flip=1e-5",
    f"hover?{SMALL}&seed=9&crtp_hz=50&camera_burst=2",
    f"paper?{SMALL}&seed=10",
    f"nanocockpit?{SMALL}&seed=11",
    f"stock?{SMALL}&seed=12",
]


def record(url: str, seconds: float) -> dict[str, Recording]:
    """Of the three MCUs of robot 0. Each is reset once, half-way."""
    with World(from_url(f"sim://{url}")) as world:
        for mcu in recording.MCUS:
            recording.begin(world, mcu)
        robot = world.listen()
        robot.run(seconds / 2)
        for mcu in recording.MCUS:
            world.robots[0].reboot(mcu, 0.02)
            robot.run(seconds / 6)
        return {mcu: recording.take(world, mcu) for mcu in recording.MCUS}


@functools.cache
def recorded(url: str) -> dict[str, Recording]:
    return record(url, SECONDS)


def difference(calls: Recording, folder: Path) -> str | None:
    """The first byte in which QEMU differs."""
    expected = calls.output
    got = machines.run(calls.mcu, machines.link(calls.mcu, calls.image, folder), len(expected))
    found = machines.first_difference(got, expected)
    return found and f"{found[1]}; {calls.at(found[0])}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("replay")


@pytest.mark.parametrize("mcu", recording.MCUS)
def test_qemu_gives_what_the_simulator_gave(mcu: str, folder: Path) -> None:
    if reason := machines.missing(mcu):
        pytest.skip(reason)
    cases = [recorded(url)[mcu] for url in CASES]
    everything = Recording(mcu, tuple(call for case in cases for call in case.calls))
    within = folder / mcu
    within.mkdir()
    if found := difference(everything, within):
        again = next(url for url in CASES if difference(recorded(url)[mcu], within))
        name, _, keys = again.partition("?")
        pytest.fail(
            f"{found}\npython tests/referee/{Path(__file__).name} {mcu} {name} {SECONDS} {keys.replace('&', ' ')}"
        )


def main(mcu: str, scenario: str, seconds: str, *keys: str) -> int:
    with tempfile.TemporaryDirectory() as made:
        within = Path(made) / mcu
        within.mkdir()
        calls = record(f"{scenario}?{'&'.join(keys)}" if keys else scenario, float(seconds))[mcu]
        found = difference(calls, within)
    print(found or f"equal: {len(calls.calls)} calls, {len(calls.output)} bytes")
    return found is not None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
