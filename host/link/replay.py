"""Recordings read back: which robots are in a file, and what each of them sent, read by read, with its time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Literal, cast, get_args

from ..protocol.errors import LocalError
from . import foxglove
from .mcap import CHUNK, Channel, DamagedError, Message, read_chunk_head, read_messages, split, walk
from .mcap_summary import ChunkIndex, Summary, read_summary
from .session import FRAMINGS, Framing

Joint = Literal["connection", "missing"]
"""Where bytes do not continue those before: the robot was connected again, or the disk was too slow for some."""


@dataclass(frozen=True, slots=True)
class Source:
    """One robot's side of a recording."""

    number: int
    channel_id: int
    joints: Mapping[int, Joint]
    """Channels that tell of them."""
    framing: Framing
    epoch_ns: int
    """What was added to its port's clock to get the time of a message."""
    metadata: Mapping[str, str]


class Recording:
    """A whole recording, open for reading. Memory: one chunk, and an index."""

    def __init__(self, path: str) -> None:
        self.path = path
        try:
            self._file: IO[bytes] = Path(path).open("rb")  # noqa: SIM115 - closed by close()
        except OSError as error:
            raise LocalError(f"{path}: {error.strerror}") from error
        try:
            self._summary: Summary = read_summary(self._file)
            self.sources = {each.number: each for each in self._sources()}
            if not self.sources:
                raise LocalError("no robot's bytes are in it: an MCAP file of something else, or recorded without raw")
        except LocalError as error:
            self._file.close()
            raise LocalError(f"{path}: {error}") from error

    def close(self) -> None:
        self._file.close()

    def source(self, robot: int | None) -> Source:
        """A robot of this recording; None: the only one, or the first."""
        number = min(self.sources) if robot is None else robot
        if number not in self.sources:
            there = ", ".join(str(each) for each in sorted(self.sources))
            raise LocalError(f"{self.path}: no robot {number} in it, only {there}")
        return self.sources[number]

    def reads(self, source: Source, from_ns: int = 0) -> Iterator[tuple[int, memoryview | Joint]]:
        """(arrival_host_ns, bytes) of each read from that time on, as they were recorded, and where they do not
        continue those before. LocalError where damaged."""
        for chunk in self._summary.chunks:
            if chunk.head.last_ns >= from_ns + source.epoch_ns:
                yield from self._of_chunk(chunk, source, from_ns)

    def span_ns(self, source: Source) -> tuple[int, int]:
        """Arrival of its first bytes and of its last."""
        first = next(self.reads(source), None)
        if first is None:
            raise LocalError(f"{self.path}: robot {source.number} sent nothing")
        for chunk in reversed(self._summary.chunks):
            times = [arrival_ns for arrival_ns, _ in self._of_chunk(chunk, source, 0)]
            if times:
                return first[0], times[-1]
        raise AssertionError("reads() found something")

    def _of_chunk(self, chunk: ChunkIndex, source: Source, from_ns: int) -> Iterator[tuple[int, memoryview | Joint]]:
        if chunk.message_indexes and not {source.channel_id, *source.joints} & chunk.message_indexes.keys():
            return
        try:
            for opcode, at, length in walk(self._file, chunk.offset, chunk.offset + chunk.length):
                if opcode != CHUNK:
                    raise DamagedError(at, "no chunk is where the index says")
                head = read_chunk_head(self._file, at, length)
                for each in split(read_messages(self._file, head, at), at):
                    if not isinstance(each, Message) or each.publish_ns < from_ns:
                        continue
                    if each.channel_id == source.channel_id:
                        yield each.publish_ns, foxglove.read_raw(each.data)
                    elif each.channel_id in source.joints:
                        yield each.publish_ns, source.joints[each.channel_id]
        except (DamagedError, ValueError) as error:
            raise LocalError(f"{self.path}: {error}; 'host recover' makes a file of what is whole") from error

    def _sources(self) -> Iterator[Source]:
        topics = {channel.topic: channel.id for channel in self._summary.channels.values()}
        for channel in self._summary.channels.values():
            schema = self._summary.schemas.get(channel.schema_id)
            if schema is None or schema.name != "spindeck.Bytes" or not channel.topic.endswith("/received"):
                continue
            prefix = channel.topic.removesuffix("received")
            joints = {topics[prefix + name]: name for name in get_args(Joint) if prefix + name in topics}
            yield source_of(channel, joints)


def source_of(channel: Channel, joints: Mapping[int, Joint]) -> Source:
    """LocalError when its metadata does not say what the bytes are."""
    try:
        number, epoch_ns = int(channel.metadata["robot"]), int(channel.metadata["epoch_ns"])
        framing = channel.metadata["framing"]
        if framing not in FRAMINGS:
            raise ValueError(f"framing {framing!r}")
    except (KeyError, ValueError) as error:
        raise LocalError(f"{channel.topic}: the metadata is not that of a recording ({error})") from error
    return Source(number, channel.id, joints, cast(Framing, framing), epoch_ns, channel.metadata)
