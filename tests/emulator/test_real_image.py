"""The STM32's real image in the simulated world: the bytes and times of the app that is compiled for the host."""

from typing import Any

import pytest

pytest.importorskip("unicorn", reason="Unicorn is not installed: pip install 'spindeck[emulator]'")

from host.firmware.build import build
from host.firmware.toolchains import MissingError
from host.native import ffi, lib
from host.protocol.errors import PeerError
from sim import images, unicorn
from sim.world import World


@pytest.fixture(scope="module", params=["gcc", "zig"])
def image(request: pytest.FixtureRequest) -> images.Image:
    try:
        return images.load(build("stm32", request.param).elf)
    except MissingError as error:
        pytest.skip(str(error))


Run = tuple[int, int, int, int, bytes]


def traced(image: images.Image | None, scenario: str, seconds: float, **settings: Any) -> list[Run]:
    """Every run of bytes on every wire: wire, local and true start, byte time, bytes."""
    world = World(scenario, trace="full", **settings)
    if image is not None:
        assert lib.kernel_emulate(world.kernel, 0, lib.MCU_STM32, unicorn.table(), image.pointer) == 0
    for robot in world.robots:
        robot.connect()
    world.run(seconds / 2)
    world.robots[0].reset_stamp_clock("stm32", 12_345_678)
    world.run(seconds / 4)
    world.robots[0].reboot("stm32", 0.05)
    world.run(seconds / 4)
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    runs = lib.kernel_trace_runs(world.kernel, count)
    data = bytes(ffi.buffer(lib.kernel_trace_data(world.kernel, size), size[0]))
    return [
        (run.wire, run.local_start_ns, run.true_start_ns, run.byte_ps, data[run.offset : run.offset + run.length])
        for run in runs[0 : count[0]]
    ]


@pytest.mark.parametrize(
    ("scenario", "settings"),
    [
        ("hover", {}),
        ("hover", {"stm32_ppm": -20_000, "seed": 2}),
        (
            "hover",
            {"stm32_ppm": 50, "stm32_divider": 84, "stm32_stamp_bits": 32, "stm32_stamp_start_us": 4_294_000_000},
        ),
        ("lossy", {"stm32_ppm": 2000, "uart2_drop": 0.01, "uart2_flip": 0.01, "seed": 3}),
        ("paper", {"stm32_ppm": -50}),
        ("nanocockpit", {"stm32_walk_ppb": 500}),
    ],
)
def test_the_image_s_bytes_and_times_are_the_native_app_s(
    image: images.Image, scenario: str, settings: dict[str, Any]
) -> None:
    native = traced(None, scenario, 2, **settings)
    emulated = traced(image, scenario, 2, **settings)
    for number, (theirs, ours) in enumerate(zip(native, emulated, strict=False)):
        assert theirs == ours, f"run {number} of {len(native)}, {scenario} {settings}"
    assert len(native) == len(emulated) > 500


def test_what_cannot_be_emulated_is_refused(image: images.Image) -> None:
    world = World("hover")
    api = unicorn.table()
    for robot, mcu in ((1, lib.MCU_STM32), (0, lib.MCU_ESP32), (0, lib.MCU_GAP8)):
        assert lib.kernel_emulate(world.kernel, robot, mcu, api, image.pointer) == lib.KERNEL_ERR_CONFIG
    world.run(0.01)
    assert lib.kernel_emulate(world.kernel, 0, lib.MCU_STM32, api, image.pointer) == lib.KERNEL_ERR_CONFIG


def test_a_fault_ends_the_world_and_says_where(image: images.Image) -> None:
    world = World("hover")
    broken = ffi.new("image_t *", image.pointer[0])
    broken.board_config_bytes -= 8
    assert lib.kernel_emulate(world.kernel, 0, lib.MCU_STM32, unicorn.table(), broken) == 0
    for _ in range(2):
        with pytest.raises(PeerError, match=r"robot 0, stm32, .* the image's board_config has"):
            world.run(0.5)
