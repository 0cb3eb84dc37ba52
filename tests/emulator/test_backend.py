"""backend=emulated as users meet it: worlds, counters, logs, faults, and what is said when something is missing."""

import importlib.util
import re
import shutil
import sys
from pathlib import Path
from typing import Any

import pytest
from backend import needs

from host.firmware import toolchains
from host.firmware.build import build
from host.firmware.elf import opened, read
from host.native import lib
from host.protocol.codec import encode_cpx_tcp
from host.protocol.errors import LocalError, PeerError
from host.protocol.packets import CpxPacket, Route
from host.usd.cardimage import CardImage
from sim import scenario
from sim.world import World

SMALL: dict[str, Any] = {"camera_width": 64, "camera_height": 48}
CARDS: dict[str, Any] = {"camera_fps": 0, "usd_config": "full", "usd_size_mb": 64}
BREAKPOINT = bytes.fromhex("01be")


@pytest.fixture(autouse=True)
def _needs() -> None:
    needs()


def broken(tmp_path: Path, function: str) -> Path:
    """The STM32's image with a breakpoint where that function begins."""
    made = build("stm32")
    address = next(each.address for each in read(made.elf).functions if each.name == function) & ~1
    data = bytearray(made.elf.read_bytes())
    with opened(made.elf) as elf:
        at = next(iter(elf.address_offsets(address)))
    data[at : at + 2] = BREAKPOINT
    path = tmp_path / "broken.elf"
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("toolchain", ["gcc", "zig"])
def test_frames_counters_and_truth_are_the_native_ones(toolchain: str) -> None:
    needs(toolchain)

    def seen(**settings: Any) -> tuple[Any, ...]:
        with World("lossy", uart2_drop=0.003, crtp_hz=20, seed=5, trace="hash", **SMALL, **settings) as world:
            robot = world.listen()
            world.run(6)
            frames = [(frame.native, bytes(frame.body)) for frame in robot.frames]
            return frames, robot.stm32, robot.gap8, robot.esp32, world.truth.tolist(), world.trace_hash()

    native = seen()
    assert len(native[0]) > 20
    assert native[2]["stamps_missed"] > 20
    assert seen(backend="emulated", toolchain=toolchain) == native


def test_each_robot_has_its_own_backend() -> None:
    made = scenario.from_url("sim://swarm?robots=3&backend=native,emulated,emulated&camera_width=64&camera_height=48")
    with World(made, trace="hash") as world:
        assert [robot.backends["gap8"] for robot in world.robots] == ["native", "emulated", "emulated"]
        assert [robot.backends["esp32"] for robot in world.robots] == ["native"] * 3
        assert [sorted(robot.stacks) for robot in world.robots] == [[], ["gap8", "stm32"], ["gap8", "stm32"]]
        world.run(2)
        assert all(robot.stm32["stamps_sent"] > 100 for robot in world.robots)
        assert all(100 < used < 8192 for robot in world.robots for used in robot.stacks.values())
        mixed = world.trace_hash()
    with World(made, trace="hash", backend="native") as world:
        world.run(2)
        assert world.trace_hash() == mixed


def test_counters_before_the_first_boot_are_zero_and_after_a_reboot_start_anew() -> None:
    with World("hover", backend="emulated", stm32_boot_ms=1000, **SMALL) as world:
        robot = world.robots[0]
        world.run(0.5)
        assert set(robot.stm32.values()) == {0}
        with pytest.raises(LocalError, match="has no radio"):
            robot.radio(b"\xd2")
        world.run(1.5)
        assert robot.stm32["stamps_sent"] == 100
        robot.reboot("stm32", 0.5)
        world.run(0.7)
        assert robot.stm32["stamps_sent"] in (20, 21)


def test_a_log_repeats_the_run() -> None:
    with World("hover", backend="emulated", trace="hash", **SMALL) as world:
        robot = world.listen()
        world.run(1.5)
        robot.reboot("gap8", 0.1)
        robot.inject("uart1", b"noise")
        world.run(1.5)
        with World.replay(world.log) as again:
            assert again.robots[0].backends == robot.backends
            assert again.trace_hash() == world.trace_hash()


def test_a_fault_ends_the_run_with_registers_pc_and_function(tmp_path: Path) -> None:
    with World("hover", images={"stm32": broken(tmp_path, "stm32_receive")}, **SMALL) as world:
        assert world.robots[0].backends == {"stm32": "emulated", "gap8": "native", "esp32": "native"}
        for _ in range(2):
            with pytest.raises(PeerError) as error:
                world.run(2)
        said = str(error.value)
        assert said.startswith("robot 0, stm32, 0.0")
        assert "breakpoint; pc=0x" in said
        assert " (stm32_receive) " in said
        assert all(f" {register}=0x" in said for register in ("lr", "sp", "xpsr", "r0", "r12"))
        assert re.search(r" lr=0x[0-9a-f]+ \(service\+", said), "without a card, its first answer comes at once"


def test_threads_change_nothing() -> None:
    def seen(threads: int) -> tuple[Any, ...]:
        with World("hover", backend="emulated", robots=4, trace="hash", uart1_loss=0.1, **CARDS) as world:
            lib.kernel_set_threads(world.kernel, threads)
            world.run(1.5)
            cards = [dict(robot.card.sectors.sectors) for robot in world.robots if robot.card]
            return world.trace_hash(), cards, [(robot.log, robot.stm32, robot.gap8) for robot in world.robots]

    alone = seen(1)
    assert all(log["status"] == "on" and log["accepted"] > 500 for log, _, _ in alone[2])
    assert len({gap8["stamp_rx_received"] for _, _, gap8 in alone[2]}) > 1
    assert seen(4) == alone


@pytest.mark.parametrize("threads", [1, 4])
def test_an_image_that_fails_costs_no_card(threads: int, tmp_path: Path) -> None:
    images = {"stm32": broken(tmp_path, "stm32_crtp")}
    world = World("hover", images=images, robots=4, usd_image=str(tmp_path / "card.img"), **CARDS)
    lib.kernel_set_threads(world.kernel, threads)
    ill = world.robots[2]
    ill.connect()
    world.run(1)
    assert {robot.log["status"] for robot in world.robots} == {"on"}
    ill.write(encode_cpx_tcp(CpxPacket(Route(lib.CPX_STM32, lib.CPX_HOST, lib.CPX_CRTP), b"\xff")))
    with pytest.raises(PeerError, match=r"^robot 2, stm32, .*breakpoint; .* \(stm32_crtp\) "):
        world.run_until(3_000_000_000, robot=2, size=1 << 20)
    failed_ns = world.now_ns
    assert 1_000_000_000 < failed_ns < 1_100_000_000
    stamps = [robot.stm32["stamps_sent"] for robot in world.robots]
    assert max(stamps) - min(stamps) <= 1, "all run no longer than the one that is waited for"
    with pytest.raises(PeerError, match="robot 2, stm32"):
        world.close()
    assert world.closed
    saved = [CardImage((tmp_path / f"card.{robot}.img").read_bytes()) for robot in range(4)]
    assert all(len(card.read(card.find("log00")).data) > 10_000 for card in saved)


def test_an_image_with_two_symbols_of_a_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "twins.elf"
    path.write_bytes(build("stm32").elf.read_bytes().replace(b"\0board_init_result\0", b"\0board_stamp_reset\0"))
    with pytest.raises(LocalError, match=r"twins\.elf has 2 symbols called board_stamp_reset instead of one"):
        World("hover", images={"stm32": path})


def test_an_image_for_another_mcu_is_refused() -> None:
    with pytest.raises(LocalError, match=r"stm32\.elf is an image for the stm32, not for the gap8"):
        World("hover", images={"gap8": build("stm32").elf})


def test_all_that_is_missing_is_said_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda *_, **__: None)
    monkeypatch.setattr(toolchains, "zig_program", lambda: None)
    from sim import unicorn

    unicorn.table.cache_clear()
    monkeypatch.setitem(sys.modules, "unicorn", None)
    with pytest.raises(LocalError) as error:
        World("hover", backend="emulated")
    said = str(error.value)
    for hint in ("gcc-arm-none-eabi", "gcc-riscv64-unknown-elf", "spindeck[firmware]", "spindeck[emulator]"):
        assert hint in said, said
    assert "\n" not in said


def test_a_toolchain_that_is_not_there_is_named() -> None:
    if importlib.util.find_spec("ziglang"):
        pytest.skip("zig is here")
    with pytest.raises(LocalError, match=r"backend=emulated: no compiler for the stm32: install zig"):
        World("hover", backend="emulated", toolchain="zig")
