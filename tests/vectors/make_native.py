"""Prints native.json: one message of each native format, made with struct, zlib and crcmod alone.

python tests/vectors/make_native.py > tests/vectors/native.json
"""

import json
import struct
import zlib

import crcmod.predefined

PIXELS = bytes(range(24))  # 6 x 4, raw
FRAME = {"frame": 70000, "width": 6, "height": 4, "depth": 1, "encoding": 0, "flags": 3, "body_bytes": 24}
FRAME |= {"body_crc32": zlib.crc32(PIXELS), "frame_gap8_us": 0x0102030405060708, "frame_stm32_us": 1234567890123}
FRAME |= {"bound_us": 42, "epoch": 7, "analog_gain": 8, "digital_gain": 64, "burst": 3, "exposure_lines": 500}
FRAME |= {"line_time_ns": 62700, "stamp_sequence": 4000000000, "stamp_age_us": 4294967295, "stamps_received": 9}
FRAME |= {"stamps_missed": 10, "stamps_bad": 11, "pairs_lost": 12, "captures_failed": 13, "captures_late": 14}
FRAME |= {"frames_unsent": 15, "spi_errors": 16, "packets_dropped": 17}
CLOCK = {"window_us": 8000000, "window_stamps": 799, "delay_us": 501, "skew_ppb": -11764706, "latency_us": 93}
ECHO = {"minimum_delay_us": 180, "minimum_delay_error_us": 184, "echoes": 33}
PAIRS = [{"sequence": 5, "stm32_us": 2**40 + 1, "gap8_us": 2**41 + 2, "epoch": 0}]
PAIRS += [{"sequence": 2**32 - 1, "stm32_us": 2**64 - 1, "gap8_us": 0, "epoch": 255}]
COUNTERS = "frames_forwarded frames_dropped frames_cut packets_forwarded packets_dropped packets_unroutable"
COUNTERS += " uart_bad_check uart_bad_length uart_garbage_bytes uart_gaps spi_errors tcp_skipped_bytes"
STATUS = {"up_us": 2**33 + 5} | {name: 1000 + place for place, name in enumerate(COUNTERS.split())}
LOG = {"state": 2, "epoch": 3, "stm32_us": 2**40 + 5, "files": 1, "session": 3194938702}
LOG |= {
    "requested": 6163,
    "accepted": 6160,
    "dropped": 3,
    "stall_us": 179077,
    "syncs": 23,
    "errors": 1,
    "card_errors": 4,
}
CAMERA = {"auto_exposure": 1, "analog_gain": 4, "digital_gain": 200, "burst": 2, "encoding": 1}
CAMERA |= {"exposure_lines": 532, "frame_period_us": 66667}
STAMP = {"sequence": 123456, "stm32_us": 987654321012, "epoch": 3}
stamped = struct.pack("<IQB", *STAMP.values())
ANSWER = {"number": 200, "received_stm32_us": 987654321012, "held_us": 1409}
answered = struct.pack("<BQI", *ANSWER.values())
crc16 = crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")


def sealed(message):
    return message + struct.pack("<I", zlib.crc32(message))


MESSAGES = [
    (
        "native frame",
        FRAME | CLOCK | ECHO,
        sealed(
            sealed(
                sealed(struct.pack("<BBHIHHBBHIIQQIBBBBIIIIIIIIIIIII", 0x4E, 1, 144, *FRAME.values()))
                + struct.pack("<IIIiI", *CLOCK.values())
            )
            + struct.pack("<III", *ECHO.values())
        ),
    ),
    (
        "native data",
        {"frame_low": 70000 % 65536, "offset": 1012},
        b"\x4e\x02" + struct.pack("<HI", 4464, 1012) + PIXELS,
    ),
    (
        "native pairs",
        {"lost": 3, "pairs": PAIRS},
        sealed(
            struct.pack("<BBBBI", 0x4E, 3, 2, 0, 3) + b"".join(struct.pack("<IQQB", *pair.values()) for pair in PAIRS)
        ),
    ),
    ("native status", STATUS, sealed(struct.pack("<BBHQ12I", 0x4E, 4, 0, *STATUS.values()))),
    ("native log", LOG, sealed(struct.pack("<BBBBQ9I", 0x4E, 6, *LOG.values()))),
    ("native reply", {"request": 17, "status": 2}, bytes([0x4E, 5, 17, 2])),
    ("native stream", {"dialect": 1, "data_max": 1020}, struct.pack("<BBBBH", 0x4E, 16, 1, 0, 1020)),
    ("native camera", CAMERA, struct.pack("<BBBBBBBBHI", 0x4E, 17, 1, 4, 200, 2, 1, 0, 532, 66667)),
    ("stamp message", STAMP, b"\xd5\x2a" + stamped + struct.pack("<H", crc16(stamped))),
    ("echo question", {"number": 200}, b"\xd5\x2b\xc8" + struct.pack("<H", crc16(b"\xc8"))),
    ("echo answer", ANSWER, b"\xd5\x2c" + answered + struct.pack("<H", crc16(answered))),
]

if __name__ == "__main__":
    entries = [{"format": name, "values": values, "hex": wire.hex(" ")} for name, values, wire in MESSAGES]
    print(json.dumps(entries, indent=1))
