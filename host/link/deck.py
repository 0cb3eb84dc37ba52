"""Asking a deck to change something, and telling from what is heard who answered and who did not. Pure.

Neither firmware acknowledges settings of the network, and firmware that does not know a message ignores it, or worse:
the stock GAP8 stops receiving behind a packet that nobody reads, and NanoCockpit's ESP32 takes a packet of CPX for a
longer one and loses its place. So a TCP connection is listened to first. Then the ESP32 is asked for an echo, which
every one that knows CPX gives, and the GAP8 is asked for nothing before it has announced that it speaks native.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..native import lib
from ..protocol.errors import LocalError
from .counters import SessionCounters
from .frame import Frame, LostFrame
from .records import Announced, Console, Event, Packet, Reply

ECHO = bytes([lib.TEST_ECHO]) + b"spindeck"
SSID_BYTES, KEY_BYTES = range(1, 33), range(8, 65)
LISTEN_S = 2.0
"""A camera that sends has sent by then. A NanoCockpit that is silent for longer is taken for an ESP32 with CPX."""

PERIOD_S_MAX = 10
"""Of frame_period_us in the message."""
FPS_MAX = 218
"""Of the sensor (HM01B0, at its 6 MHz pixel clock) with 162 x 122 pixels: 61 with 324 x 244, 46 with 324 x 324."""
LINES_MAX = 65533
"""Of exposure: two less than the lines of a frame, for which the sensor has 16 bits."""
LINE_US_MIN = 215 / 6
"""The shortest line: 215 pixel clocks of 6 MHz, in the half resolutions."""


@dataclass(slots=True)
class Heard:
    """Everything that tells who is there, since the connection began."""

    bytes: int = 0
    packets: int = 0
    garbage: int = 0
    """Bytes."""
    nanocockpit: bool = False
    """The bytes follow its rule."""
    broken: int = 0
    """Images that came in part."""
    echo: bool = False
    """The ESP32 has sent ours back."""
    images: int = 0
    native: bool = False
    dialect: str | None = None
    """Of the last whole image."""
    reply: Reply | None = None
    """To a camera request."""
    gap8: bool = False
    """It has said anything at all."""
    notices: list[str] = field(default_factory=list)
    """Of the ESP32, about its network."""
    address: str | None = None

    def take(self, events: list[Event], counters: SessionCounters, reads_cpx: bool) -> None:
        """What one read has brought."""
        self.bytes, self.garbage = counters.bytes, counters.garbage_bytes
        self.packets = sum(counters.packets.values())
        self.nanocockpit |= not reads_cpx
        for event in events:
            if isinstance(event, Frame | LostFrame | Announced | Reply) or (
                isinstance(event, Console) and event.source == "GAP8"
            ):
                self.gap8 = True
            self.native |= isinstance(event, Announced) or (isinstance(event, Frame) and event.native is not None)
            self.broken += isinstance(event, LostFrame)
            if isinstance(event, Frame):
                self.images += 1
                self.dialect = event.dialect
            if isinstance(event, Reply) and event.request == lib.NATIVE_CAMERA:
                self.reply = event
            if isinstance(event, Packet):
                self._take_packet(event)

    def _take_packet(self, packet: Packet) -> None:
        self.gap8 |= packet.source == lib.CPX_GAP8
        if packet.source != lib.CPX_ESP32:
            return
        if packet.function == lib.CPX_TEST and packet.data == ECHO:
            self.echo = True
        if packet.function == lib.CPX_WIFI_CTRL and packet.data[:1] == bytes([lib.WIFI_CONNECTED]):
            self.address = ".".join(str(number) for number in packet.data[1:5])
            self.notices.append(f"WIFI_CONNECTED, address {self.address}")
        if packet.function == lib.CPX_WIFI_CTRL and packet.data[:1] == bytes([lib.WIFI_CLIENT_CONNECTED]):
            self.notices.append(f"WIFI_CLIENT_CONNECTED, {packet.data[1:2].hex() or 'without a number'}")

    @property
    def is_stock(self) -> bool:
        """Whole images, and none that announces native."""
        return self.images > 0 and not self.native

    @property
    def is_cpx(self) -> bool:
        """Images say so for sure."""
        return not self.nanocockpit and (self.native or self.images + self.broken > 0)

    @property
    def may_be_cpx(self) -> bool:
        """Silence, or packets and nothing else."""
        return not self.nanocockpit and self.garbage == 0 and (self.bytes == 0 or self.packets > 0)

    def who_is_silent(self, seconds: float, asked: int) -> str:
        """Why there is no answer; `asked`: how often the GAP8 was."""
        if self.bytes == 0:
            return (
                f"not a byte in {seconds:.1f} s. Is the robot on? "
                "A deck serves one program at a time: is another one connected to it?"
            )
        if asked:
            return f"the GAP8 has announced native, was asked {asked} times and did not reply in {seconds:.1f} s"
        if not self.echo and not self.gap8:
            return f"{self.bytes} bytes in {seconds:.1f} s, but no echo of the ESP32 and nothing of the GAP8"
        if not self.echo:
            return f"the GAP8 sends and the ESP32 has not answered the echo in {seconds:.1f} s"
        if not self.gap8:
            return (
                f"the ESP32 answers the echo, and the GAP8 has been silent for {seconds:.1f} s: is its camera running?"
            )
        return f"ESP32 and GAP8 are there, and no whole image came in {seconds:.1f} s"


def frame_period_us(fps: float, burst: int, exposure_lines: int | None) -> int:
    """Of the camera's settings. LocalError for what the message cannot carry or the sensor cannot do; `exposure_lines`:
    None when the sensor chooses."""
    least = burst / PERIOD_S_MAX
    if not least <= fps <= FPS_MAX:
        raise LocalError(
            f"--fps {fps:g}: at least {least:g}, a burst each {PERIOD_S_MAX} s, which is what the message can carry; "
            f"at most {FPS_MAX}, which is what the sensor can do with 162 x 122 pixels (61 with 324 x 244)"
        )
    if exposure_lines is not None and exposure_lines * LINE_US_MIN * fps > 1e6:
        raise LocalError(
            f"--exposure-lines {exposure_lines} with --fps {fps:g}: that is longer than a frame, a line takes "
            f"{LINE_US_MIN:.1f} us at least: at most {int(1e6 / (LINE_US_MIN * fps))} lines"
        )
    return round(1e6 * burst / fps)


def wifi_packets(ssid: str, key: str, station: bool) -> list[tuple[str, bytes]]:
    """What to send to the ESP32, each with words for people. LocalError for what no firmware would take."""
    name, secret = ssid.encode(), key.encode()
    if len(name) not in SSID_BYTES or b"\0" in name:
        raise LocalError(f"--ssid has {len(name)} bytes: give 1 to 32, without NUL")
    if secret and (len(secret) not in KEY_BYTES or b"\0" in secret):
        raise LocalError(f"the key has {len(secret)} bytes: give 8 to 64, without NUL, or --open for none")
    mode = "station" if station else "access point"
    return [
        (f"SET_SSID {ssid}", bytes([lib.WIFI_SET_SSID]) + name),
        (f"SET_KEY, {len(secret)} bytes" if secret else "SET_KEY without a key", bytes([lib.WIFI_SET_KEY]) + secret),
        (f"CONNECT as {mode}", bytes([lib.WIFI_CONNECT, 0 if station else 1])),
    ]
