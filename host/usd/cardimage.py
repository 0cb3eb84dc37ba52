"""The files of a card, from its image: logs as they are on it, without mounting it and without root. Cards that lost
their power are what this is for: a directory or a chain of clusters that is damaged costs what it cannot lead to.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import mmap

from ..protocol.errors import LocalError
from .fat import SECTOR, Chain, Fault, Volume

Buffer = bytes | bytearray | memoryview | mmap
ENTRY_BYTES = 32
LONG_NAME, VOLUME_LABEL, FOLDER = 0x0F, 0x08, 0x10
LONG_NAME_AT = (slice(1, 11), slice(14, 26), slice(28, 32))
FOLDERS_MAX = 1000
SHOWN = 10
LOG_MAGIC = b"\xbc"
LOG_NAME = re.compile(r"/[^/.]+\d\d$")
"""What is given in config.txt, and two digits."""


@dataclass(frozen=True, slots=True)
class CardFile:
    path: str
    """From the root, with its slash."""
    short_path: str
    """By short names, which FAT gives to all."""
    size: int
    """As its directory says."""
    cluster: int
    sector: int
    """Of its entry in the directory."""
    is_folder: bool


@dataclass(frozen=True, slots=True)
class Content:
    data: bytes
    """Of `size`, fewer bytes if its clusters run out; more if it has more, as what is written in them may be of a log
    whose size was still to be noted."""
    faults: tuple[Fault, ...]


class CardImage:
    """`files` are in the order of their directories; `faults` are those found on the way to them."""

    def __init__(self, source: Buffer) -> None:
        """PeerError if it is no FAT volume."""
        self.volume = Volume(memoryview(source).cast("B"))
        self.faults: list[Fault] = []
        if not self.volume.boot.is_listed:
            begin = self.volume.boot.start // SECTOR
            self.faults.append(Fault(0, f"no table of partitions; a volume was found in sector {begin}"))
        self._chains: dict[int, Chain] = {}
        """By their first cluster: every file is held against all others."""
        self.files = list(self._walk())

    def find(self, path: str) -> CardFile:
        """By its long or its short name, in upper or lower case: to FAT they are the same. LocalError: no such file."""
        wanted = "/" + path.strip("/").lower()
        for each in self.files:
            if wanted in (each.path.lower(), each.short_path.lower()) and not each.is_folder:
                return each
        paths = [each.path for each in self.files if not each.is_folder]
        more = f" and {len(paths) - SHOWN} more" if len(paths) > SHOWN else ""
        there = f"there are {', '.join(paths[:SHOWN])}{more}" if paths else "it has no files"
        raise LocalError(f"no file {wanted} on this card; {there}")

    def read(self, file: CardFile) -> Content:
        chain = self._chain_of(file)
        faults = list(chain.faults)
        room = len(chain.clusters) * self.volume.boot.cluster_bytes
        size = file.size
        parts = [self.volume.cluster(number) for number in chain.clusters]
        short = next((at for at, part in enumerate(parts) if len(part) < self.volume.boot.cluster_bytes), len(parts))
        data = b"".join(parts[: short + 1])
        if short < len(parts):
            faults.append(Fault(len(self.volume.data) // SECTOR, "the image ends here, its files do not"))
        elif room < size:
            faults.append(Fault(file.sector, f"{size} bytes, says the directory: there are clusters for {room}"))
        elif room - size >= self.volume.boot.cluster_bytes:
            faults.append(Fault(file.sector, f"{size} bytes, says the directory: all {room} of its clusters were read"))
            size = room
        return Content(data[:size], (*faults, *self._shared(file, chain)))

    def is_log(self, file: CardFile) -> bool:
        """By its first byte; or by its name, if that byte was never written."""
        first = bytes(self.volume.cluster(file.cluster)[:1]) if self.volume.has(file.cluster) else b""
        return not file.is_folder and (first == LOG_MAGIC or LOG_NAME.search(file.path) is not None)

    def _chain_of(self, file: CardFile) -> Chain:
        if file.cluster == 0 and file.size == 0:
            return Chain([])
        if not self.volume.has(file.cluster):
            return Chain([], [Fault(file.sector, f"begins in cluster {file.cluster}, which there is not")])
        if file.cluster not in self._chains:
            self._chains[file.cluster] = self.volume.chain(file.cluster)
        return self._chains[file.cluster]

    def _shared(self, file: CardFile, chain: Chain) -> Iterator[Fault]:
        own = set(chain.clusters)
        for other in self.files:
            if other != file and (both := own.intersection(self._chain_of(other).clusters)):
                first = self.volume.place(next(each for each in chain.clusters if each in both)) // SECTOR
                yield Fault(first, f"{other.path} has this cluster too, and {len(both) - 1} more: one of them is wrong")

    def _walk(self) -> Iterator[CardFile]:
        """All files and folders, folder by folder."""
        boot = self.volume.boot
        if boot.bits == 32:
            root = self._folder(self.volume.chain(boot.root_cluster if self.volume.has(boot.root_cluster) else 2))
        else:
            root = [(boot.root_at, self.volume.data[boot.root_at : boot.root_at + boot.root_bytes])]
        folders = [("", "", root)]
        seen = {boot.root_cluster}
        for above, short_above, parts in folders:
            for file in self._entries(above, short_above, parts):
                yield file
                if not file.is_folder:
                    continue
                if not self.volume.has(file.cluster) or file.cluster in seen or len(folders) >= FOLDERS_MAX:
                    self.faults.append(Fault(file.sector, f"folder {file.path} leads nowhere, or back"))
                    continue
                seen.add(file.cluster)
                inside = self._folder(self.volume.chain(file.cluster))
                folders.append((file.path, file.short_path, inside))

    def _folder(self, chain: Chain) -> list[tuple[int, memoryview]]:
        self.faults += chain.faults
        return [(self.volume.place(number), self.volume.cluster(number)) for number in chain.clusters]

    def _entries(self, above: str, short_above: str, parts: list[tuple[int, memoryview]]) -> Iterator[CardFile]:
        long_name: dict[int, bytes] = {}
        check = 0
        for place, data in parts:
            for at in range(0, len(data) - ENTRY_BYTES + 1, ENTRY_BYTES):
                entry = bytes(data[at : at + ENTRY_BYTES])
                attributes = entry[11]
                if entry[0] == 0:
                    return
                if attributes & 0x3F == LONG_NAME and entry[0] != 0xE5:
                    if entry[0] & 0x40:
                        long_name, check = {}, entry[13]
                    if entry[13] == check:
                        long_name[entry[0] & 0x1F] = b"".join(entry[part] for part in LONG_NAME_AT)
                    continue
                parts_of_name, long_name = long_name, {}
                if entry[0] in b"\xe5." or attributes & VOLUME_LABEL:
                    continue
                sector = (place + at) // SECTOR
                short = short_name(entry)
                if not short or attributes & 0xC0:
                    self.faults.append(Fault(sector, f"no entry of a directory: {entry[:11]!r}"))
                    continue
                name = joined(parts_of_name) if check == checksum(entry[:11]) else ""
                cluster = int.from_bytes(entry[26:28], "little")
                if self.volume.boot.bits == 32:
                    cluster |= int.from_bytes(entry[20:22], "little") << 16
                size = int.from_bytes(entry[28:32], "little")
                folder = bool(attributes & FOLDER)
                path = f"{above}/{name or short}"
                yield CardFile(path, f"{short_above}/{short}", size, cluster, sector, folder)


def short_name(entry: bytes) -> str:
    """Empty: it cannot be one. Two bits say which halves a computer should show in lower case."""
    name = (b"\xe5" + entry[1:8] if entry[0] == 0x05 else entry[:8]).rstrip(b" ").decode("cp437")
    ending = entry[8:11].rstrip(b" ").decode("cp437")
    if not name or any(each < " " or each in '"*+,./:;<=>?[\\]|' for each in name + ending):
        return ""
    name = name.lower() if entry[12] & 0x08 else name
    ending = ending.lower() if entry[12] & 0x10 else ending
    return f"{name}.{ending}" if ending else name


def joined(parts: dict[int, bytes]) -> str:
    """A long name; empty if a part of it is missing, or it cannot be shown."""
    if sorted(parts) != list(range(1, len(parts) + 1)):
        return ""
    name = b"".join(parts[number] for number in sorted(parts)).decode("utf-16-le", "replace").split("\0")[0]
    return name if name.isprintable() and "/" not in name else ""


def checksum(short: bytes) -> int:
    """Of a short name, in each part of its long one."""
    total = 0
    for byte in short:
        total = ((total & 1) << 7 | total >> 1) + byte & 0xFF
    return total
