"""Recorded flights whose logs are on a virtual card, on which an older log lay."""

import struct
from dataclasses import dataclass, field

import numpy as np
from card_model import CHUNK, Model, Rate, Rows

from sim.card import CLOSE, CREATE, SEEK, SYNC, TRUNCATE, WRITE, Card
from sim.card_sectors import Recording
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


def files_of(requests: list[tuple[bytes, bytes, int]]) -> dict[str, File]:
    """Only what was answered well."""
    files: dict[str, File] = {}
    file = File()
    for request, answer, count in requests:
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
    """Rows by type; empty: nobody knows but the logger."""


def model_flight(size_mb: int, seconds: float, seed: int, rate: Rate) -> Flight:
    """The older log has the same types of rows at the same times: only its session tells them apart."""
    older = Card(size_mb, seed=seed + 1000)
    Model(older, Rows.make(rate, seconds, seed + 1000), session=0x01DE0000 + seed)
    card = Card(size_mb, seed=seed)
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
SHUT_DOWN = bytes.fromhex("ff 03 59 01 30 94")


def robot_flight(size_mb: int, seconds: float, seed: int) -> Flight:
    """The STM32's logger in the simulated world; the older log is one of its own."""
    older, card = Card(size_mb, seed=seed + 1000), Card(size_mb, seed=seed)
    for each in (older, card):
        each.put("config.txt", CONFIG.encode())
    flown(older, seconds, seed + 1000)
    data = older.get("log00")
    card.leave(data * max(1, 2 * CHUNK // len(data)))
    recording = card.record()
    flown(card, seconds, seed)
    return Flight(card, recording, files_of(recording.requests), {})


def flown(card: Card, seconds: float, seed: int) -> None:
    """Until its logger has closed the file."""
    world = World("hover", seed=seed, camera_fps=0)
    world.robots[0].set_storage(card)
    world.run(seconds)
    world.robots[0].inject("uart2_to_stm32", SHUT_DOWN)
    world.run(2.0)
    assert world.robots[0].log["status"] == "off", world.robots[0].log
