"""The GAP8's real image in the simulated world: the bytes and times of the app that is compiled for the host."""

from typing import Any

import pytest
from gap8_campaign import ECHO, NATIVE, compare, difference, traced
from gap8_image_rig import compiler

from host.firmware.build import build
from host.native import lib
from host.protocol.errors import LocalError, PeerError
from sim import images, unicorn
from sim.world import World


@pytest.fixture(scope="module")
def image() -> images.Image:
    compiler()
    return images.load(build("gap8").elf)


def fly(world: World) -> None:
    for robot in world.robots:
        robot.connect()
    for _ in range(20):
        world.run(0.1)
        for robot in world.robots:
            robot.read()


@pytest.mark.parametrize("scenario", ["hover", "lossy", "paper", "stock", "nanocockpit"])
def test_the_image_s_bytes_and_times_are_the_native_app_s(image: images.Image, scenario: str) -> None:
    native = traced(None, {"source": scenario}, fly)
    assert len(native) > 1000
    assert difference(native, traced(image, {"source": scenario}, fly)) == ""


@pytest.mark.parametrize("toolchain", ["gcc", "zig"])
def test_with_either_compiler(toolchain: str) -> None:
    try:
        own = images.load(build("gap8", toolchain).elf)
    except LocalError as error:
        pytest.skip(str(error).splitlines()[0])
    assert difference(traced(None, {}, fly), traced(own, {}, fly)) == ""


@pytest.mark.parametrize("ppm", [-20_000, -50, 50, 2000])
@pytest.mark.parametrize("quantum", ["1us", "rtc", "1ms"])
def test_with_any_drift_and_clock(image: images.Image, ppm: int, quantum: str) -> None:
    chosen: dict[str, Any] = {"gap8_ppm": ppm, "gap8_quantum": quantum, "camera_width": 64, "camera_height": 48}
    assert difference(traced(None, chosen, fly), traced(image, chosen, fly)) == ""


def test_the_stamp_clock_wraps_and_many_robots_fly(image: images.Image) -> None:
    chosen: dict[str, Any] = {"gap8_stamp_bits": 32, "gap8_stamp_start_us": 2**32 - 1_000_000, "robots": 3}
    assert difference(traced(None, chosen, fly), traced(image, chosen, fly)) == ""


def test_uptime_passes_the_counter_s_wrap(image: images.Image) -> None:
    """The counter has 32 bits: 71 minutes. Without a camera the alarm comes only to read it."""

    def sleep(world: World) -> None:
        world.run(4300)
        world.robots[0].connect()
        world.run(0.1)

    chosen: dict[str, Any] = {
        "source": "stock", "camera_width": 64, "camera_height": 48, "gap8_quantum": "1us", "esp32_boot_ms": 600_000
    }  # fmt: skip
    native = traced(None, chosen, sleep)
    assert difference(native, traced(image, chosen, sleep)) == ""
    assert native[-1][2] > 4300 * 10**9, "it streams then"


def test_what_it_decides_while_a_window_is_under_way_or_the_wire_stands_still(image: images.Image) -> None:
    """It may not decide yet in a window that the ESP32 alone has begun; where the wire stands still, it does."""

    def drive(world: World) -> None:
        robot = world.robots[0]
        robot.connect()
        world.run(0.6)
        robot.write(NATIVE)
        for number in range(40):
            world.run(0.0613)
            if number % 4 == 3:
                robot.stall("spi", 0.04)
            else:
                robot.write(ECHO)
            robot.read()

    chosen: dict[str, Any] = {
        "camera_fps": 8,
        "camera_width": 16,
        "camera_height": 16,
        "camera_line_time_ns": 20_000,
        "spi_gap_us": 10_000,
    }
    assert difference(traced(None, chosen, drive), traced(image, chosen, drive)) == ""


@pytest.mark.parametrize("seed", range(12))
def test_whatever_happens(image: images.Image, seed: int) -> None:
    assert compare(image, seed) == ""


def test_a_picture_that_does_not_fit_ends_the_world(image: images.Image) -> None:
    # JPEG: raw pictures of this size are refused by the scenario.
    world = World("hover", camera_width=1024, camera_height=1024, camera_encoding="jpeg", camera_quality=95,
                  camera_fps=2, camera_line_time_ns=1000)  # fmt: skip
    assert lib.kernel_emulate(world.kernel, 0, lib.MCU_GAP8, unicorn.table(), image.pointer) == 0
    world.robots[0].connect()
    with pytest.raises(
        PeerError, match=r"gap8, .*: the camera's picture has \d+ bytes, and the image keeps at most 104976"
    ):
        world.run(5)
