"""A model of the logger in Python, for power cuts.

It writes what the contract says (docs/PROTOCOL.md, uSD log), its data is made up, and it shares nothing with the
firmware or the reader.
"""

import struct
import zlib
from dataclasses import dataclass

import numpy as np

from sim.card import CLOSE, CREATE, SEEK, SYNC, TRUNCATE, WRITE, Card
from sim.card_format import SECTOR

STATUS, POSE, FIXED = 3, 1, 0xFFFF
COUNTERS = "requested accepted dropped stall_us syncs errors session crc"
CHUNK = 1 << 20
SYNC_US = 250_000
WRITE_MAX = 4096


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
