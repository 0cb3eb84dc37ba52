"""A model of the reader that users of the stock firmware have, written from what is known of it: value by value, and
with its faults. What it makes of a file is what those users will see."""

import struct
import zlib
from typing import Any

import numpy as np


def text(data: bytes, at: int) -> tuple[str, int]:
    end = at
    while data[end] != 0:
        end += 1
    return data[at:end].decode("utf-8"), end + 1


def decode(data: bytes) -> dict[str, dict[str, Any]] | None:
    """By event and variable. IndexError, struct.error or KeyError where that reader ends with one."""
    if data[0] != 0xBC:
        return None
    if zlib.crc32(data[:-4]) != struct.unpack("<I", data[-4:])[0]:
        print("WARNING: the CRC does not match")
    version, count = struct.unpack("HH", data[1:5])
    if version not in (1, 2):
        return None
    result: dict[str, dict[str, Any]] = {}
    by_id = {}
    at = 5
    for _ in range(count):
        (number,) = struct.unpack("H", data[at : at + 2])
        name, at = text(data, at + 2)
        (variables,) = struct.unpack("H", data[at : at + 2])
        at += 2
        result[name] = {"timestamp": []}
        letters, names = "<", []
        for _ in range(variables):
            each, at = text(data, at)
            result[name][each[:-3]] = []
            letters += each[-2]
            names.append(each[:-3])
        by_id[number] = (name, letters, struct.calcsize(letters), names)
    while at < len(data) - 4:
        if version == 1:
            number, stamp = struct.unpack("<HI", data[at : at + 6])
            at += 6
        else:
            number, stamp = struct.unpack("<HQ", data[at : at + 10])
            stamp = stamp / 1000.0
            at += 10
        name, letters, size, names = by_id[number]
        values = struct.unpack(letters, data[at : at + size])
        at += size
        event = result[name]
        for variable, value in zip(names, values, strict=True):
            event[variable].append(value)
        event["timestamp"].append(stamp)
    for name in [name for name, event in result.items() if not event["timestamp"]]:
        del result[name]
    return {name: {variable: np.array(values) for variable, values in event.items()} for name, event in result.items()}
