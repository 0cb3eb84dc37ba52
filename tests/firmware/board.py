"""An app of the firmware driven through its four verbs, as a board drives it, and its wires' framing by hand."""

import struct
from functools import reduce
from operator import xor
from typing import Any

from c_memory import POISONS, Bytes, Room, poisoned

from host.native import ffi, lib

NEVER_US = 2**64 - 1
STM32, ESP32, HOST, GAP8 = 1, 2, 3, 4
SYSTEM, CONSOLE, CRTP, WIFI_CTRL, APP, TEST, BOOTLOADER = 1, 2, 3, 4, 5, 14, 15
CREDIT = b"\xff\x00"


def cpx(
    source: int, destination: int, function: int, data: bytes, last: int = 1, version: int = 0, reserved: int = 0
) -> bytes:
    """Route and data of one packet."""
    return bytes([reserved << 7 | last << 6 | source << 3 | destination, version << 6 | function]) + data


def link(packet: bytes) -> bytes:
    """As on SPI and TCP."""
    return struct.pack("<H", len(packet)) + packet


def uart(packet: bytes) -> bytes:
    """As on UART2."""
    frame = bytes([0xFF, len(packet)]) + packet
    return frame + bytes([reduce(xor, frame)])


def unlink(stream: bytes) -> list[bytes]:
    """The packets of a TCP stream, which must end with the last one."""
    packets = []
    while stream:
        size = struct.unpack("<H", stream[:2])[0]
        assert 2 <= size <= 1022, stream[:16].hex()
        assert len(stream) >= 2 + size, "ends inside a packet"
        packets.append(stream[2 : 2 + size])
        stream = stream[2 + size :]
    return packets


class App:
    """`name` is stm32, gap8 or esp32. Every call gets memory of exactly the size it is told, filled with poison."""

    def __init__(self, name: str, poison: int = POISONS[0], **config: Any) -> None:
        self.name = name
        self.state = poisoned(f"{name}_t", poison)
        self.poison = poison
        self.given: list[Bytes] = []
        result = getattr(lib, f"{name}_init")(self.state, ffi.new(f"{name}_config_t *", config), (0, 0))
        if result < 0:
            raise ValueError(result)

    def __getattr__(self, field: str) -> Any:
        return getattr(self.state, field)

    def receive(self, port: str, data: bytes, up_us: int, stamp_us: int | None = None) -> int:
        given = Bytes(data)
        if port == "CAMERA":
            self.given.append(given)  # the app may look at it until the next command
        moment = (up_us, up_us if stamp_us is None else stamp_us)
        taken = int(getattr(lib, f"{self.name}_receive")(self.state, self._port(port), given.view, moment))
        assert 0 <= taken <= len(data)
        assert taken == len(data) or port == "TCP"
        return taken

    def transmit(self, port: str, up_us: int, stamp_us: int | None = None, size: int | None = None) -> bytes:
        """What the app sends; nothing behind it may have been touched."""
        room = Room(size if size is not None else 1 if port.startswith("UART") else 1024, self.poison)
        moment = (up_us, up_us if stamp_us is None else stamp_us)
        sent = int(getattr(lib, f"{self.name}_transmit")(self.state, self._port(port), room.view, moment))
        data = bytes(room)
        assert sent <= len(data)
        assert set(data[sent:]) <= {self.poison}
        return data[:sent]

    def deadline(self) -> int:
        return int(getattr(lib, f"{self.name}_deadline")(self.state))

    def _port(self, port: str) -> int:
        return int(getattr(lib, f"{self.name.upper()}_PORT_{port}"))

    def uart_bytes(self, port: str, up_us: int, most: int = 10_000) -> bytes:
        """All that the port sends at one moment."""
        out = b""
        while len(out) < most and (byte := self.transmit(port, up_us)):
            out += byte
        return out

    def uart_packets(self, up_us: int) -> list[bytes]:
        """All packets for UART2, whose peer gives a credit for each."""
        packets: list[bytes] = []
        self.receive("UART2", CREDIT, up_us)
        while frame := self.uart_bytes("UART2", up_us).replace(CREDIT, b"", 1):
            assert frame == uart(frame[2:-1])
            packets.append(frame[2:-1])
            self.receive("UART2", CREDIT, up_us)
        return packets
