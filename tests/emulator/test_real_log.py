"""The STM32's real image writes the file that the native app writes, request by request."""

import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "firmware"))

from arm_rig import compiler
from memory_card import Store

from host.firmware.build import build
from host.native import lib
from host.usd.decode import decode
from sim import images, unicorn
from sim.world import World

CONFIG = (
    b"1\n16384\nlog\n1\non:fixedFrequency\n1000\n1\nstateEstimate.x\nstateEstimate.vx\nstateEstimate.yaw\nacc.z\n"
    b"pm.vbatMV\nstateEstimateZ.quat\nusd.stallUs\non:estGyroscope\ngyro.z\non:estPose\nlocSrv.x\nlocSrv.qw\n"
)
SHUTDOWN = bytes.fromhex("ff 03 59 01 30 94")


@pytest.fixture(scope="module")
def image() -> images.Image:
    compiler()
    return images.load(build("stm32").elf)


def flown(image: images.Image | None, stall_ms: int, fails: set[int], **keys: Any) -> tuple[Store, int]:
    """The card behind a flight with a reset of the stamp clock, a power cut and a proper end."""
    store = Store(CONFIG, stall_ms=stall_ms, fails=fails)
    world = World("hover", trace="hash", camera_fps=0, **keys)
    if image is not None:
        assert lib.kernel_emulate(world.kernel, 0, lib.MCU_STM32, unicorn.table(), image.pointer) == 0
    robot = world.robots[0]
    robot.set_storage(store)
    world.run(0.7)
    robot.reset_stamp_clock("stm32", 12_345_678)
    world.run(0.6)
    robot.reboot("stm32", 0.05)
    world.run(0.7)
    robot.inject("uart2_to_stm32", SHUTDOWN)
    world.run(0.5)
    return store, world.trace_hash()


@pytest.mark.parametrize(
    ("stall_ms", "fails", "keys"),
    [
        (0, set(), {}),
        (300, set(), {"stm32_ppm": 300, "seed": 2}),
        (0, {20, 21, 22, 23, 60}, {"stm32_divider": 84, "stm32_ppm": -2000}),
        (50, {7}, {"stm32_stamp_bits": 32, "stm32_stamp_start_us": 4_294_000_000, "uart2_drop": 0.01}),
    ],
)
def test_the_image_writes_what_the_native_app_writes(
    image: images.Image, stall_ms: int, fails: set[int], keys: dict[str, Any]
) -> None:
    native, native_hash = flown(None, stall_ms, fails, **keys)
    emulated, emulated_hash = flown(image, stall_ms, fails, **keys)
    assert len(native.requests) > 100
    for number, (theirs, ours) in enumerate(zip(native.requests, emulated.requests, strict=False)):
        assert theirs == ours, f"request {number}"
    assert len(native.requests) == len(emulated.requests)
    assert native.files == emulated.files
    assert native_hash == emulated_hash
    last = decode(bytes(native.files[max(native.files)]))
    assert last.is_whole


def test_an_image_without_a_card_flies(image: images.Image) -> None:
    hashes = []
    for emulated in (False, True):
        world = World("hover", trace="hash", camera_fps=0)
        if emulated:
            assert lib.kernel_emulate(world.kernel, 0, lib.MCU_STM32, unicorn.table(), image.pointer) == 0
        world.run(1)
        hashes.append(world.trace_hash())
    assert hashes[0] == hashes[1]
