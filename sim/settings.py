"""Every scenario key: its type, unit, allowed range, default and meaning, each said once, as dataclass fields.

Parsing, refusals and docs/SCENARIOS.md are made from these fields (sim.keys). A field of the class for table
`gap8` is the key `ppm` under `[gap8]` in TOML, and `gap8_ppm` in a URL or as a keyword.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

Number = int | float
Scalar = int | float | str


def number(default: Number, low: Number, high: Number, unit: str, meaning: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "unit": unit, "meaning": meaning})


def probability(of: str) -> Any:
    return number(0, 0, 1, "", f"probability that {of}")


def choice(default: Scalar, meaning: str, unit: str = "") -> Any:
    """The choices are those of the field's Literal type."""
    return field(default=default, metadata={"unit": unit, "meaning": meaning})


def text(meaning: str) -> Any:
    return field(default="", metadata={"unit": "", "meaning": meaning})


@dataclass(frozen=True, slots=True)
class General:
    """The world as a whole."""

    seed: int = number(1, 0, 2**64 - 1, "", "of everything random; the same seed gives the same bytes")
    robots: int = number(1, 1, 256, "", "how many robots fly")
    robot: int = number(0, 0, 255, "", "which of them this port belongs to, counted from 0")
    beacon_hz: float = number(0, 0, 100, "1/s", "beacons by which a host tells all robots its time, by radio; 0: none")
    reset_s: float = number(
        0, 0, 1_000_000, "s", "when a broadcast by radio sets all STM32 stamp clocks to 0; 0: never"
    )
    reset_repeats: int = number(1, 1, 100, "", "times that it is sent, 1 ms apart")
    pace: Literal["real", "max"] = choice("real", "of a sim:// port: not ahead of wall time, or as fast as it goes")


@dataclass(frozen=True, slots=True)
class Clock:
    ppm: float = number(0, -20000, 20000, "ppm", "rate error of the oscillator")
    ramp_ppm: float = number(0, -1000, 1000, "ppm", "warm-up: added to the rate linearly over ramp_s, then kept")
    ramp_s: float = number(60, 0, 3600, "s", "length of the warm-up")
    step_ppm: float = number(0, -5000, 5000, "ppm", "added to the rate at once, at step_s: a PLL locks anew")
    step_s: float = number(30, 0, 1_000_000, "s", "when: in simulated time since the MCU first started")
    walk_ppb: int = number(0, 0, 1_000_000, "ppb", "standard deviation, after 1 s, of the rate's random walk")
    boot_ms: float = number(0, 0, 600_000, "ms", "when the MCU starts")
    stamp_start_us: int = number(0, 0, 2**52, "us", "first reading of the stamp clock, below 2^stamp_bits")
    stamp_bits: Literal[32, 48, 64] = choice(64, "width of the stamp clock: where it wraps", "bits")
    quantum: Literal["1us", "rtc", "1ms"] = choice("1us", "step of the stamp clock; rtc is 1/32768 s")


@dataclass(frozen=True, slots=True)
class Stm32Clock(Clock):
    divider: Literal[84, 85] = choice(85, "85 counts right; 84 runs at 84/85, as firmware did until August 2026")


@dataclass(frozen=True, slots=True)
class Wire:
    """A unit is a run of back-to-back bytes on a UART, one direction of a window on SPI, a segment on TCP."""

    latency_us: float = number(0, 0, 10_000_000, "us", "added to every unit")
    jitter_us: float = number(0, 0, 10_000_000, "us", "mean of an exponential delay added to every unit")
    loss: float = probability("a unit is lost; TCP sends it again")
    drop: float = probability("a byte is lost; on TCP damage that its checksum missed")
    flip: float = probability("one bit of a byte is inverted; on TCP likewise")
    burst_per_s: float = number(0, 0, 1000, "1/s", "how often a burst begins: all units in it are lost")
    burst_ms: float = number(0, 0, 60_000, "ms", "mean of a burst's exponential length")
    stall_per_s: float = number(0, 0, 1000, "1/s", "how often the wire stands still")
    stall_ms: float = number(0, 0, 60_000, "ms", "mean of a stall's exponential length")


@dataclass(frozen=True, slots=True)
class Spi(Wire):
    duplicate: float = probability("a unit comes twice")
    hz: int = number(10_000_000, 100_000, 30_000_000, "Hz", "bit clock, in GAP8 time")
    gap_us: float = number(20, 0, 10_000, "us", "handshake before each window")


@dataclass(frozen=True, slots=True)
class Uart(Wire):
    duplicate: float = probability("a unit comes twice")
    reorder: float = probability("a unit comes after the next one")


@dataclass(frozen=True, slots=True)
class Tcp(Wire):
    bytes_per_s: float = number(2_500_000, 1000, 1_000_000_000, "B/s", "speed of the wireless link")
    window: int = number(65535, 1440, 1 << 20, "B", "most that is under way to the host")
    rto_ms: float = number(250, 1, 60_000, "ms", "after which a lost segment is sent again")


@dataclass(frozen=True, slots=True)
class Camera:
    fps: float = number(10, 0, 250, "1/s", "frames per second, averaged over bursts; 0: no camera")
    width: int = number(324, 1, 1024, "pixels", "of the built-in pictures; those of `camera` bring their own size")
    height: int = number(244, 1, 1024, "pixels", "likewise")
    encoding: Literal["raw", "jpeg"] = choice("raw", "at boot; the host may change it")
    quality: int = number(80, 1, 95, "", "of JPEG")
    burst: int = number(1, 1, 3, "", "frames taken back to back")
    exposure_lines: int = number(100, 2, 65535, "lines", "exposure time")
    analog_gain: Literal[1, 2, 4, 8] = choice(1, "as reported in each native frame")
    digital_gain: int = number(64, 1, 255, "1/64", "likewise")
    line_time_ns: int = number(125_333, 1000, 10_000_000, "ns", "GAP8 time from row to row")
    jitter_us: float = number(0, 0, 1_000_000, "us", "mean of an exponential delay of the end-of-frame interrupt")
    fail: float = probability("a capture fails")
    hang: float = probability("a capture never ends")


@dataclass(frozen=True, slots=True)
class Wifi:
    up_ms: float = number(500, 0, 600_000, "ms", "from the STM32's command until the host can connect")


@dataclass(frozen=True, slots=True)
class Crtp:
    hz: float = number(0, 0, 1000, "1/s", "console packets of the STM32 while the host has the bridge on; 0: none")


@dataclass(frozen=True, slots=True)
class Radio:
    """What is broadcast to all robots, as this one hears it."""

    latency_us: float = number(250, 0, 1_000_000, "us", "from the host's antenna to the robot's task, at least")
    jitter_us: float = number(300, 0, 1_000_000, "us", "mean of an exponential delay added to that")
    loss: float = probability("it does not hear a broadcast")


@dataclass(frozen=True, slots=True)
class Pose:
    """What the STM32 says of itself; paper and nanocockpit firmware only."""

    x_m: float = number(0, -1000, 1000, "m", "where the robot hovers")
    y_m: float = number(0, -1000, 1000, "m", "likewise")
    z_m: float = number(1, -1000, 1000, "m", "likewise")
    yaw_deg: float = number(0, -360, 360, "degrees", "its heading")
    sway_m: float = number(0.5, 0, 1000, "m", "how far it goes to and fro along x, once in 4 s")


@dataclass(frozen=True, slots=True)
class Paper:
    """What the paper's firmware does, and how it would be right. Its tick of 1 ms is gap8_quantum."""

    floor: Literal["yes", "no"] = choice("yes", "the STM32's time is cut to ms before the elapsed time is added")
    arrival: Literal["last", "first"] = choice("last", "byte of a time message from which elapsed time counts")
    instant: Literal["end", "middle"] = choice(
        "end", "what the time is of: end of frame, or middle of exposure of the middle row; errors count from the end"
    )
    turns: Literal["yes", "no"] = choice("yes", "a burst is taken, then sent, then the next is taken; no: at once")


@dataclass(frozen=True, slots=True)
class Nanocockpit:
    clock: Literal["ticks", "us"] = choice("ticks", "time in the STM32's states; us: as crazyflie-firmware's example")
    check: Literal["no", "yes"] = choice("no", "buffers go with a CRC-32; as released they do not")


CONFIGS = {
    "state": "250 Hz of the state estimate, and poses of motion capture",
    "full": "1 kHz of 20 values, and poses",
}
"""The built-in texts of config.txt (sim/cards.py)."""


@dataclass(frozen=True, slots=True)
class Usd:
    """The card on which the STM32 logs. A stall is in each operation that writes."""

    config: str = text(
        "config.txt on it: a path, or " + ", ".join(f"`{name}` ({what})" for name, what in CONFIGS.items())
        + "; empty: no card"
    )  # fmt: skip
    sync_ms: float = number(250, 10, 60_000, "ms", "what is logged is safe from a power cut after so long")
    mocap_hz: float = number(100, 0, 1000, "1/s", "poses that motion capture sends to the robot; 0: none")
    size_mb: int = number(8192, 16, 32_768, "MB", "its size")
    free_mb: int = number(0, 0, 32_768, "MB", "room for logs; 0: all of it")
    stall_ms: float = number(2, 0, 1000, "ms", "median of the stalls, which are log-normal; 0: no stalls")
    stall_p99_ms: float = number(100, 0, 10_000, "ms", "1 % of the stalls are longer")
    stall_max_ms: float = number(500, 0, 60_000, "ms", "none is longer")
    bad: float = number(0, 0, 1, "", "share of its sectors that cannot be written")
    remove_s: float = number(0, 0, 1_000_000, "s", "true time at which it is pulled out; 0: never")
    image: str = text(
        "file for the card's image at the end, which must not exist; of several robots: `card.0.img` for `card.img`"
    )


@dataclass(frozen=True, slots=True)
class RobotSettings:
    """One robot. Any of these may be a list in a scenario: one value per robot."""

    wire: Literal["tcp", "uart2", "uart1"] = choice(
        "tcp", "where the host listens: TCP, UART2 in the STM32's place, or a tap on UART1's stamps"
    )
    firmware: Literal["native", "stock", "paper", "nanocockpit"] = choice(
        "native", "whose: this project's, Bitcraze's (no stamps on UART1), the dataset paper's, NanoCockpit's"
    )
    backend: Literal["native", "emulated"] = choice(
        "native",
        "what the STM32 and the GAP8 run: their apps compiled for this computer, or the real images, emulated by "
        "Unicorn; the bytes and times are equal. The ESP32 is native",
    )
    toolchain: Literal["auto", "gcc", "zig"] = choice(
        "auto", "what builds the images of backend=emulated; auto: gcc where it is installed, else zig"
    )
    camera_path: str = text("a PGM, PPM or PNG file, or a folder of them, instead of the built-in pictures")
    stm32: Stm32Clock = field(default_factory=Stm32Clock)
    gap8: Clock = field(default_factory=Clock)
    esp32: Clock = field(default_factory=Clock)
    uart1: Uart = field(default_factory=Uart)
    uart2: Uart = field(default_factory=Uart)
    spi: Spi = field(default_factory=Spi)
    tcp: Tcp = field(default_factory=Tcp)
    camera: Camera = field(default_factory=Camera)
    wifi: Wifi = field(default_factory=Wifi)
    crtp: Crtp = field(default_factory=Crtp)
    radio: Radio = field(default_factory=Radio)
    pose: Pose = field(default_factory=Pose)
    paper: Paper = field(default_factory=Paper)
    nanocockpit: Nanocockpit = field(default_factory=Nanocockpit)
    usd: Usd = field(default_factory=Usd)
