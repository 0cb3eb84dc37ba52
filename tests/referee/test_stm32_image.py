"""The STM32's board under QEMU sends, byte for byte, what the simulated STM32 sends for the same bytes on UART2.

In the image is all that the board consists of (start-up, clocks, drivers, interrupts, service loop), but for the alarm:
netduinoplus2/alarm.c says why. QEMU has no baud rate: a byte takes no time, so the simulator's UARTs are as fast here.
By hand, with any scenario and keys:

    python tests/referee/test_stm32_image.py lossy 2 seed=7
"""

import random
import sys
import tempfile
from pathlib import Path
from typing import Any

import machines
import pytest
import recording
import stm32_board
from stm32_board import Inputs, Streams

from host.firmware.build import build
from host.native import ffi, lib
from host.protocol.codec import encode_cpx_tcp
from host.protocol.packets import CpxPacket, Route
from sim import configure
from sim.scenario import from_url
from sim.world import World

SECONDS = 1.0
ALL_ALONE_NS = 3600 * 10**9
"""The other MCUs boot only then: what they would say is in the inputs."""
FAST_PS = 1000
CASES = [
    "hover?seed=1&crtp_hz=100&stm32_stamp_start_us=4294500000&stm32_stamp_bits=32",
    "lossy?seed=7&uart2_flip=0.002&uart2_drop=0.002&crtp_hz=50",
    "paper?seed=3&pose_sway_m=0.5&pose_yaw_deg=30",
    "nanocockpit?seed=4&pose_sway_m=0.5&nanocockpit_clock=us",
    "hover?wire=uart1&stm32_divider=84",
]
TALK_S = 0.02
STAMP_US = 10_000
PLAIN_STAMPS = 12
"""Each comes twice as late as the one before."""
BUSY_US = 500
"""No byte comes so shortly before or after a deadline of the app: QEMU's code takes time, the simulator's none."""
BYTE_US = 30
"""And has so long for each byte that it gets, sends or skips."""
PACKET_US = 500
"""And for each packet, good or bad: after a bad one it searches on in all its bytes."""


def wished(url: str) -> Any:
    """robot_config_t of the STM32 alone, without drift."""
    config = configure.robot_config(from_url(f"sim://{url}").robots[0])
    clock = config.clocks[lib.MCU_STM32]
    clock.boot_ns = clock.rate_ppb = clock.ramp_ppb = clock.walk_ppb = 0
    for mcu in (lib.MCU_GAP8, lib.MCU_ESP32):
        config.clocks[mcu].boot_ns = ALL_ALONE_NS
    for wire in range(lib.WIRE_COUNT):
        config.wires[wire] = ffi.new("wire_faults_t *")[0]
    config.uart1_byte_ps = config.uart1_gap8_byte_ps = config.uart2_stm32_byte_ps = FAST_PS
    if clock.divider == 84:
        config.stm32.stamp_period_us = 8500  # whole ticks of 84/85 us: QEMU's two clocks have no common fraction
        config.stm32.wifi_mode = 0
    return config


def heard(url: str, seconds: float) -> list[tuple[int, int]]:
    """What the ESP32 and the faults of the wire say to the STM32 in a run of the whole robot, with a host that wants
    CRTP and many an echo."""
    steady = {"stm32_ppm": 0, "stm32_walk_ppb": 0, "stm32_ramp_ppm": 0, "wifi_up_ms": 50}
    with World(from_url(f"sim://{url}").changed(steady)) as world:
        recording.begin(world, "stm32")
        robot = world.listen()
        lengths = random.Random(world.scenario.seed)
        while world.seconds < seconds:
            robot.run(TALK_S)
            echo = bytes([lib.TEST_ECHO, *lengths.randbytes(lengths.randrange(90))])
            for function, data in ((lib.CPX_SYSTEM, bytes([lib.SYSTEM_BRIDGE, 1])), (lib.CPX_TEST, echo)):
                world.robots[0].write(encode_cpx_tcp(CpxPacket(Route(lib.CPX_STM32, lib.CPX_HOST, function), data)))
        calls = recording.take(world, "stm32").calls
    received = (call for call in calls if call.verb == lib.CALL_RECEIVE and call.port == lib.STM32_PORT_UART2)
    return [(call.up_us, byte) for call in received for byte in call.data]


def simulated(config: Any, wishes: list[tuple[int, int]], end_us: int) -> tuple[Inputs, Streams]:
    """What the STM32 alone sends. Where QEMU's would be busy, each byte of `wishes` comes to both a little later."""
    kernel = lib.kernel_new(1)
    given: list[tuple[int, int]] = []
    try:
        assert lib.kernel_add_robot(kernel, config) == 0
        assert lib.kernel_trace(kernel, lib.TRACE_FULL) == 0
        at_us = done_us = 0
        for wish_us, byte in wishes:
            at_us = quiet_us(kernel, max(at_us + BYTE_US, wish_us), end_us)
            before_us, done_us = done_us, work_us(kernel)
            at_us = quiet_us(kernel, at_us + done_us - before_us, end_us)
            if at_us + BUSY_US > end_us:
                break
            given.append((at_us, byte))
            assert lib.kernel_inject(kernel, 0, lib.WIRE_UART2_TO_STM32, bytes([byte]), 1) == 0
        assert lib.kernel_run(kernel, end_us * 1000, -1, 0) == 0
        count, size = ffi.new("size_t *"), ffi.new("size_t *")
        runs = ffi.unpack(lib.kernel_trace_runs(kernel, count), count[0])
        data = bytes(ffi.buffer(lib.kernel_trace_data(kernel, size), size[0]))
        uart1, uart2 = (
            b"".join(data[run.offset : run.offset + run.length] for run in runs if run.wire == wire)
            for wire in (lib.WIRE_UART1, lib.WIRE_UART2_TO_ESP32)
        )
    finally:
        lib.kernel_free(kernel)
    return Inputs(tuple(given), end_us), Streams(uart1, uart2)


def work_us(kernel: Any) -> int:
    """What the STM32 has done since it started, as time that QEMU's may take for it."""
    uart2 = lib.kernel_stm32(kernel, 0).uart2
    packets = uart2.packets_in + uart2.bad_check + uart2.bad_length + uart2.bad_version + uart2.gaps
    sent = lib.kernel_wire_counts(kernel, 0, lib.WIRE_UART2_TO_ESP32).bytes
    return int(packets * PACKET_US + (sent + uart2.garbage_bytes) * BYTE_US)


def quiet_us(kernel: Any, at_us: int, end_us: int) -> int:
    """Lets time pass to the first uptime from then on that is far from what the STM32 does by itself; to the end, if
    that is later."""
    while (due_us := lib.stm32_deadline(lib.kernel_stm32(kernel, 0))) <= min(at_us, end_us) + BUSY_US:
        if due_us > end_us or due_us * 1000 <= lib.kernel_now_ns(kernel):
            break
        at_us = max(at_us, due_us + BUSY_US)
        assert lib.kernel_run(kernel, due_us * 1000, -1, 0) == 0
    assert lib.kernel_run(kernel, min(at_us, end_us) * 1000, -1, 0) == 0
    return at_us


def difference(url: str, seconds: float, folder: Path) -> tuple[str | None, Streams]:
    """The first byte in which QEMU differs, and what the simulator says."""
    config = wished(url)
    clock = config.clocks[lib.MCU_STM32]
    # While it waits for a byte the stamp clock cannot stand still to the 85th of a microsecond.
    wishes = heard(url, seconds) if clock.divider == 85 else []
    inputs, expected = simulated(config, wishes, round(seconds * 1e6) // STAMP_US * STAMP_US + STAMP_US // 2)
    board = stm32_board.board_config(config.stm32, clock.stamp_start_us, clock.stamp_bits, clock.divider)
    got = stm32_board.run(stm32_board.link(board, inputs, folder), inputs)
    for name in ("uart1", "uart2"):
        if found := machines.first_difference(getattr(got, name), getattr(expected, name)):
            return f"{name}, {found[1]}", expected
    return None, expected


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("image")


@pytest.mark.parametrize("url", CASES)
def test_qemu_sends_what_the_simulator_sends(url: str, folder: Path) -> None:
    if reason := machines.missing("stm32"):
        pytest.skip(reason)
    within = folder / f"case{CASES.index(url)}"
    within.mkdir()
    found, expected = difference(url, SECONDS, within)
    if found:
        name, _, keys = url.partition("?")
        pytest.fail(f"{found}\npython tests/referee/{Path(__file__).name} {name} {SECONDS} {keys.replace('&', ' ')}")
    assert len(expected.uart1) > 1000


def test_the_image_as_it_is_boots_and_sends_stamps() -> None:
    """Its alarms come late in QEMU, so the native app is asked at the times that the stamps say."""
    if reason := machines.missing("stm32"):
        pytest.skip(reason)
    pytest.importorskip("elftools", reason="pyelftools is not installed")
    got = stm32_board.run_plain(build("stm32", "gcc").elf, PLAIN_STAMPS * lib.STAMP_BYTES)
    app, config = ffi.new("stm32_t *"), ffi.new("stm32_config_t *")
    expected = b""
    for offset in range(0, len(got), lib.STAMP_BYTES):
        now_us = int.from_bytes(got[offset + 6 : offset + 14], "little")
        now = {"up_us": now_us, "stamp_us": now_us}
        if offset == 0:
            assert lib.stm32_init(app, config, now) == 0
        out = ffi.new("uint8_t *")
        while lib.stm32_transmit(app, lib.STM32_PORT_UART1, {"data": out, "size": 1}, now):
            expected += bytes([out[0]])
    assert len(got) == PLAIN_STAMPS * lib.STAMP_BYTES
    assert machines.first_difference(got, expected) is None


def main(name: str, seconds: str, *keys: str) -> int:
    with tempfile.TemporaryDirectory() as made:
        within = Path(made) / "case"
        within.mkdir()
        found, expected = difference(f"{name}?{'&'.join(keys)}" if keys else name, float(seconds), within)
    print(found or f"equal: {len(expected.uart1)} bytes on UART1, {len(expected.uart2)} on UART2")
    return found is not None


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
