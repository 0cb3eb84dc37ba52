"""Recorded flights whose logs are on a virtual card, on which an older log lay."""

import struct
import sys
from bisect import bisect_left
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

import existing_reader
import numpy as np
from card_model import CHUNK, Model, Rate, Rows

from host.usd.config import names_of_firmware
from sim.card import CLOSE, CREATE, SEEK, SYNC, TRUNCATE, WRITE, Card
from sim.card_sectors import Recording, Request
from sim.world import World


@dataclass
class File:
    """What a log's requests have made of a file, and what was promised about it."""

    content: bytearray = field(default_factory=bytearray)
    position: int = 0
    end: int = 0
    """Of what was written."""
    promises: list[tuple[int, int]] = field(default_factory=list)
    """Sectors written when a sync had ended, and bytes that it covers."""

    def promised(self, count: int) -> int:
        return max((size for written, size in self.promises if written <= count), default=0)


def files_of(requests: list[Request]) -> dict[str, File]:
    """Only what was answered well."""
    files: dict[str, File] = {}
    file = File()
    for request, answer, count, _ in requests:
        operation, argument = request[0], request[1:]
        (result,) = struct.unpack("<i", answer[1:5])
        if result < 0:
            continue
        if operation == CREATE:
            file = files[argument.decode()] = File()
        elif operation == WRITE:
            file.content[file.position : file.position + result] = argument[:result]
            file.position += result
            file.end = file.position
        elif operation == SEEK:
            (file.position,) = struct.unpack("<I", argument)
        elif operation == TRUNCATE:
            del file.content[file.position :]
        elif operation in (SYNC, CLOSE):
            file.promises.append((count, file.end))
    return files


@dataclass
class Flight:
    """A recorded log, on a card on which an older one lay."""

    card: Card
    recording: Recording
    files: dict[str, File]
    given: dict[str, np.ndarray]
    """Rows by type, as they were given to the card: another reader than ours has read them, or they were made up."""

    def end_us(self, count: int) -> float:
        """When the request was answered whose writes so many are: the power goes before the next one at the latest."""
        requests = self.recording.requests
        return requests[bisect_left(requests, count, key=lambda each: each.writes)].end_ns / 1000


def model_flight(size_mb: int, seconds: float, seed: int, rate: Rate, stalls: dict[str, float]) -> Flight:
    """The older log has the same types of rows at the same times: only its session tells them apart."""
    older = Card(size_mb, seed=seed + 1000)
    Model(older, Rows.make(rate, seconds, seed + 1000), session=0x01DE0000 + seed)
    card = Card(size_mb, seed=seed, **stalls)
    data = older.get("log00")
    card.leave(data * max(1, 2 * CHUNK // len(data)))
    recording = card.record()
    rows = Rows.make(rate, seconds, seed)
    Model(card, rows, session=0x4E3A0000 + seed)
    return Flight(card, recording, files_of(recording.requests), rows.given)


CONFIG = """\
1
16384
log
1
on:fixedFrequency
250
1
stateEstimate.x
stateEstimate.y
stateEstimate.z
stateEstimate.qx
stateEstimate.qy
stateEstimate.qz
stateEstimate.qw
on:estPose
"""
FLOATS = [name for name, letter in names_of_firmware().variables.items() if letter == "f"][:20]
FAST_CONFIG = """\
1
65535
log
1
on:fixedFrequency
1000
1
{}
on:estGyroscope
gyro.x
gyro.y
gyro.z
""".format("\n".join(FLOATS))
SHUT_DOWN = bytes.fromhex("ff 03 59 01 30 94")


def robot_flight(size_mb: int, seconds: float, seed: int, config: str, stalls: dict[str, float]) -> Flight:
    """The STM32's logger in the simulated world; the older log is one of its own."""
    older, card = Card(size_mb, seed=seed + 1000), Card(size_mb, seed=seed, **stalls)
    for each in (older, card):
        each.put("config.txt", config.encode())
    flown(older, seconds, seed + 1000)
    data = older.get("log00")
    card.leave(data * max(1, 2 * CHUNK // len(data)))
    recording = card.record()
    flown(card, seconds, seed)
    files = files_of(recording.requests)
    return Flight(card, recording, files, rows_of(bytes(files["log00"].content)))


def rows_of(data: bytes) -> dict[str, np.ndarray]:
    """Of a whole log whose values are floats, by the model of the reader that others have."""
    decoded: dict[str, Any] = existing_reader.decode(data) or {}
    rows = {}
    for event, columns in decoded.items():
        if event == "log.status":
            continue
        stamps = columns.pop("timestamp")
        table = np.empty(len(stamps), [("stamp_stm32_us", "<u8"), *((name, "<f4") for name in columns)])
        table["stamp_stm32_us"] = np.round(stamps * 1000)
        for name, values in columns.items():
            table[name] = values
        rows[event] = table
    return rows


def flown(card: Card, seconds: float, seed: int) -> None:
    """Until its logger has closed the file."""
    world = World("hover", seed=seed, camera_fps=0, stm32_ppm=0, stm32_walk_ppb=0)
    world.robots[0].set_storage(card)
    world.run(seconds)
    world.robots[0].inject("uart2_to_stm32", SHUT_DOWN)
    world.run(2.0)
    assert world.robots[0].log["status"] == "off", world.robots[0].log
