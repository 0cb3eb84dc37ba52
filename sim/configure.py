"""Settings in units for people, into the kernel's configuration in integers.

UART speeds are what the dividers really give. STM32: USART2 and USART3 run from APB1 at 42 MHz and divide by
BRR/16 with 16-fold oversampling (RM0090, 30.3.4): 115200 Bd is asked for and 365/16 = 22.8125 gives 115068 Bd,
576000 Bd is asked for and 73/16 = 4.5625 gives 575342 Bd. The ESP32's divider has a fraction fine enough to be exact.
"""

from __future__ import annotations

import math
import zlib
from typing import Any

from host.native import ffi, lib
from host.protocol.errors import LocalError

from .settings import Camera, Clock, Paper, Pose, RobotSettings, Wire

APB1_HZ = 42_000_000
UART1_DIVISOR = 365
GAP8_HZ = 50_000_000
UART1_GAP8_DIVISOR = 434
UART2_DIVISOR = 73
UART2_BAUD = 576_000
BITS_PER_BYTE = 10
"""Start, eight bits, stop."""

ECHO_PERIOD_US = 1_000_000
"""As in the board's own settings."""
HOST_SPARE_BYTES = 32 << 10

QUANTA = {"1us": lib.QUANTUM_1US, "rtc": lib.QUANTUM_RTC, "1ms": lib.QUANTUM_1MS}
TICK_NS = {"1us": 1000, "rtc": round(1e9 / 32768), "1ms": 1_000_000}
FIRMWARE = {
    "native": lib.GAP8_NATIVE,
    "stock": lib.GAP8_STOCK,
    "paper": lib.GAP8_PAPER,
    "nanocockpit": lib.GAP8_NANOCOCKPIT,
}
HOST_WIRES = {"tcp": lib.HOST_TCP, "uart2": lib.HOST_UART2, "uart1": lib.HOST_UART1}
WIRES = {
    "uart1": (lib.WIRE_UART1, lib.WIRE_UART1_TO_STM32),
    "uart2": (lib.WIRE_UART2_TO_ESP32, lib.WIRE_UART2_TO_STM32),
    "spi": (lib.WIRE_SPI_TO_ESP32, lib.WIRE_SPI_TO_GAP8),
    "tcp": (lib.WIRE_TCP_TO_HOST, lib.WIRE_TCP_TO_ESP32),
    "uart1_to_gap8": (lib.WIRE_UART1,),
    "uart1_to_stm32": (lib.WIRE_UART1_TO_STM32,),
    "uart2_to_esp32": (lib.WIRE_UART2_TO_ESP32,),
    "uart2_to_stm32": (lib.WIRE_UART2_TO_STM32,),
    "spi_to_esp32": (lib.WIRE_SPI_TO_ESP32,),
    "spi_to_gap8": (lib.WIRE_SPI_TO_GAP8,),
    "tcp_to_host": (lib.WIRE_TCP_TO_HOST,),
    "tcp_to_esp32": (lib.WIRE_TCP_TO_ESP32,),
}
"""By name; the name of a whole link means both directions, the one towards the host first."""
WIRE_SETTINGS = ("uart1", "uart2", "uart2", "uart1", "spi", "spi", "tcp", "tcp")
"""Whose faults each has, by wire_t."""

NEVER_US = 0xFFFFFFFF
WIFI_NAME = b"spindeck"
ACCESS_POINT = 1
PACKET_BODY_BYTES = 1012
PACKET_HEAD_BYTES = 12
FRAME_HEAD_BYTES = 256
"""Upper bounds of what the native dialect adds to a body (firmware/core/image.h), for a size check only."""


def unread_bytes_max(robot: RobotSettings) -> int:
    """What a host may leave unread before TCP's window begins to close: all that is under way at once, and some."""
    return robot.tcp.window + HOST_SPARE_BYTES


def nanoseconds(value: float, unit_ns: float) -> int:
    return round(value * unit_ns)


def clock(settings: Clock) -> dict[str, int]:
    """clock_config_t."""
    return {
        "boot_ns": nanoseconds(settings.boot_ms, 1e6),
        "rate_ppb": rate_ppb(settings.ppm),
        "ramp_ppb": rate_ppb(settings.ramp_ppm),
        "ramp_ns": nanoseconds(settings.ramp_s, 1e9),
        "step_ppb": rate_ppb(settings.step_ppm),
        "step_ns": nanoseconds(settings.step_s, 1e9),
        "walk_ppb": settings.walk_ppb,
        "stamp_start_us": settings.stamp_start_us,
        "stamp_bits": settings.stamp_bits,
        "quantum": QUANTA[settings.quantum],
        "divider": getattr(settings, "divider", 85),
    }


def rate_ppb(ppm: float) -> int:
    return round(ppm * 1000)


def faults(wire: Wire) -> dict[str, float]:
    """wire_faults_t."""
    return {
        "latency_ns": nanoseconds(wire.latency_us, 1e3),
        "jitter_ns": nanoseconds(wire.jitter_us, 1e3),
        "loss": wire.loss,
        "duplicate": getattr(wire, "duplicate", 0.0),
        "reorder": getattr(wire, "reorder", 0.0),
        "drop": wire.drop,
        "flip": wire.flip,
        "burst_per_s": wire.burst_per_s,
        "burst_ns": nanoseconds(wire.burst_ms, 1e6),
        "stall_per_s": wire.stall_per_s,
        "stall_ns": nanoseconds(wire.stall_ms, 1e6),
    }


def frame_latency_us(camera: Camera) -> int:
    """What somebody who measured this robot would tell its GAP8: by then 99 % of the interrupts have been served."""
    return math.ceil(camera.jitter_us * math.log(100))


def stamp_format(robot: RobotSettings) -> int:
    """stm32_stamp_format_t."""
    if robot.firmware == "nanocockpit":
        return int(lib.STM32_NANOCOCKPIT if robot.nanocockpit.clock == "ticks" else lib.STM32_NANOCOCKPIT_US)
    return int(lib.STM32_PAPER if robot.firmware == "paper" else lib.STM32_NATIVE)


def pose(settings: Pose) -> dict[str, float]:
    """pose_t."""
    half = math.radians(settings.yaw_deg) / 2
    place = {"x_m": settings.x_m, "y_m": settings.y_m, "z_m": settings.z_m}
    return {**place, "qx": 0.0, "qy": 0.0, "qz": math.sin(half), "qw": math.cos(half)}


def paper_set_right(settings: Paper) -> int:
    """gap8_config_t.paper."""
    right = {
        lib.GAP8_PAPER_UNFLOORED: settings.floor == "no",
        lib.GAP8_PAPER_FIRST_BYTE: settings.arrival == "first",
        lib.GAP8_PAPER_MIDDLE: settings.instant == "middle",
        lib.GAP8_PAPER_OVERLAP: settings.turns == "no",
    }
    return sum(flag for flag, chosen in right.items() if chosen)


def check_body(camera: Camera) -> None:
    """A raw frame that the ESP32 could never take whole would be dropped every time."""
    body = camera.width * camera.height
    needed = body + -(-body // PACKET_BODY_BYTES) * PACKET_HEAD_BYTES + FRAME_HEAD_BYTES
    if camera.fps and camera.encoding == "raw" and needed > lib.ESP32_IMAGE_BYTES:
        raise LocalError(
            f"camera_width={camera.width}, camera_height={camera.height}: a raw frame takes {needed} bytes and the "
            f"ESP32's image buffer has {lib.ESP32_IMAGE_BYTES}: smaller pictures, or camera_encoding=jpeg"
        )


def log_seed(seed: int, index: int) -> int:
    """Of the sessions of a robot's logs, in the place of its MCU's unique id."""
    return zlib.crc32(b"%d robot %d" % (seed, index))


def card_seed(seed: int, index: int) -> int:
    """Of what happens to a robot's card."""
    return zlib.crc32(b"%d card %d" % (seed, index))


def robot_config(robot: RobotSettings, seed: int = 0, index: int = 0) -> Any:
    """robot_config_t, of the robot of that number in a world of that seed."""
    check_body(robot.camera)
    camera = robot.camera
    on_uart2 = robot.wire == "uart2"
    nanocockpit = robot.firmware == "nanocockpit"
    config = {
        "clocks": [clock(robot.stm32), clock(robot.gap8), clock(robot.esp32)],
        "wires": [faults(getattr(robot, name)) for name in WIRE_SETTINGS],
        "stm32": {
            "stamp_format": stamp_format(robot),
            "pose": pose(robot.pose),
            "sway_m": robot.pose.sway_m,
            "stamp_period_us": NEVER_US if robot.firmware == "stock" else 0,
            "wifi_mode": 0 if on_uart2 or nanocockpit else ACCESS_POINT,
            "wifi_ssid": WIFI_NAME,
            "crtp_period_us": round(1e6 / robot.crtp.hz) if robot.crtp.hz else 0,
            "mocap_period_us": round(1e6 / robot.usd.mocap_hz) if robot.usd.mocap_hz else 0,
            "log": {"sync_us": round(robot.usd.sync_ms * 1e3), "seed": log_seed(seed, index)},
        },
        "gap8": {
            "width": camera.width if camera.fps else 0,
            "height": camera.height if camera.fps else 0,
            "line_time_ns": camera.line_time_ns,
            "camera": {
                "analog_gain": camera.analog_gain,
                "digital_gain": camera.digital_gain,
                "burst": camera.burst,
                "encoding": lib.IMAGE_JPEG if camera.encoding == "jpeg" else lib.IMAGE_RAW,
                "exposure_lines": camera.exposure_lines,
                "frame_period_us": round(camera.burst * 1e6 / camera.fps) if camera.fps else 0,
            },
            "stamp_tick_ns": TICK_NS[robot.gap8.quantum],
            "frame_latency_us": frame_latency_us(camera),
            "echo_period_us": ECHO_PERIOD_US,
            "stamp_bits": robot.gap8.stamp_bits,
            "firmware": FIRMWARE[robot.firmware],
            "paper": paper_set_right(robot.paper),
            "nanocockpit_check": robot.nanocockpit.check == "yes",
            # Nobody announces a Wi-Fi client on a wire that has no Wi-Fi, and NanoCockpit's ESP32 never does.
            "stream_always": on_uart2 or nanocockpit,
        },
        "esp32": {"host_on_uart": on_uart2, "bridge": nanocockpit},
        "uart1_byte_ps": round(BITS_PER_BYTE * UART1_DIVISOR * 1e12 / APB1_HZ),
        "uart1_gap8_byte_ps": round(BITS_PER_BYTE * UART1_GAP8_DIVISOR * 1e12 / GAP8_HZ),
        "uart2_stm32_byte_ps": round(BITS_PER_BYTE * UART2_DIVISOR * 1e12 / APB1_HZ),
        "uart2_esp32_byte_ps": round(BITS_PER_BYTE * 1e12 / UART2_BAUD),
        "spi_byte_ps": round(8e12 / robot.spi.hz),
        "spi_gap_ns": nanoseconds(robot.spi.gap_us, 1e3),
        "tcp_byte_ps": round(1e12 / robot.tcp.bytes_per_s),
        "tcp_window_bytes": robot.tcp.window,
        "tcp_rto_ns": nanoseconds(robot.tcp.rto_ms, 1e6),
        "network_up_ns": nanoseconds(robot.wifi.up_ms, 1e6),
        "camera_frame_ns": camera.height * camera.line_time_ns,
        "camera_jitter_ns": nanoseconds(camera.jitter_us, 1e3),
        "camera_fail": camera.fail,
        "camera_hang": camera.hang,
        "host_wire": HOST_WIRES[robot.wire],
        "host_ring_bytes": unread_bytes_max(robot) + robot.tcp.window,
    }
    return ffi.new("robot_config_t *", config)
