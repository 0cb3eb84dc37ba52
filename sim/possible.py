"""Values of a scenario that are possible alone and impossible together."""

from __future__ import annotations

from collections.abc import Sequence

from host.protocol.errors import LocalError

from .keys import plain
from .settings import General, RobotSettings, Usd

FRAME_PERIOD_S_MAX = 10
BEACON_PERIOD_S_MAX = 100
MOCAP_PERIOD_S_MAX = 1000
CRTP_PERIOD_S_MAX = 1000
"""In the STM32's configuration it has 32 bits of microseconds."""


def check_general(general: General, robots: Sequence[RobotSettings]) -> None:
    """LocalError, as of all here."""
    if general.robot >= general.robots:
        raise LocalError(f"robot={general.robot}: robots={general.robots}, so it may be 0 .. {general.robots - 1}")
    if 0 < general.beacon_hz < 1 / BEACON_PERIOD_S_MAX:
        raise LocalError(
            f"beacon_hz={plain(general.beacon_hz)}: allowed is 0, or {plain(1 / BEACON_PERIOD_S_MAX)} and more"
        )
    if general.beacon_hz and any(robot.backend == "emulated" for robot in robots):
        raise LocalError("beacon_hz with backend=emulated: the image has no radio")


def check_robot(robot: RobotSettings) -> None:
    for name in ("stm32", "gap8", "esp32"):
        clock = getattr(robot, name)
        if clock.stamp_start_us >> clock.stamp_bits:
            raise LocalError(
                f"{name}_stamp_start_us={clock.stamp_start_us}: allowed is 0 .. 2^{clock.stamp_bits} - 1, "
                f"as {name}_stamp_bits={clock.stamp_bits}"
            )
    if robot.backend == "emulated" and robot.stm32.quantum != "1us":
        raise LocalError(
            f"stm32_quantum={robot.stm32.quantum} with backend=emulated: the image's timer counts single us"
        )
    if robot.firmware == "stock" and robot.wire == "uart1":
        raise LocalError("wire=uart1 with firmware=stock: stock firmware sends no stamps, so nothing would ever come")
    if 0 < robot.crtp.hz < 1 / CRTP_PERIOD_S_MAX:
        raise LocalError(f"crtp_hz={plain(robot.crtp.hz)}: allowed is 0, or {plain(1 / CRTP_PERIOD_S_MAX)} and more")
    check_card(robot.usd)
    camera = robot.camera
    if robot.firmware == "nanocockpit" and robot.wire == "uart2":
        raise LocalError("wire=uart2 with firmware=nanocockpit: its ESP32 does not listen to UART2")
    if robot.firmware == "nanocockpit" and camera.encoding == "jpeg":
        raise LocalError("camera_encoding=jpeg with firmware=nanocockpit: it sends raw pictures only")
    if camera.fps == 0:
        return
    if camera.burst / camera.fps > FRAME_PERIOD_S_MAX:
        raise LocalError(
            f"camera_fps={plain(camera.fps)}: allowed is 0, or {plain(camera.burst / FRAME_PERIOD_S_MAX)} and more "
            f"with camera_burst={camera.burst}"
        )
    capture_s = (camera.height + camera.exposure_lines) * camera.line_time_ns * 1e-9
    if camera.fps * capture_s > 1:
        raise LocalError(
            f"camera_fps={plain(camera.fps)}: allowed is 0 .. {1 / capture_s:.2f}, as {camera.height} rows and "
            f"{camera.exposure_lines} lines of exposure take {capture_s * 1e3:.1f} ms"
        )


def check_card(usd: Usd) -> None:
    """Of a robot."""
    if 0 < usd.mocap_hz < 1 / MOCAP_PERIOD_S_MAX:
        raise LocalError(
            f"usd_mocap_hz={plain(usd.mocap_hz)}: allowed is 0, or {plain(1 / MOCAP_PERIOD_S_MAX)} and more"
        )
    if usd.image and not usd.config:
        raise LocalError(f"usd_image={usd.image}: there is no card without usd_config")
    if usd.stall_ms and not usd.stall_ms <= usd.stall_p99_ms <= usd.stall_max_ms:
        raise LocalError(
            f"usd_stall_ms={plain(usd.stall_ms)}, usd_stall_p99_ms={plain(usd.stall_p99_ms)}, "
            f"usd_stall_max_ms={plain(usd.stall_max_ms)}: each must be at least the one before"
        )
    if usd.free_mb > usd.size_mb:
        raise LocalError(f"usd_free_mb={usd.free_mb}: the card has usd_size_mb={usd.size_mb}")
