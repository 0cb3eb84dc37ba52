"""The sectors of a card, as FatFs reaches them: what it has done is kept in order, and some of it goes wrong."""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

from .card_format import SECTOR

ZEROS = bytes(SECTOR)


@dataclass(frozen=True, slots=True)
class Command:
    """One of the SPI bus."""

    write: bool
    count: int
    """Sectors; one: CMD17 or CMD24, more: CMD18 or CMD25."""


class Request(NamedTuple):
    """One of the storage port, answered."""

    request: bytes
    answer: bytes
    writes: int
    """How many there were then."""
    end_ns: int
    """True time of the answer."""


@dataclass
class Recording:
    """Everything that has been written to a card since a moment, to be played again onto a copy."""

    base: dict[int, bytes]
    """The card at that moment; sectors that are not there are zero."""
    writes: list[tuple[int, bytes]] = field(default_factory=list)
    barriers: list[int] = field(default_factory=list)
    """How many writes there were each time FatFs waited until everything was on the card."""
    requests: list[Request] = field(default_factory=list)


class Sectors:
    """FatFs's package asks a table of disks for a disk; this is both.

    A read or write of it cannot say that it failed: the package calls that success, whatever is raised. So the first
    one that fails is remembered, what FatFs still does in the same call fails because no disk is found, and
    card_fatfs.py makes the call an error.
    """

    def __init__(self, count: int, sectors: dict[int, bytes], bad: float, bad_from: int, seed: int) -> None:
        self.count = count
        self.sectors = sectors
        self.present = True
        self.failed: Literal["", "read", "write"] = ""
        """What has gone wrong since the caller has last set it."""
        self.bad_sectors: set[int] = set()
        self.recording: Recording | None = None
        self.commands: list[Command] = []
        """Since begin()."""
        self.replaced: list[tuple[int, bytes]] = []
        """What was in each sector that was written since begin()."""
        self._bad, self._bad_from, self._seed = int(bad * 2**32), bad_from, seed

    def begin(self) -> None:
        self.commands, self.replaced = [], []

    def is_bad(self, sector: int) -> bool:
        if sector in self.bad_sectors:
            return True
        chance = zlib.crc32(b"%d %d" % (self._seed, sector))
        return sector >= self._bad_from and chance < self._bad

    def undo(self, count: int, torn_at: int) -> None:
        """Takes back the last writes; of the first of them so many bytes have been written."""
        for number, (sector, old) in enumerate(reversed(self.replaced[len(self.replaced) - count :]), 1):
            new = self.sectors[sector]
            self.sectors[sector] = new[:torn_at] + old[torn_at:] if number == count else old
            if self.recording is not None:
                self.recording.writes.pop()
                if number == count:
                    self.recording.writes.append((sector, self.sectors[sector]))
        if self.recording is not None:
            self.recording.barriers = [each for each in self.recording.barriers if each < len(self.recording.writes)]

    # Called by FatFs.

    def __contains__(self, drive: int) -> bool:
        """False: FatFs hears that there is no disk."""
        return self.present and not self.failed

    def __getitem__(self, drive: int) -> Sectors:
        return self

    def ioctl_get_sector_count(self) -> int:
        return self.count

    def ioctl_get_sector_size(self) -> int:
        return SECTOR

    def ioctl_get_block_size(self) -> int:
        return 1

    def ioctl_sync(self) -> None:
        if self.recording is not None:
            self.recording.barriers.append(len(self.recording.writes))

    def read(self, sector: int, size: int) -> bytes:
        places = range(sector, sector + size // SECTOR)
        self.commands.append(Command(False, len(places)))
        if any(self.is_bad(place) for place in places):
            self.failed = "read"
            return bytes(size)
        return b"".join(self.sectors.get(place, ZEROS) for place in places)

    def write(self, sector: int, size: int, data: bytes) -> None:
        self.commands.append(Command(True, size // SECTOR))
        for place, new in zip(range(sector, sector + size // SECTOR), split(data), strict=True):
            if self.is_bad(place):
                self.failed = "write"
                return
            self.replaced.append((place, self.sectors.get(place, ZEROS)))
            self.sectors[place] = new
            if self.recording is not None:
                self.recording.writes.append((place, new))


def split(data: bytes) -> Iterator[bytes]:
    for at in range(0, len(data), SECTOR):
        yield data[at : at + SECTOR]
