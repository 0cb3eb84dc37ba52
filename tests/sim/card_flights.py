"""Logs on a virtual card: a model of the logger in Python, and what a card must hold after a power cut.

The model writes what the contract says (docs/PROTOCOL.md, uSD log), its data is made up, and it shares nothing
with the firmware or the reader.
"""

import mmap
import re
import shutil
import struct
import subprocess
import sys
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from other_readers import by_mtools, by_pyfatfs

from host.usd.cardimage import CardImage
from host.usd.decode import decode
from sim.card import CLOSE, CREATE, SEEK, SYNC, TRUNCATE, WRITE, Card
from sim.card_format import SECTOR
from sim.card_sectors import ZEROS, Recording
from sim.world import World

STATUS, POSE, FIXED = 3, 1, 0xFFFF
COUNTERS = "requested accepted dropped stall_us syncs errors session crc"
CHUNK = 1 << 20
SYNC_US = 250_000
WRITE_MAX = 4096
CRC_BYTES = 4


@dataclass
class Rate:
    """Of a log's rows: fixed frequency and motion capture."""

    hz: int = 250
    floats: int = 7
    poses_hz: int = 100


@dataclass
class Rows:
    """Everything a flight has to log, as bytes in the order of time."""

    header: bytes
    stamps_us: np.ndarray
    data: list[bytes]
    given: dict[str, np.ndarray]
    """Structured, without ids: as a reader should return them."""

    @staticmethod
    def make(rate: Rate, seconds: float, seed: int) -> "Rows":
        rng = np.random.default_rng(seed)
        names = {FIXED: "fixedFrequency", POSE: "estPose"}
        columns = {FIXED: [f"v.f{number}" for number in range(rate.floats)], POSE: list("abcdefg")}
        header = struct.pack("<BHH", 0xBC, 2, 3)
        for number, variables in [*columns.items(), (STATUS, COUNTERS.split())]:
            name, letter = (names[number], "f") if number in names else ("log.status", "I")
            header += struct.pack(f"<H{len(name)}sxH", number, name.encode(), len(variables))
            header += b"".join(b"%s(%s)\0" % (each.encode(), letter.encode()) for each in variables)
        given, rows = {}, []
        for number, hz, jitter in ((FIXED, rate.hz, 30), (POSE, rate.poses_hz, 3000)):
            if not hz:
                continue
            count = int(hz * seconds)
            dtype = np.dtype([("id", "<u2"), ("stamp_stm32_us", "<u8"), *((each, "<f4") for each in columns[number])])
            table = np.zeros(count, dtype)
            table["id"] = number
            table["stamp_stm32_us"] = 1_000_000 + np.arange(count) * 1_000_000 // hz + rng.integers(0, jitter, count)
            for each in columns[number]:
                table[each] = rng.normal(size=count)
            given[names[number]] = table[list(dtype.names[1:])]
            data = table.tobytes()
            size = dtype.itemsize
            rows += [
                (int(stamp), data[at * size : (at + 1) * size]) for at, stamp in enumerate(table["stamp_stm32_us"])
            ]
        rows.sort(key=lambda row: row[0])
        return Rows(header, np.array([stamp for stamp, _ in rows]), [data for _, data in rows], given)


class Model:
    """A logger as the firmware's: whole sectors as they come, a status row before each sync, space allocated ahead."""

    def __init__(self, card: Card, rows: Rows, session: int, name: bytes = b"log00") -> None:
        self.card, self.rows, self.session = card, rows, session
        self.now_us = 1_000_000.0
        self.waiting = bytearray()
        self.made = b""
        self.next_row = self.syncs = self.written = self.extent = 0
        self.stall_us = 0.0
        self.crc = self.file_crc = 0
        self.ask(CREATE, name)
        self._make(rows.header)
        self._status()
        self._flush()  # Before space is allocated, in which an older log may lie.
        self.extend()
        next_sync_us = self.now_us + SYNC_US
        while self.next_row < len(rows.data):
            self._produce()
            if self.now_us >= next_sync_us:
                next_sync_us += SYNC_US
                self._status()
                self._flush()
            elif len(self.waiting) >= SECTOR:
                self._write(min(len(self.waiting), WRITE_MAX))
            elif self.next_row < len(rows.data):
                self.now_us = max(self.now_us, float(rows.stamps_us[self.next_row]))
        self._status()
        self.waiting += struct.pack("<I", self.file_crc)
        while self.waiting:
            self._write(min(len(self.waiting), WRITE_MAX), whole=False)
        self.ask(TRUNCATE)
        self.ask(CLOSE)

    def ask(self, operation: int, argument: bytes = b"") -> None:
        answer, duration_ns = self.card.request(bytes([operation]) + argument, round(self.now_us * 1000))
        (result,) = struct.unpack("<i", answer[1:5])
        assert result == (len(argument) if operation == WRITE else 0), (operation, result)
        self.now_us += duration_ns / 1000
        self.stall_us = max(self.stall_us, duration_ns / 1000)

    def extend(self) -> None:
        self.extent += CHUNK
        self.ask(SEEK, struct.pack("<I", self.extent))
        self.ask(SEEK, struct.pack("<I", self.written))

    def _make(self, data: bytes) -> None:
        self.waiting += data
        self.crc = zlib.crc32(data, self.crc)
        self.file_crc = zlib.crc32(data, self.file_crc)

    def _produce(self) -> None:
        end = int(np.searchsorted(self.rows.stamps_us, self.now_us, "right"))
        self._make(b"".join(self.rows.data[self.next_row : end]))
        self.next_row = max(self.next_row, end)

    def _status(self) -> None:
        count = self.next_row
        last_us = int(self.rows.stamps_us[count - 1]) if count else 1_000_000
        counters = (count, count, 0, int(self.stall_us), self.syncs, 0, self.session)
        self._make(struct.pack("<HQ7I", STATUS, last_us, *counters))
        self._make(struct.pack("<I", self.crc))
        self.crc = 0

    def _flush(self) -> None:
        """With all that has come until now: what comes meanwhile waits for the next sync."""
        waiting, self.waiting = self.waiting, bytearray()
        while waiting:
            later, self.waiting = self.waiting, waiting
            self._write(min(len(waiting), WRITE_MAX), whole=len(waiting) > WRITE_MAX)
            waiting, self.waiting = self.waiting, later
        self.ask(SYNC)
        self.syncs += 1

    def _write(self, size: int, whole: bool = True) -> None:
        if 0 < self.extent < self.written + CHUNK // 2:
            self.extend()
        if whole:
            size -= (self.written + size) % SECTOR
        if size > 0:
            data = bytes(self.waiting[:size])
            del self.waiting[:size]
            self.ask(WRITE, data)
            self.written += size


@dataclass
class File:
    """What a log's requests have made of a file, and what was promised about it."""

    content: bytearray = field(default_factory=bytearray)
    position: int = 0
    end: int = 0
    """Of what was written."""
    promises: list[tuple[int, int]] = field(default_factory=list)
    """Sectors written when a sync had ended, and bytes that it covers."""

    def promised(self, count: int) -> int:
        return max((size for written, size in self.promises if written <= count), default=0)


def files_of(requests: list[tuple[bytes, bytes, int]]) -> dict[str, File]:
    """Only what was answered well."""
    files: dict[str, File] = {}
    file = File()
    for request, answer, count in requests:
        operation, argument = request[0], request[1:]
        (result,) = struct.unpack("<i", answer[1:5])
        if result < 0:
            continue
        if operation == CREATE:
            file = files[argument.decode()] = File()
        elif operation == WRITE:
            file.content[file.position : file.position + result] = argument[:result]
            file.position += result
            file.end = file.position
        elif operation == SEEK:
            (file.position,) = struct.unpack("<I", argument)
        elif operation == TRUNCATE:
            del file.content[file.position :]
        elif operation in (SYNC, CLOSE):
            file.promises.append((count, file.end))
    return files


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
    # Counted after they were taken.
    r"Free cluster summary wrong \(\d+ vs\. really \d+\)",
    r"  Auto-correcting\.",
]
"""Lines of fsck.fat that a power cut may lead to."""


@dataclass
class Flight:
    """A recorded log, on a card on which an older one lay."""

    card: Card
    recording: Recording
    files: dict[str, File]
    given: dict[str, np.ndarray]
    """Rows by type; empty: nobody knows but the logger."""


def model_flight(size_mb: int, seconds: float, seed: int, rate: Rate) -> Flight:
    """The older log has the same types of rows at the same times: only its session tells them apart."""
    older = Card(size_mb, seed=seed + 1000)
    Model(older, Rows.make(rate, seconds, seed + 1000), session=0x01DE0000 + seed)
    card = Card(size_mb, seed=seed)
    data = older.get("log00")
    card.leave(data * max(1, 2 * CHUNK // len(data)))
    recording = card.record()
    rows = Rows.make(rate, seconds, seed)
    Model(card, rows, session=0x4E3A0000 + seed)
    return Flight(card, recording, files_of(recording.requests), rows.given)


CONFIG = """\
1
16384
log
1
on:fixedFrequency
250
1
stateEstimate.x
stateEstimate.y
stateEstimate.z
stateEstimate.qx
stateEstimate.qy
stateEstimate.qz
stateEstimate.qw
on:estPose
"""
SHUT_DOWN = bytes.fromhex("ff 03 59 01 30 94")


def robot_flight(size_mb: int, seconds: float, seed: int) -> Flight:
    """The STM32's logger in the simulated world; the older log is one of its own."""
    older, card = Card(size_mb, seed=seed + 1000), Card(size_mb, seed=seed)
    for each in (older, card):
        each.put("config.txt", CONFIG.encode())
    flown(older, seconds, seed + 1000)
    data = older.get("log00")
    card.leave(data * max(1, 2 * CHUNK // len(data)))
    recording = card.record()
    flown(card, seconds, seed)
    return Flight(card, recording, files_of(recording.requests), {})


def flown(card: Card, seconds: float, seed: int) -> None:
    """Until its logger has closed the file."""
    world = World("hover", seed=seed, camera_fps=0)
    world.robots[0].set_storage(card)
    world.run(seconds)
    world.robots[0].inject("uart2_to_stm32", SHUT_DOWN)
    world.run(2.0)
    assert world.robots[0].log["status"] == "off", world.robots[0].log


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


@dataclass(frozen=True)
class Found:
    """After a cut, of all files."""

    promised: int
    verified: int
    returned: int
    """Bytes of rows that were recovered."""


def judge(image: Image, flight: Flight, count: int) -> Found:
    """The card, when so many writes were certainly done. AssertionError: a promise is broken, or something wrong is
    called verified."""
    card = CardImage(image.map)
    totals = np.zeros(3, int)
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
    return Found(*totals.tolist())


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
