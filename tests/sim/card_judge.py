"""What a card must hold after a power cut, by fsck.fat, by our reader and by others."""

import mmap
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from card_flights import Flight
from card_model import Model, Rate, Rows
from other_readers import by_mtools, by_pyfatfs

from host.usd.cardimage import CardImage
from host.usd.decode import decode
from sim.card import Card
from sim.card_format import SECTOR
from sim.card_sectors import ZEROS

CRC_BYTES = 4
HARMLESS = [
    r"fsck\.fat 4\.\d.*",
    r"\S+: \d+ files, \d+/\d+ clusters",
    r"",
    r"Leaving filesystem unchanged\.",
    # The first FAT was written, the second was not.
    r"FATs differ but appear to be intact\.",
    r"  Using first FAT\.",
    # Allocated, and of no file yet.
    r"Reclaimed \d+ unused clusters? \(\d+ bytes\)\.",
    # A file has grown or is cut back, and its size is still to be noted; what it has lost was never of the log.
    r"/(?!.* and$).+",
    r"  File size is \d+ bytes, cluster chain length is (> )?\d+ bytes\.",
    r"  Truncating file to \d+ bytes\.",
    # Likewise, or its size was noted before its clusters: only with writes out of order.
    r"  Contains a free cluster \(\d+\)\. Assuming EOF\.",
    # The first FAT is torn in the middle of an entry.
    r"Cluster \d+ out of range \(\d+ > \d+\)\. Setting to EOF\.",
    r"  Circular cluster chain\. Truncating to \d+ clusters\.",
    # Counted after they were taken.
    r"Free cluster summary wrong \(\d+ vs\. really \d+\)",
    r"  Auto-correcting\.",
]
"""Lines of fsck.fat that a power cut may lead to."""


class Image:
    """The partition as a file, for fsck.fat and for our reader; it changes as the card does."""

    def __init__(self, flight: Flight, path: Path) -> None:
        self.start = flight.card.layout.start
        self.path = path
        with path.open("w+b") as file:
            file.truncate((flight.card.layout.sectors - self.start) * SECTOR)
            self.map = mmap.mmap(file.fileno(), 0)
        self.put(flight.recording.base)

    def put(self, sectors: dict[int, bytes]) -> None:
        for sector, data in sectors.items():
            at = (sector - self.start) * SECTOR
            if at >= 0:
                self.map[at : at + SECTOR] = data


def fsck(path: Path) -> list[str]:
    """What fsck.fat says that is no harm; anything else is an AssertionError."""
    found = subprocess.run(["fsck.fat", "-n", path], capture_output=True, text=True)
    lines = (found.stdout + found.stderr).splitlines()
    bad = [line for line in lines if not any(re.fullmatch(each, line) for each in HARMLESS)]
    assert found.returncode in (0, 1), (found.returncode, lines)
    assert not bad, lines
    return lines


def mended(image: Image, flight: Flight, count: int) -> None:
    """A computer that finds the card not in order mends it: that takes nothing that a sync had covered."""
    layout = flight.card.layout
    directory = layout.data + layout.cluster_sectors  # FAT32 has it in the first cluster, the others before that.
    size = (directory - image.start) * SECTOR
    before = bytes(image.map[:size])
    try:
        subprocess.run(["fsck.fat", "-a", image.path], capture_output=True)
        judge(image, flight, count)
        again = subprocess.run(["fsck.fat", "-n", image.path], capture_output=True, text=True)
        assert again.returncode == 0, again.stdout
    finally:
        image.map[:size] = before


@dataclass(frozen=True)
class Found:
    """After a cut, of all files."""

    promised: int
    verified: int
    returned: int
    """Bytes of rows that were recovered."""
    newest_us: int
    """Stamp of the last verified row; 0: there is none."""


def judge(image: Image, flight: Flight, count: int) -> Found:
    """The card, when so many writes were certainly done. AssertionError: a promise is broken, or something wrong is
    called verified."""
    card = CardImage(image.map)
    totals = np.zeros(3, int)
    newest_us = 0
    paths = {each.path for each in card.files}
    for name, file in flight.files.items():
        promised = file.promised(count)
        if f"/{name}" not in paths:
            assert not promised, f"{name} is gone, with {promised} bytes that a sync had covered; there are {paths}"
            continue
        content = card.read(card.find(name))
        data = content.data
        if not promised and content.faults:
            continue  # Its entry is torn, or was written before its clusters: the reader says so.
        assert data[:promised] == file.content[:promised], f"{name}: bytes that a sync had covered are wrong"
        log = decode(data)
        if not promised and not any(len(rows) for kind, rows in log.rows.items() if kind != "log.status"):
            continue  # Its first sector was never written: an older log's header is there, and its first status row.
        for each in log.verified:
            assert data[each.begin : each.end] == file.content[each.begin : each.end], f"{name}: {each} is wrong"
        verified = max((each.end for each in log.verified if each.begin == 0), default=0)
        verified += CRC_BYTES * log.is_whole
        assert verified >= promised, f"{name}: a sync had covered {promised} bytes, {verified} are verified"
        totals += promised, verified, sum(part.end - part.begin for part in log.parts)
        for kind, rows in flight.given.items():
            if kind in log.rows:
                mine = log.rows[kind].data[log.rows[kind].is_verified]
                assert (mine == rows[: len(mine)]).all(), f"{name}: {kind}: verified rows that were never given"
                newest_us = max(newest_us, int(mine["stamp_stm32_us"].max(initial=0)))
    return Found(*totals.tolist(), newest_us)


def same_as_others(image: Image) -> None:
    """mtools and pyfatfs read what we read, where nothing is wrong with the files."""
    card = CardImage(image.map)
    whole = {each.path: card.read(each) for each in card.files}
    expected = {path: content.data for path, content in whole.items() if not content.faults}
    image.map.flush()
    assert by_pyfatfs(image.path, 0, list(expected)) == expected
    if shutil.which("mtype"):
        assert {path: by_mtools(image.path, 0, path) for path in expected} == expected


def flies_again(image: Image, flight: Flight, sectors: dict[int, bytes], count: int) -> None:
    """The robot boots, and logs on the card as the cut has left it: both logs are on it then."""
    card = Card(flight.card.layout.sectors * SECTOR >> 20, seed=count)
    card.sectors.sectors = dict(sectors)
    again = card.record()
    Model(card, Rows.make(Rate(), 1.0, seed=count), session=0xA6A10000, name=b"log77")
    changed = {sector: card.sectors.sectors[sector] for sector, _ in again.writes}
    image.put(changed)
    try:
        found = CardImage(image.map)
        assert decode(found.read(found.find("log77")).data).is_whole, "the next log"
        judge(image, flight, count)
    finally:
        image.put({sector: sectors.get(sector, ZEROS) for sector in changed})
