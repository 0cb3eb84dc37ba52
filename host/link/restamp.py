"""A copy of a recording with times that were worked out afterwards, on a topic of their own beside what was there."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from ..protocol.errors import LocalError
from .foxglove import as_json, json_schema
from .mcap import DATA_END, MAGIC, Channel, Chunk, Schema, encode_channel, encode_schema, walk
from .mcap_summary import finish, read_summary
from .recording import CHUNK_BYTES

TOPIC = "restamped"
SCHEMA_NAME = "spindeck.Restamped"
BLOCK_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class Restamped:
    """A frame's time from all messages of the recording, or why it has none."""

    frame_index: int
    """That of the frame on the topic `frame`."""
    frame: int
    """Its number on the robot."""
    arrival_host_ns: int
    frame_gap8_us: int
    frame_stm32_us: float | None
    """End of frame."""
    bound_us: float | None
    """99 %, either side."""
    epoch: int | None
    holdover: bool | None
    """More than 0.25 s before the first message of its epoch or behind the last: whether the clock was set meanwhile,
    nothing says, and the bound holds if it was not."""
    refused: str | None
    row_stm32_us: float | None = None
    """Middle of the exposure of the row that was asked for; its bound is that of the end of frame."""


def add_times(path: str, out: IO[bytes], times: Mapping[int, Sequence[Restamped]]) -> None:
    """Copies the whole recording at `path`, which is only read, into the empty `out`, and adds the times, by robot."""
    try:
        file = Path(path).open("rb")  # noqa: SIM115 - closed below; what fails on `out` is not this file's
    except OSError as error:
        raise LocalError(f"{path}: {error.strerror}") from error
    with file:
        try:
            summary = read_summary(file)
            end = next((at for opcode, at, _ in walk(file, len(MAGIC), file.seek(0, 2)) if opcode == DATA_END), None)
            if end is None:
                raise LocalError("its data has no end; 'host recover' makes it whole")
        except LocalError as error:
            raise LocalError(f"{path}: {error}") from error
        sources = {each.topic: each for each in summary.channels.values()}
        for robot in times:
            if topic(robot) in sources:
                raise LocalError(f"{path}: has {topic(robot)} already: give the recording as it was made")
        file.seek(0)
        while left := end - file.tell():
            out.write(file.read(min(BLOCK_BYTES, left)))
    schema = Schema(max(summary.schemas, default=0) + 1, SCHEMA_NAME, "jsonschema", json_schema(Restamped))
    out.write(encode_schema(schema))
    number = max(summary.channels, default=0)
    for robot, frames in times.items():
        number += 1
        metadata = sources[f"/robot{robot}/received"].metadata
        out.write(encode_channel(Channel(number, schema.id, topic(robot), "json", metadata)))
        write(out, number, int(metadata["epoch_ns"]), frames)
    finish(out)


def topic(robot: int) -> str:
    return f"/robot{robot}/{TOPIC}"


def write(out: IO[bytes], channel: int, epoch_ns: int, frames: Sequence[Restamped]) -> None:
    """In chunks, with the times that the frames have on their own topic."""
    chunk = Chunk()
    for sequence, frame in enumerate(frames):
        arrival_ns = frame.arrival_host_ns
        chunk.add(channel, sequence, arrival_ns + epoch_ns, arrival_ns, (as_json(frame),))
        if chunk.size >= CHUNK_BYTES or sequence == len(frames) - 1:
            out.writelines(chunk.encode())
            chunk.clear()
