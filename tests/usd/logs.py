"""Logs for tests, made with struct and zlib alone, and where the real ones lie."""

import functools
import itertools
import os
import random
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from host.usd.log import Log

REAL = Path(os.environ.get("SPINDECK_DATA", Path(__file__).resolve().parents[3] / "shared/data"))
"""Logs of real robots, which are not part of the project."""
VERSION_2 = [
    "events/kalman03", "events/log06", "flights/eckart12", "flights/jana00", "flights/jana20", "flights/hole-1.5s",
    "sync-3-robots/cf231_00", "sync-3-robots/cf5_00", "sync-3-robots/cf6_00",
]  # fmt: skip
VERSION_2019 = ["swap-2/cf50_02", "swap-2/cf51_02", "swap-3/cf50_00", "swap-3/cf51_00", "swap-3/cf52_00"]

# The smallest log with a row: acc.x = 1.0 at 1000 us.
MINIMAL = bytes.fromhex(
    "bc 02 00 01 00 ff ff 66 69 78 65 64 46 72 65 71 75 65 6e 63 79 00 01 00 61 63 63 2e 78 28 66 29 00"
    "ff ff e8 03 00 00 00 00 00 00 00 00 80 3f ca 92 18 1e"
)
FIXED = 0xFFFF
STATUS = 7
STATUS_VARIABLES = "requested accepted dropped stall_us syncs errors session crc"
TYPES = {
    FIXED: ("fixedFrequency", ["acc.x(f)", "acc.y(f)", "pm.vbatMV(H)"]),
    0: ("estTDOA", ["idA(B)", "idB(B)", "distanceDiff(f)"]),
    STATUS: ("log.status", [f"{name}(I)" for name in STATUS_VARIABLES.split()]),
}


def real(name: str) -> bytes:
    """A real log, or the test is skipped."""
    path = REAL / ("usd-2019" if name.startswith("swap") else "usd") / name
    if not path.exists():
        pytest.skip(f"{path} is not here: real logs are not part of the project (SPINDECK_DATA names their folder)")
    return path.read_bytes()


def header(types: dict[int, tuple[str, list[str]]], version: int = 2) -> bytes:
    out = struct.pack("<BHH", 0xBC, version, len(types))
    for number, (name, variables) in types.items():
        out += struct.pack("<H", number) + name.encode() + b"\0" + struct.pack("<H", len(variables))
        out += b"".join(each.encode() + b"\0" for each in variables)
    return out


@dataclass
class Writer:
    """A log as it grows. With a session it has status rows: the first after the header, others when told to."""

    session: int = 0
    version: int = 2
    types: dict[int, tuple[str, list[str]]] = field(default_factory=lambda: dict(TYPES))
    dropped: int = 0
    start: int = 5_000_000
    """Stamp of the first status row."""
    rows: list[tuple[int, int]] = field(default_factory=list)
    """Where each row begins and ends."""

    def __post_init__(self) -> None:
        if not self.session:
            self.types.pop(STATUS, None)
        self.data = bytearray(header(self.types, self.version))
        self._covered = 0
        self.last = 0
        if self.session:
            self.status(self.start)

    def row(self, number: int, stamp: int, *values: float) -> None:
        letters = "".join(each[-2] for each in self.types[number][1])
        begin = len(self.data)
        self.data += struct.pack("<HQ" if self.version == 2 else "<HI", number, stamp)
        self.data += struct.pack("<" + letters, *values)
        self.last = stamp
        self.rows.append((begin, len(self.data)))

    def status(self, stamp: int, session: int | None = None) -> None:
        accepted = sum(1 for begin, _ in self.rows if self.data[begin : begin + 2] != struct.pack("<H", STATUS))
        own = self.session if session is None else session
        self.row(STATUS, stamp, accepted + self.dropped, accepted, self.dropped, 0, len(self.rows), 0, own, 0)
        crc = zlib.crc32(self.data[self._covered : -4])
        self.data[-4:] = struct.pack("<I", crc)
        self._covered = len(self.data)

    def close(self) -> bytes:
        if self.session:
            self.status(self.last)
        return bytes(self.data) + struct.pack("<I", zlib.crc32(self.data))


def fill(log: Writer, seed: int, rows: int = 1000, start_us: int = 5_000_000, sync_every: int = 50) -> Writer:
    """1 kHz rows, an event after every fifth on average, a status row after every `sync_every`."""
    rng = random.Random(seed)
    for number in range(rows):
        stamp = start_us + 1000 * number + rng.randrange(20)
        log.row(FIXED, stamp, rng.uniform(-2, 2), rng.uniform(-2, 2), rng.randrange(3000, 4200))
        if rng.random() < 0.2:
            log.row(0, stamp + rng.randrange(900), rng.randrange(8), rng.randrange(8), rng.gauss(0, 1))
        if log.session and number % sync_every == sync_every - 1:
            log.status(stamp + 950)
    return log


@functools.lru_cache(maxsize=32)
def spans(data: bytes) -> list[tuple[int, int, int]]:
    """Id, begin and end of each row of a log of version 2 or 1 that is whole."""
    _, version, count = struct.unpack_from("<BHH", data)
    at, sizes = 5, {}
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        at = data.index(0, at + 2) + 1
        (variables,) = struct.unpack_from("<H", data, at)
        at += 2
        letters = ""
        for _ in range(variables):
            end = data.index(0, at)
            letters += chr(data[end - 2])
            at = end + 1
        sizes[number] = struct.calcsize("<H" + ("Q" if version == 2 else "I") + letters)
    found = []
    while at < len(data) - 4:
        (number,) = struct.unpack_from("<H", data, at)
        found.append((number, at, at + sizes[number]))
        at += sizes[number]
    return found


def rows_of(log: Log) -> dict[int, list[bytes]]:
    """Stamp and values of each row, by id of its type."""
    return {rows.type.id: [data.tobytes() for data in rows.data] for rows in log.rows.values()}


def check_damaged(log: Log, whole: bytes, intact: int) -> None:
    """What every reading of a damaged log must be. `whole` was the log; its first `intact` bytes are as they were."""
    truth: dict[int, list[bytes]] = {}
    before: dict[int, int] = {}
    rows_in = spans(whole)
    for number, begin, end in rows_in:
        truth.setdefault(number, []).append(whole[begin + 2 : end])
        before[number] = before.get(number, 0) + (end <= intact)
    returned = rows_of(log)
    for number, count in before.items():
        if intact >= rows_in[0][1]:
            assert returned[number][:count] == truth[number][:count], f"rows before byte {intact} are missing"
    for rows in log.rows.values():
        written = set(truth.get(rows.type.id, []))
        for part in rows.verified:
            assert {row.tobytes() for row in rows.data[part.start : part.stop]} <= written, "a verified row is wrong"
    check_account(log)


def check_account(log: Log) -> None:
    """No byte is both returned and lost; ranges are in order and inside the file."""
    edges = sorted([(each.begin, each.end) for each in log.parts])
    assert edges == [(each.begin, each.end) for each in log.parts]
    for (_, end), (begin, _) in itertools.pairwise(edges):
        assert end <= begin
    for damage in log.damages:
        assert 0 <= damage.offset <= damage.offset + damage.size <= log.size
        if not damage.why.startswith("the header"):
            assert all(end <= damage.offset or damage.offset + damage.size <= begin for begin, end in edges), damage
    for rows in log.rows.values():
        assert sum(len(part) for part in rows.epochs) == len(rows)
        assert all(0 <= part.start < part.stop <= len(rows) for part in rows.verified)
