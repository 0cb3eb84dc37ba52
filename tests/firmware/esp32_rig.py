"""The ESP32's app with its neighbours played by hand: packets in and out of each port, and whole frames."""

import random
import struct
import zlib

from board import APP, ESP32, GAP8, HOST, STM32, WIFI_CTRL, App, cpx, link, uart, unlink
from c_memory import POISONS

CLIENT, CLIENT_GONE, NETWORK_DOWN = b"\x02", b"\x03", b"\x04"
NO_MESSAGE = bytes(4)
PORT_OF = {STM32: "UART2", GAP8: "SPI", HOST: "TCP"}
NATIVE_REQUEST = b"\x4e\x10\x01\x00"


def esp32(client: bool = True, poison: int = POISONS[0], **config: int) -> App:
    """Booted, with a client, and its first messages taken."""
    app = App("esp32", poison, **config)
    if client:
        app.receive("NETWORK", CLIENT, 0)
    from_spi(app)
    app.uart_packets(0)
    return app


def from_spi(app: App, up_us: int = 0) -> list[bytes]:
    packets = []
    while (window := app.transmit("SPI", up_us)) != NO_MESSAGE:
        packets += unlink(window)
    return packets


def from_tcp(app: App, up_us: int = 0, size: int = 1440) -> list[bytes]:
    stream = b""
    while piece := app.transmit("TCP", up_us, size=size):
        stream += piece
    return unlink(stream)


def give(app: App, port: str, packet: bytes, up_us: int = 0) -> None:
    """To UART2, SPI or TCP, framed as that link does it."""
    framed = uart(packet) if port == "UART2" else link(packet)
    assert app.receive(port, framed, up_us) == len(framed)


def out(app: App, port: str, up_us: int = 0) -> list[bytes]:
    match port:
        case "UART2":
            return app.uart_packets(up_us)
        case "SPI":
            return from_spi(app, up_us)
        case _:
            return from_tcp(app, up_us)


def stock_frame(width: int, height: int, seed: int = 0, encoding: int = 0) -> list[bytes]:
    body = random.Random(seed).randbytes(width * height)
    header = struct.pack("<BHHBBI", 0xBC, width, height, 1, encoding, len(body))
    return [cpx(GAP8, HOST, APP, header, reserved=1)] + [
        cpx(GAP8, HOST, APP, body[at : at + 1020]) for at in range(0, len(body), 1020)
    ]


def sealed(message: bytes) -> bytes:
    return message + struct.pack("<I", zlib.crc32(message))


def native_frame(size: int, frame: int = 0, pairs: int = 0, data_max: int = 1020) -> list[bytes]:
    """A JPEG, so that any size is right."""
    body = random.Random(frame).randbytes(size)
    header = sealed(struct.pack("<BBHIHHBBHI", 0x4E, 1, 104, frame, 324, 324, 1, 1, 0, size).ljust(100, b"\0"))
    one = bytes(21)
    counts = [48] * (pairs // 48) + [pairs % 48] * (pairs % 48 > 0)
    messages = [sealed(struct.pack("<BBBBI", 0x4E, 3, count, 0, 0) + one * count) for count in counts]
    step = data_max - 8
    data = [struct.pack("<HHI", 0x024E, frame & 0xFFFF, at) + body[at : at + step] for at in range(0, size, step)]
    return [cpx(GAP8, HOST, APP, message) for message in [header, *messages, *data]]


def give_all(app: App, packets: list[bytes]) -> None:
    for packet in packets:
        give(app, "SPI", packet)


def ask(app: App, data_max: int, destination: int = GAP8) -> None:
    give(app, "TCP", cpx(HOST, destination, APP, NATIVE_REQUEST + struct.pack("<H", data_max)))
    from_spi(app)


def told(client: int, *targets: int) -> list[bytes]:
    return [cpx(ESP32, target, WIFI_CTRL, bytes([0x32, client])) for target in targets]
