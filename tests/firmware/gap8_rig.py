"""The GAP8's app with its neighbours played by hand: captures, packets, stamps, requests."""

import binascii
import random
import struct
import zlib
from typing import Any

from board import APP, ESP32, GAP8, HOST, WIFI_CTRL, App, cpx, link
from c_memory import POISONS

from host.native import ffi, lib

RAW, JPEG = 0, 1
GAP8_NATIVE, GAP8_STOCK, GAP8_PAPER, GAP8_NANOCOCKPIT = range(4)
CONNECTED, GONE = (link(cpx(ESP32, GAP8, WIFI_CTRL, bytes([0x32, on]))) for on in (1, 0))
NONE_YET = 2**32 - 1
TIMEOUT_US = 500_000 + 2 * (40 + 100) * 62_700 // 1000
"""Height and exposure in lines of 62.7 us, twice, and half a second."""

CAMERA = {"analog_gain": 1, "digital_gain": 64, "burst": 1, "exposure_lines": 100}


def gap8(width: int = 60, height: int = 40, connect: bool = True, poison: int = POISONS[0], **config: Any) -> App:
    camera = {**CAMERA, **config.pop("camera", {})}
    app = App("gap8", poison, width=width, height=height, line_time_ns=62_700, camera=camera, **config)
    if connect:
        app.receive("SPI", CONNECTED, 0)
    return app


def stamp(sequence: int, stm32_us: int, epoch: int = 0) -> bytes:
    body = struct.pack("<IQB", sequence, stm32_us, epoch)
    return b"\xd5\x2a" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def stamps(app: App, count: int, stm32_us: int = 0, gap8_us: int = 0, epoch: int = 0, first: int = 0) -> None:
    """So many, 10 ms apart on both clocks: the first was sent at `stm32_us`, and came at `gap8_us`."""
    for n in range(count):
        app.receive("UART1", stamp(first + n, stm32_us + 10_000 * n, epoch), 0, gap8_us + 10_000 * n)


def picture(size: int, seed: int = 0) -> bytes:
    return random.Random(seed).randbytes(size)


def capture(app: App, body: bytes, up_us: int = 0, stamp_us: int | None = None) -> bytes:
    """One capture that begins and ends at that moment; its command."""
    command = app.transmit("CAMERA", up_us)
    assert len(command) == 8, "no capture was due"
    app.receive("CAMERA", body, up_us, stamp_us)
    return command


def sent(app: App, up_us: int = 0) -> list[bytes]:
    """All packets that wait for SPI, without their length."""
    packets: list[bytes] = []
    while (window := app.transmit("SPI", up_us)) and len(packets) < 10_000:
        assert struct.unpack("<H", window[:2])[0] == len(window) - 2
        packets.append(window[2:])
    return packets


def stock(width: int, height: int, encoding: int, parts: list[bytes], reserved: int = 1) -> list[bytes]:
    size = sum(map(len, parts))
    header = struct.pack("<BHHBBI", 0xBC, width, height, 1, encoding, size)
    pieces = [part[at : at + 1020] for part in parts for at in range(0, len(part), 1020)]
    return [cpx(GAP8, HOST, APP, header, reserved=reserved), *(cpx(GAP8, HOST, APP, piece) for piece in pieces)]


def request(kind: int, data: bytes, source: int = HOST) -> bytes:
    return link(cpx(source, GAP8, APP, bytes([0x4E, kind]) + data))


def ask_native(app: App, data_max: int = 0) -> None:
    app.receive("SPI", request(16, struct.pack("<BBH", 1, 0, data_max)), 0)
    assert app.transmit("SPI", 0) == link(cpx(GAP8, HOST, APP, b"\x4e\x05\x10\x00"))


def frame_message(packet: bytes) -> Any:
    assert packet[:2] == cpx(GAP8, HOST, APP, b"")
    assert len(packet) == 2 + 144
    header = ffi.new("native_frame_t *")
    memory = ffi.from_buffer(packet[2:])
    assert lib.native_frame_decode((ffi.cast("uint8_t *", memory), 144), header) == 144
    return header


def pairs_message(packet: bytes) -> tuple[list[tuple[int, int, int, int]], int]:
    kind, count, spare, lost = struct.unpack_from("<HBBI", packet, 2)
    assert (kind, spare) == (0x034E, 0)
    assert len(packet) == 2 + 8 + 21 * count + 4
    assert struct.unpack("<I", packet[-4:]) == (zlib.crc32(packet[2:-4]),)
    return [struct.unpack_from("<IQQB", packet, 10 + 21 * n) for n in range(count)], lost


def data_messages(packets: list[bytes], frame: int) -> bytes:
    body = b""
    for packet in packets:
        assert struct.unpack_from("<HHI", packet, 2) == (0x024E, frame, len(body))
        body += packet[10:]
    return body


SETTINGS = (0, 2, 128, 2, RAW, 0, 500, 20_000)


def camera_request(source: int = HOST, **changed: int) -> bytes:
    names = ["auto_exposure", "analog_gain", "digital_gain", "burst", "encoding", "_", "exposure_lines", "period"]
    settings = {**dict(zip(names, SETTINGS, strict=True)), **changed}
    return request(17, struct.pack("<6BHI", *settings.values()), source)
