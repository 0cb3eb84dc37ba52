"""What of one robot goes into a recording: its topics, and the messages that its bytes and events become. Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal

from . import foxglove
from .dialects import Dialect
from .frame import Frame, LostFrame
from .records import Event, LogStatus, NanocockpitStamp, PaperStamp, Stamp

Part = Literal["images", "raw"]
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
    """Stamps, lost frames, the card's log and new connections."""


@dataclass(frozen=True, slots=True)
class Connection:
    """The robot was connected again: what it sent before has no continuation."""

    arrival_host_ns: int


TOPICS: dict[str, tuple[str, Any]] = {
    "received": ("spindeck.Bytes", None),
    "sent": ("spindeck.Bytes", None),
    "image": ("foxglove.RawImage", None),
    "compressed_image": ("foxglove.CompressedImage", None),
    "frame": ("spindeck.Frame", Frame),
    "lost_frame": ("spindeck.LostFrame", LostFrame),
    "stamp": ("spindeck.Stamp", Stamp),
    "paper_stamp": ("spindeck.PaperStamp", PaperStamp),
    "nanocockpit_stamp": ("spindeck.NanocockpitStamp", NanocockpitStamp),
    "log_status": ("spindeck.LogStatus", LogStatus),
    "connection": ("spindeck.Connection", Connection),
    "missing": ("spindeck.Missing", Missing),
}
"""Of each robot: the schema, and the record that it is JSON of; else it is protobuf."""
EVENTS: dict[type[Any], str] = {
    Frame: "frame",
    LostFrame: "lost_frame",
    Stamp: "stamp",
    PaperStamp: "paper_stamp",
    NanocockpitStamp: "nanocockpit_stamp",
    LogStatus: "log_status",
}
"""What else a session reports can be had again from the raw bytes."""

Put = Callable[["Track", str, Any, int, int], None]
"""Takes a message: track, topic, content, arrival_host_ns, size."""


class Track:
    """One robot in a recording: a tap for its Stream. Frames are written a little later: do not change their bodies."""

    def __init__(
        self, put: Put, number: int, port: Any, epoch: tuple[int, str], dialect: Dialect, without: Part | None
    ) -> None:
        """`epoch`: what to add to the port's clock to get the time of a message, and what clock that is."""
        self.number = number
        self.file = ""
        self.without = without
        self.frames = 0
        self.missing = Missing()
        """In all."""
        self.missing_now: Missing | None = None
        """Since the last message that was taken."""
        self.epoch_ns, clock = epoch
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
        self._put = put

    def received(self, data: bytes | memoryview, arrival_host_ns: int) -> None:
        """What one read gave."""
        if self.without != "raw":
            self._put(self, "received", bytes(data), arrival_host_ns, len(data))

    def sent(self, data: bytes, now_ns: int) -> None:
        """What was handed to the port."""
        if self.without != "raw":
            self._put(self, "sent", data, now_ns, len(data))

    def event(self, event: Event) -> None:
        """What the session made of it."""
        topic = EVENTS.get(type(event))
        if topic is not None:
            size = event.body.nbytes if isinstance(event, Frame) else 0
            self._put(self, topic, event, event.arrival_host_ns, size)

    def connected_again(self, now_ns: int) -> None:
        """Begins the bytes of the next connection."""
        self._put(self, "connection", Connection(now_ns), now_ns, 0)

    def messages(self, topic: str, content: Any, arrival_host_ns: int) -> list[tuple[str, tuple[Any, ...]]]:
        """(topic, parts of the message) of what was put; called by the file's thread."""
        if topic in ("received", "sent"):
            return [(topic, foxglove.raw(content))]
        made: list[tuple[str, tuple[Any, ...]]] = [(topic, (foxglove.as_json(content),))]
        if isinstance(content, Frame):
            self.frames += 1
            if self.without != "images":
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
            missing.others += topic not in ("received", "sent", "frame")

    def summary(self) -> dict[str, Any]:
        """What was recorded; complete once the recorder is closed."""
        missing = {each.name: getattr(self.missing, each.name) for each in fields(Missing) if "_ns" not in each.name}
        return {"file": self.file, "frames": self.frames, "missing": missing}


def version() -> str:
    """Of this package."""
    from importlib.metadata import PackageNotFoundError
    from importlib.metadata import version as installed

    try:
        return installed("spindeck")
    except PackageNotFoundError:
        return "unknown"
