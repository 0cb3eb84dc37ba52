"""Recordings: everything that a run receives and sends, in one MCAP file, safe against the end of this process.

A robot's reading thread hands over what it has and goes on; one thread for the file makes a chunk of what has come each
FLUSH_S, writes it and waits until the disk has it (fdatasync). So a killed process loses less than 250 ms and
`host recover` gives back the rest; a power cut too, as far as the disk keeps its word.

A disk that is slower than the robots does not slow the reading: QUEUE_BYTES wait for it at most, then what comes is
left out, counted, and reported in the file itself (the topic `missing`) at the place where it is missing.
"""

from __future__ import annotations

import os
import threading
import time
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from ..protocol.errors import LocalError
from . import foxglove
from .dialects import Dialect
from .mcap import MAGIC, Channel, Chunk, Schema, encode_channel, encode_header, encode_schema
from .mcap_summary import finish
from .records import Event, Frame, LostFrame, Stamp

FLUSH_S = 0.2
CHUNK_BYTES = 4 << 20
"""A chunk ends earlier when it is this large."""
QUEUE_BYTES = 64 << 20
"""In memory at most, on their way to the disk."""
ITEM_BYTES = 200
"""What a small message costs in memory besides its bytes."""

Part = Literal["images", "raw"]
PARTS: tuple[Part, ...] = ("images", "raw")
"""What can be left out: the images, which are in the raw bytes too, or the raw bytes, without which nothing can be
replayed."""


@dataclass(slots=True)
class Missing:
    """What the disk was too slow for: between two times, so much."""

    first_host_ns: int = 0
    last_host_ns: int = 0
    received_bytes: int = 0
    sent_bytes: int = 0
    frames: int = 0
    others: int = 0
    """Stamps and lost frames."""


TOPICS: dict[str, tuple[str, Any]] = {
    "received": ("spindeck.Bytes", None),
    "sent": ("spindeck.Bytes", None),
    "image": ("foxglove.RawImage", None),
    "compressed_image": ("foxglove.CompressedImage", None),
    "frame": ("spindeck.Frame", Frame),
    "lost_frame": ("spindeck.LostFrame", LostFrame),
    "stamp": ("spindeck.Stamp", Stamp),
    "missing": ("spindeck.Missing", Missing),
}
"""Of each robot: the schema, and the record that it is JSON of; else it is protobuf."""
EVENTS: dict[type[Any], str] = {Frame: "frame", LostFrame: "lost_frame", Stamp: "stamp"}
"""What else a session reports can be had again from the raw bytes."""


class Recorder:
    """One file. Close it: a recording without its end has to be recovered before it can be read."""

    def __init__(self, path: str, without: Part | None = None) -> None:
        self.path = Path(path)
        self.without = without
        try:
            self._file = self.path.open("xb", buffering=0)
        except FileExistsError as error:
            raise LocalError(f"--record {path}: exists, and nothing is ever overwritten: name another file") from error
        except OSError as error:
            raise LocalError(f"--record {path}: {error.strerror}") from error
        self.tracks: list[Track] = []
        self._changed = threading.Condition()
        self._waiting: list[tuple[Track, str, Any, int, int]] = []
        self._waiting_bytes = 0
        self._held_bytes = 0
        self._closing = False
        self._failure: Exception | None = None
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[int, str], int] = {}
        self._sequences: list[int] = []
        self._whole_bytes = 0
        self._write(MAGIC + encode_header(f"spindeck {version()}"))
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def track(self, number: int, port: Any, dialect: Dialect) -> Track:
        """Where one robot's bytes and events go."""
        made = Track(self, number, port, dialect)
        self.tracks.append(made)
        return made

    def put(self, track: Track, topic: str, content: Any, arrival_host_ns: int, size: int) -> None:
        """Hands a message over; never waits for the disk. LocalError when the file could not be written."""
        size += ITEM_BYTES
        with self._changed:
            if self._failure is not None:
                raise self._unwritten(self._failure)
            if self._closing:
                return
            if self._held_bytes + size > QUEUE_BYTES:
                track.left_out(topic, size - ITEM_BYTES, arrival_host_ns)
                return
            if track.missing_now is not None:
                missing, track.missing_now = track.missing_now, None
                self._waiting.append((track, "missing", missing, missing.first_host_ns, 0))
            self._waiting.append((track, topic, content, arrival_host_ns, size))
            self._waiting_bytes += size
            self._held_bytes += size
            if self._waiting_bytes >= CHUNK_BYTES:
                self._changed.notify()

    def close(self) -> None:
        """Writes what waits and the end of the file. LocalError when it could not be written."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join()
        self._file.close()
        try:
            with self.path.open("r+b") as file:
                # After a failure: without the piece that was being written, so that what was before is whole.
                file.truncate(self._whole_bytes)
                finish(file)
                os.fsync(file.fileno())
        except OSError as error:
            self._failure = self._failure or error
        if self._failure is not None:
            raise self._unwritten(self._failure) from self._failure

    def _unwritten(self, failure: Exception) -> LocalError:
        why = failure.strerror if isinstance(failure, OSError) else repr(failure)
        return LocalError(
            f"--record {self.path}: {why}; what was written before is complete ('host recover', if it has no end)"
        )

    def _run(self) -> None:
        """The thread of the file."""
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: self._closing or self._waiting_bytes >= CHUNK_BYTES, FLUSH_S)
                    closing = self._closing
                    if closing:
                        for track in self.tracks:
                            if track.missing_now is not None:
                                self._waiting.append(
                                    (track, "missing", track.missing_now, track.missing_now.first_host_ns, 0)
                                )
                    taken, self._waiting = self._waiting, []
                    self._waiting_bytes = 0
                if taken:
                    self._write_chunks(taken)
                if closing:
                    return
        except Exception as failure:
            # Whatever it is, the next put() and close() raise it.
            with self._changed:
                self._failure = failure

    def _write_chunks(self, taken: list[tuple[Track, str, Any, int, int]]) -> None:
        chunk, held = Chunk(), 0
        for track, topic, content, arrival_host_ns, size in taken:
            held += size
            for name, parts in track.messages(topic, content, arrival_host_ns):
                channel = self._channel(track, name)
                sequence = self._sequences[channel - 1]
                self._sequences[channel - 1] = sequence + 1
                chunk.add(channel, sequence, arrival_host_ns + track.epoch_ns, arrival_host_ns, parts)
            if chunk.size >= CHUNK_BYTES:
                self._write(chunk.encode())
                chunk, held = Chunk(), self._release(held)
        if chunk.size:
            self._write(chunk.encode())
        self._release(held)
        getattr(os, "fdatasync", os.fsync)(self._file.fileno())

    def _release(self, held: int) -> int:
        with self._changed:
            self._held_bytes -= held
        return 0

    def _channel(self, track: Track, topic: str) -> int:
        """Its number; declared in the file at its first message."""
        known = self._channels.get((track.number, topic))
        if known is not None:
            return known
        name, record = TOPICS[topic]
        encoding = "protobuf" if record is None else "json"
        if name not in self._schemas:
            self._schemas[name] = len(self._schemas) + 1
            data = foxglove.PROTOBUF_SCHEMAS[name] if record is None else foxglove.json_schema(record)
            described = "protobuf" if record is None else "jsonschema"
            self._write(encode_schema(Schema(self._schemas[name], name, described, data)))
        self._sequences.append(0)
        number = self._channels[track.number, topic] = len(self._channels) + 1
        path = f"/robot{track.number}/{topic}"
        self._write(encode_channel(Channel(number, self._schemas[name], path, encoding, track.metadata)))
        return number

    def _write(self, data: bytes) -> None:
        view = memoryview(data)
        while view:
            view = view[self._file.write(view) :]
        self._whole_bytes += len(data)


class Track:
    """One robot in a recording: a tap for its Stream. Frames are written a little later: do not change their bodies."""

    def __init__(self, recorder: Recorder, number: int, port: Any, dialect: Dialect) -> None:
        self.number = number
        self.frames = 0
        self.missing = Missing()
        """In all."""
        self.missing_now: Missing | None = None
        """Since the last message that was taken."""
        self.epoch_ns, clock = epoch(port)
        self.metadata = {
            "robot": str(number),
            "port": port.url,
            "framing": port.framing,
            "dialect": dialect,
            "clock": clock,
            "epoch_ns": str(self.epoch_ns),
            "version": version(),
        }
        if port.world is not None:
            self.metadata |= {"scenario": port.world.scenario.name, "seed": str(port.world.scenario.seed)}
        self._recorder = recorder

    def received(self, data: bytes | memoryview, arrival_host_ns: int) -> None:
        """What one read gave."""
        if self._recorder.without != "raw":
            self._recorder.put(self, "received", bytes(data), arrival_host_ns, len(data))

    def sent(self, data: bytes, now_ns: int) -> None:
        """What was handed to the port."""
        if self._recorder.without != "raw":
            self._recorder.put(self, "sent", data, now_ns, len(data))

    def event(self, event: Event) -> None:
        """What the session made of it."""
        topic = EVENTS.get(type(event))
        if topic is not None:
            size = event.body.nbytes if isinstance(event, Frame) else 0
            self._recorder.put(self, topic, event, event.arrival_host_ns, size)

    def messages(self, topic: str, content: Any, arrival_host_ns: int) -> list[tuple[str, tuple[Any, ...]]]:
        """(topic, parts of the message) of what was put; called by the file's thread."""
        if topic in ("received", "sent"):
            return [(topic, foxglove.raw(content))]
        made: list[tuple[str, tuple[Any, ...]]] = [(topic, (foxglove.as_json(content),))]
        if isinstance(content, Frame):
            self.frames += 1
            if self._recorder.without != "images":
                name = "compressed_image" if content.encoding == "jpeg" else "image"
                time_ns = arrival_host_ns + self.epoch_ns
                made.append((name, foxglove.image(content, time_ns, f"robot{self.number}")))
        return made

    def left_out(self, topic: str, size: int, now_ns: int) -> None:
        """Counts a message that the file has no room for now."""
        if self.missing_now is None:
            self.missing_now = Missing(first_host_ns=now_ns)
        for missing in (self.missing, self.missing_now):
            missing.last_host_ns = now_ns
            missing.received_bytes += size if topic == "received" else 0
            missing.sent_bytes += size if topic == "sent" else 0
            missing.frames += topic == "frame"
            missing.others += topic in ("stamp", "lost_frame")

    def summary(self) -> dict[str, Any]:
        """What was recorded; complete once the recorder is closed."""
        missing = {each.name: getattr(self.missing, each.name) for each in fields(Missing) if "_ns" not in each.name}
        return {"file": str(self._recorder.path), "frames": self.frames, "missing": missing}


def epoch(port: Any) -> tuple[int, str]:
    """What to add to a port's clock to get the time of a message, and what clock that is. Simulated time stays as it
    is, so that the same run gives the same file; a replay keeps the times of its recording."""
    replayed = getattr(port, "epoch_ns", None)
    if replayed is not None:
        return replayed, "recorded"
    if port.world is not None:
        return 0, "simulated"
    return time.time_ns() - port.clock_ns(), "monotonic"


def version() -> str:
    """Of this package."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("spindeck")
    except PackageNotFoundError:
        return "unknown"
