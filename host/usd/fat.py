"""A FAT12, FAT16 or FAT32 volume in the bytes of a card: its clusters and how they follow each other. Only read, and
believed no further than it makes sense: each thing that is wrong is told with its sector, the rest is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from ..protocol.errors import PeerError

SECTOR = 512
"""By which places on the card are told, whatever the volume's own sectors are."""
PARTITIONS_AT, PARTITION_BYTES = 446, 16
BACKUP_SECTOR = 6
SEARCHED = 8192
"""Sectors: cards of 4 GB and more have their volume behind 4 MiB, others earlier."""
SIGNATURE = b"\x55\xaa"


@dataclass(frozen=True, slots=True)
class Fault:
    """Something on the card that cannot be right."""

    sector: int
    why: str

    def __str__(self) -> str:
        return f"sector {self.sector} of the card: {self.why}"


@dataclass(frozen=True, slots=True)
class Boot:
    """What a boot sector says, in bytes of the card."""

    start: int
    hidden: int
    """Where it believes to begin."""
    bits: int
    cluster_bytes: int
    fats: tuple[int, ...]
    """Where each copy begins."""
    fat_bytes: int
    root_at: int
    root_bytes: int
    """Of FAT12 and FAT16; the root of FAT32 is a file."""
    root_cluster: int
    data: int
    clusters: int
    is_listed: bool = True
    """False: no table of partitions led to it."""


@dataclass(frozen=True, slots=True)
class Chain:
    clusters: list[int]
    faults: list[Fault] = field(default_factory=list)


class Volume:
    def __init__(self, data: memoryview) -> None:
        """PeerError if there is none."""
        self.data = data
        self.boot = find_volume(data)
        self._tables = [entries(data[at : at + self.boot.fat_bytes], self.boot.bits) for at in self.boot.fats]
        self._end = (1 << min(self.boot.bits, 28)) - 8

    def chain(self, first: int) -> Chain:
        """The clusters from this one on, as far as they follow each other."""
        found: Chain = Chain([])
        seen: set[int] = set()
        at, before = first, first
        while at < self._end:
            if at in seen:
                found.faults.append(self._fault(before, f"the chain of clusters comes back to cluster {at}"))
                break
            seen.add(at)
            found.clusters.append(at)
            before, at = at, self._next(at, found.faults)
            if not self.has(at) and at < self._end:
                what = "a free cluster" if at == 0 else f"cluster {at}, which there is not"
                found.faults.append(self._fault(before, f"the chain of clusters runs into {what}"))
                break
        return found

    def has(self, cluster: int) -> bool:
        return 2 <= cluster < self.boot.clusters + 2

    def cluster(self, number: int) -> memoryview:
        begin = self.place(number)
        return self.data[begin : begin + self.boot.cluster_bytes]

    def place(self, cluster: int) -> int:
        """In bytes of the card."""
        return self.boot.data + (cluster - 2) * self.boot.cluster_bytes

    def _next(self, cluster: int, faults: list[Fault]) -> int:
        """By the first FAT; by the second where the first makes no sense."""
        said = [self._entry(table, cluster) for table in self._tables]
        for number, entry in enumerate(said):
            if entry >= self._end or self.has(entry):
                why = "the first FAT makes no sense here: the second was used"
                if number and (fault := self._fault(cluster, why)) not in faults:
                    faults.append(fault)
                return entry
        return said[0]

    def _entry(self, table: Sequence[int], cluster: int) -> int:
        try:
            if self.boot.bits == 12:
                at = cluster * 3 // 2
                pair = table[at] | table[at + 1] << 8
                return pair >> 4 if cluster & 1 else pair & 0xFFF
            return table[cluster] & (0xFFFF if self.boot.bits == 16 else 0x0FFFFFFF)
        except IndexError:
            return 0  # The image ends here.

    def _fault(self, cluster: int, why: str) -> Fault:
        """Of a cluster's entry in the first FAT."""
        return Fault((self.boot.fats[0] + cluster * self.boot.bits // 8) // SECTOR, why)


def entries(table: memoryview, bits: int) -> Sequence[int]:
    """Of a FAT; of FAT12 its bytes, as there two entries share three."""
    whole = table[: len(table) // 4 * 4]
    if bits == 12:
        return whole
    return whole.cast("H") if bits == 16 else whole.cast("I")


def find_volume(data: memoryview) -> Boot:
    """On the whole card, or in the first partition that has one; FAT32 has a second boot sector. Where that leads to
    nothing, a boot sector that says itself where it lies."""
    partitions = [
        int.from_bytes(data[at + 8 : at + 12], "little") * SECTOR
        for at in range(PARTITIONS_AT, PARTITIONS_AT + 4 * PARTITION_BYTES, PARTITION_BYTES)
        if bytes(data[510:512]) == SIGNATURE and data[at + 4]
    ]
    for start in [0, *partitions]:
        for at in (start, start + BACKUP_SECTOR * SECTOR):
            if boot := read_boot(data, start, at):
                return boot
    for at in range(0, min(SEARCHED * SECTOR + SECTOR, len(data)), SECTOR):
        if bytes(data[at + 510 : at + 512]) == SIGNATURE and (boot := read_boot(data, at, at)) and boot.hidden == at:
            return replace(boot, is_listed=False)
    for start in [0, *partitions]:
        if bytes(data[start + 3 : start + 11]) == b"EXFAT   ":
            raise PeerError("an exFAT card: the firmware's file system cannot have written it, and it is not read here")
    raise PeerError("not the image of a FAT card")


def read_boot(data: memoryview, start: int, at: int) -> Boot | None:
    """None: this is no boot sector of FAT."""

    def number(offset: int, size: int) -> int:
        return int.from_bytes(data[at + offset : at + offset + size], "little")

    sector, per_cluster, reserved, copies = number(11, 2), number(13, 1), number(14, 2), number(16, 1)
    if (
        bytes(data[at + 510 : at + 512]) != SIGNATURE
        or sector not in (512, 1024, 2048, 4096)
        or per_cluster == 0
        or per_cluster & (per_cluster - 1)
        or not (reserved and copies)
    ):
        return None
    fat_bytes = (number(22, 2) or number(36, 4)) * sector
    sectors = number(19, 2) or number(32, 4)
    root_at = start + reserved * sector + copies * fat_bytes
    root_bytes = number(17, 2) * 32
    first = root_at + -(-root_bytes // sector) * sector
    clusters = (sectors * sector - (first - start)) // (per_cluster * sector)
    bits = 12 if clusters < 4085 else 16 if clusters < 65525 else 32
    if fat_bytes == 0 or clusters <= 0 or (bits == 32) != (root_bytes == 0):
        return None
    fats = tuple(start + reserved * sector + copy * fat_bytes for copy in range(copies))
    root_cluster = number(44, 4) if bits == 32 else 0
    hidden = number(28, 4) * SECTOR
    sizes = per_cluster * sector, fats, fat_bytes, root_at, root_bytes, root_cluster, first, clusters
    return Boot(start, hidden, bits, *sizes)
