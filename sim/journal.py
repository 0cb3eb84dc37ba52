"""What was done to a world from outside, each with its true time: enough to repeat the run exactly.

Reads are a special case. They matter only when the host leaves so much unread that TCP's window begins to close;
then they are kept, from the moment when the host last had read everything. All others would make the log as long as
the stream, and are left out: a replay reads along freely where the log says nothing.
Writes on a UART are many (a credit for each packet) and small: they are packed, 26 bytes for a credit.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

Record = dict[str, Any]
"""JSON-able. `t`: true ns; `n`: order among equal times; `do`: what; the rest are its arguments."""


WRITE = struct.Struct("<qQII")
"""t, n, robot, size; the bytes follow."""


@dataclass
class _Reads:
    """One robot's, since the host last had read everything."""

    start: tuple[int, int] = (0, 0)
    """t, n of that moment."""
    reads: list[list[int]] = field(default_factory=list)
    """t, n, bytes."""
    matter: bool = False


class Journal:
    """The log of one world."""

    def __init__(self, safe_bytes: list[int]) -> None:
        """`safe_bytes`, of each robot: unread bytes up to here never hold up the robot."""
        self._records: list[Record] = []
        self._writes = bytearray()
        self._count = 0
        self._safe_bytes = safe_bytes
        self._reads = [_Reads() for _ in safe_bytes]

    def add(self, t: int, do: str, **arguments: Any) -> None:
        self._count += 1
        self._records.append({"t": t, "n": self._count, "do": do, **arguments})

    def write(self, t: int, robot: int, data: bytes) -> None:
        """The host has sent `data`."""
        self._count += 1
        self._writes += WRITE.pack(t, self._count, robot, len(data)) + data

    def read(self, t: int, robot: int, available: int, size: int) -> None:
        """The host has read `size` of `available` bytes."""
        self._count += 1
        own = self._reads[robot]
        own.matter |= available > self._safe_bytes[robot]
        own.reads.append([t, self._count, size])
        if size == available:
            if own.matter:
                self._records.append({**self._held(robot), "all": True})
            self._reads[robot] = _Reads(start=(t, self._count))

    def records(self, available: list[int]) -> list[Record]:
        """All, in order. `available`, of each robot: unread now."""
        open_reads = [
            self._held(robot)
            for robot, own in enumerate(self._reads)
            if own.matter or available[robot] > self._safe_bytes[robot]
        ]
        return sorted([*self._records, *self._written(), *open_reads], key=lambda record: (record["t"], record["n"]))

    def _written(self) -> Iterator[Record]:
        at = 0
        while at < len(self._writes):
            t, n, robot, size = WRITE.unpack_from(self._writes, at)
            at += WRITE.size + size
            yield {"t": t, "n": n, "do": "write", "robot": robot, "hex": self._writes[at - size : at].hex()}

    def _held(self, robot: int) -> Record:
        """From `t` on, when all had been read, the host read exactly this, and with `all` then had all again."""
        own = self._reads[robot]
        start, n = own.start
        return {"t": start, "n": n, "do": "reads", "robot": robot, "reads": own.reads, "all": False}
