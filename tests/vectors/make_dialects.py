"""Prints dialects.json: one message of each format of the paper's firmware and of NanoCockpit, made with struct and
zlib alone, as their sources send it.

python tests/vectors/make_dialects.py > tests/vectors/dialects.json
"""

import functools
import json
import operator
import struct
import zlib

POSE = {"x_m": 0.5, "y_m": -1.25, "z_m": 1.0, "qx": 0.0, "qy": 0.0, "qz": 0.5, "qw": 0.75}
PAPER_STAMP = {"stm32_us": 123456789012} | POSE
payload = struct.pack("<BQ7f", 1, *PAPER_STAMP.values())
PAPER_HEADER = {"width": 324, "height": 324, "depth": 1, "type": 0, "size": 104976, "frame_stm32_ms": 123456} | POSE
PAPER_CAMERA = {
    "auto_exposure": 0,
    "analog_gain": 8,
    "digital_gain": 1,
    "exposure_lines": 50,
    "burst": 1,
    "encoding": 1,
}

MOTION = {"x_mm": 500, "y_mm": -1250, "z_mm": 1000, "vx_mm_s": -1, "vy_mm_s": 2, "vz_mm_s": -32768}
MOTION |= {"ax_mm_s2": 32767, "ay_mm_s2": 0, "az_mm_s2": 9810}
RATES = {"roll_mrad_s": 10, "pitch_mrad_s": -20, "yaw_mrad_s": 8000}
STATE = {"stm32_time": 4000000000} | MOTION | {"quat": 0xDEADBEEF} | RATES
state = struct.pack("<I9hI3h", *STATE.values())
FRAME_PART = {"width": 6, "height": 4, "depth": 1, "frame_id": 255, "frame_gap8_us": 3000000000, "state_gap8_us": 2999}
RANGES = {"ranges_gap8_us": 17, "ranges_count": 16, "ranges": list(range(64))}
REPLY_PART = {"reply_frame_gap8_us": 2900000000, "reply_gap8_us": 2900045000}
INFERENCE = {"inference_stm32_time": 4000000001, "inference": [1.0, -2.0, 0.5, 3.25]}
METADATA = FRAME_PART | STATE | RANGES | REPLY_PART | INFERENCE
metadata = struct.pack("<BHHBBBII", 10, 6, 4, 1, 0, 255, 3000000000, 2999) + state
metadata += struct.pack("<IB3x64B", 17, 16, *range(64)) + struct.pack(
    "<III4f", 2900000000, 2900045000, 4000000001, 1, -2, 0.5, 3.25
)
BUFFER = metadata + bytes(range(24))
REPLY = {"frame_gap8_us": 3000000000, "frame_id": 255}

MESSAGES = [
    ("paper stamp", PAPER_STAMP, b"\xbc\x25" + payload + bytes([functools.reduce(operator.xor, payload)])),
    ("paper header", PAPER_HEADER, struct.pack("<BHHBBII7f", 0xBC, *PAPER_HEADER.values())),
    ("paper camera", PAPER_CAMERA, struct.pack("<BBBBHBB", 0, *PAPER_CAMERA.values())),
    ("nanocockpit state", STATE, b"!STA" + state + struct.pack("<I", zlib.crc32(b"!STA" + state))),
    (
        "nanocockpit begin",
        {"type": 1, "size": len(BUFFER), "check": zlib.crc32(BUFFER)},
        struct.pack("<BBII2x", 0x10, 1, len(BUFFER), zlib.crc32(BUFFER)),
    ),
    ("nanocockpit metadata", METADATA, metadata),
    ("nanocockpit reply", REPLY, struct.pack("<IB20x", *REPLY.values())),
]

if __name__ == "__main__":
    entries = [{"format": name, "values": values, "hex": wire.hex(" ")} for name, values, wire in MESSAGES]
    print(json.dumps(entries, indent=1))
