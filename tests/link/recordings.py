"""What the tests of recordings share: recording a run while remembering it, and reading with the mcap package."""

import itertools
import json
import struct
from pathlib import Path
from typing import Any

from mcap.exceptions import EndOfFile
from mcap.reader import make_reader
from mcap.records import Message
from mcap.stream_reader import StreamReader
from mcap_protobuf.decoder import DecoderFactory

import host
from host.link import recording
from host.link.frame import Frame
from host.link.records import Stamp


class Tee:
    """A tap that remembers, in front of the recorder's."""

    def __init__(self, track: recording.Track) -> None:
        self.track = track
        self.reads: list[tuple[int, bytes]] = []
        self.writes: list[tuple[int, bytes]] = []
        self.events: list[Any] = []

    def received(self, data: Any, arrival_host_ns: int) -> None:
        self.reads.append((arrival_host_ns, bytes(data)))
        self.track.received(data, arrival_host_ns)

    def sent(self, data: bytes, now_ns: int) -> None:
        self.writes.append((now_ns, data))
        self.track.sent(data, now_ns)

    def event(self, event: Any) -> None:
        self.events.append(event)
        self.track.event(event)

    def connected_again(self, now_ns: int) -> None:
        self.track.connected_again(now_ns)


def record(path: Path, *urls: str, frames: int = 5, without: recording.Part | None = None) -> list[Tee]:
    """Records so many frames (or 50 stamps) of each robot, one after the other."""
    recorder = recording.Recorder(str(path), without)
    tees = []
    for number, url in enumerate(urls):
        with host.open(url) as stream:
            tee = Tee(recorder.track(number, stream.port, "auto"))
            stream.tap = tee
            tees.append(tee)
            wanted = (event for event in stream.events() if isinstance(event, Frame | Stamp))
            list(itertools.islice(wanted, 50 if stream.port.framing == "stamps" else frames))
    recorder.close()
    return tees


class FakePort:
    """As much of a port as a recording needs."""

    url, framing, world = "fake://", "tcp", None

    def clock_ns(self) -> int:
        return 1000


def record_reads(path: Path, reads: list[tuple[int, bytes]], framing: str = "tcp") -> None:
    """A recording of exactly these."""
    port = FakePort()
    port.framing = framing
    recorder = recording.Recorder(str(path))
    track = recorder.track(0, port, "auto")
    for arrival_ns, data in reads:
        track.received(data, arrival_ns)
    recorder.close()


def read(path: Path, *topics: str) -> list[tuple[str, Any, Any]]:
    """(topic, message, decoded) in the file's order, every check made."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        rows = []
        for schema, channel, message in reader.iter_messages(topics=topics or None, log_time_order=False):
            if channel.message_encoding == "json":
                decoded = json.loads(message.data)
            else:
                decoded = DecoderFactory().decoder_for("protobuf", schema)(message.data)
            rows.append((channel.topic, message, decoded))
        return rows


def summary(path: Path) -> Any:
    with path.open("rb") as file:
        return make_reader(file, validate_crcs=True).get_summary()


def in_complete_chunks(file: Any) -> list[tuple[int, int, int, bytes]]:
    """The messages of a file that may have no end, read from its beginning: channel, sequence, time, data."""
    found = []
    try:
        for each in StreamReader(file, validate_crcs=True).records:
            if isinstance(each, Message):
                found.append((each.channel_id, each.sequence, each.log_time, each.data))
    except (EndOfFile, struct.error):
        pass
    return found
