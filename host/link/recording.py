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
from pathlib import Path
from typing import Any

from ..protocol.errors import LocalError
from . import foxglove
from .dialects import Dialect
from .mcap import MAGIC, Channel, Chunk, Schema, encode_channel, encode_header, encode_schema
from .mcap_summary import finish
from .track import TOPICS, Part, Track, version

FLUSH_S = 0.2
CHUNK_BYTES = 4 << 20
"""A chunk ends earlier when it is this large."""
QUEUE_BYTES = 64 << 20
"""In memory at most, on their way to the disk."""
ITEM_BYTES = 200
"""What a small message costs in memory besides its bytes."""


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
        self._chunk = Chunk()
        self._whole_bytes = 0
        self._write(MAGIC + encode_header(f"spindeck {version()}"))
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def track(self, number: int, port: Any, dialect: Dialect) -> Track:
        """Where one robot's bytes and events go."""
        made = Track(self.put, number, port, epoch(port), dialect, self.without)
        made.file = str(self.path)
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
        chunk, held = self._chunk, 0
        for track, topic, content, arrival_host_ns, size in taken:
            held += size
            for name, parts in track.messages(topic, content, arrival_host_ns):
                channel = self._channel(track, name)
                sequence = self._sequences[channel - 1]
                self._sequences[channel - 1] = sequence + 1
                chunk.add(channel, sequence, arrival_host_ns + track.epoch_ns, arrival_host_ns, parts)
            if chunk.size >= CHUNK_BYTES:
                self._write_chunk()
                held = self._release(held)
        if chunk.size:
            self._write_chunk()
        self._release(held)
        getattr(os, "fdatasync", os.fsync)(self._file.fileno())

    def _write_chunk(self) -> None:
        self._write(*self._chunk.encode())
        self._chunk.clear()

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

    def _write(self, *parts: bytes | memoryview) -> None:
        for part in parts:
            left = memoryview(part)
            while left:
                left = left[self._file.write(left) :]
        self._whole_bytes += sum(map(len, parts))


def epoch(port: Any) -> tuple[int, str]:
    """What to add to a port's clock to get the time of a message, and what clock that is. Simulated time stays as it
    is, so that the same run gives the same file; a replay keeps the times of its recording."""
    replayed = getattr(port, "epoch_ns", None)
    if replayed is not None:
        return replayed, "recorded"
    if port.world is not None:
        return 0, "simulated"
    return time.time_ns() - port.clock_ns(), "monotonic"
