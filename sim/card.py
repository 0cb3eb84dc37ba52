"""A virtual µSD card behind the STM32's storage port: a real FAT image that ChaN FatFs writes, with all that cards do
to those who log on them.

A card takes its time and stalls, fills up, has bad sectors, is pulled out, and loses its power in the middle of what it
does. Everything random is drawn from its seed. Sectors exist only here: the port knows files.
"""

from __future__ import annotations

import struct
import weakref
from pathlib import Path
from typing import IO, Any

import numpy as np

from host.protocol.errors import LocalError

from . import card_fatfs as fatfs
from .card_format import SECTOR, formatted
from .card_sectors import Recording, Request, Sectors
from .card_times import Times

CREATE, OPEN, READ, WRITE, SEEK, TRUNCATE, SYNC, CLOSE = range(1, 9)
NO_FILE, EXISTS, FULL, DISK, NO_CARD = range(-1, -6, -1)
ERRORS = {
    fatfs.OK: 0,
    fatfs.NO_FILE: NO_FILE,
    fatfs.NO_PATH: NO_FILE,
    fatfs.EXISTS: EXISTS,
    fatfs.DENIED: FULL,
    fatfs.NOT_READY: NO_CARD,
}


class Card:
    """A new card."""

    def __init__(
        self,
        size_mb: int = 8192,
        *,
        seed: int = 1,
        free_mb: int | None = None,
        spi_hz: int = 21_000_000,
        stall_ms: float = 2.0,
        stall_p99_ms: float = 100.0,
        stall_max_ms: float = 500.0,
        bad: float = 0.0,
        removed_ns: int | None = None,
    ) -> None:
        """`free_mb`: large files leave only so much room. `bad`: the share of the sectors for files that are broken.
        `removed_ns`: true time at which the card is pulled out."""
        self.layout, sectors = formatted(size_mb, free_mb, seed)
        self.sectors = Sectors(self.layout.sectors, sectors, bad, self.layout.data, seed)
        self.removed_ns = removed_ns
        self._random = np.random.default_rng([seed, size_mb])
        self.times = Times(self._random, spi_hz, stall_ms, stall_p99_ms, stall_max_ms)
        self._library = fatfs.load()
        weakref.finalize(self, fatfs.give_back, self._library)
        self._fat: fatfs.FatFs | None = None
        self._file: Any = None
        self._name = b""
        self._mode = 0
        self._position = 0
        self._size = 0
        self._ends_ns: list[float] = []
        """True time at which each sector of the last request is on the card."""

    def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
        """A request of the storage port: its answer, and how long it takes. The sectors are written at once; cut()
        takes back those whose time has not come."""
        self.sectors.begin()
        self.sectors.present = not self._removed(true_ns)
        operation, arguments = request[0], request[1:]
        result, data = self._do(operation, arguments) if self.sectors.present else (NO_CARD, b"")
        duration_ns, ends_ns = self.times.of(self.sectors.commands)
        self._ends_ns = [true_ns + each for each in ends_ns[: len(self.sectors.replaced)]]
        if self._removed(true_ns + duration_ns):
            if self.sectors.present:
                assert self.removed_ns is not None
                self.cut(self.removed_ns)
                duration_ns = self.removed_ns - true_ns
            self._fat = self._file = None
            result, data = NO_CARD, b""
        answer = struct.pack("<Bi", operation, result) + data
        if self.sectors.recording is not None:
            recording = self.sectors.recording
            recording.requests.append(Request(request, answer, len(recording.writes), true_ns + duration_ns))
        return answer, duration_ns

    def cut(self, true_ns: int) -> None:
        """The power is gone: what was being written is torn, what was still to be written is not, and FatFs forgets."""
        late = sum(end_ns > true_ns for end_ns in self._ends_ns)
        self.sectors.undo(late, int(self._random.integers(SECTOR + 1)))
        self._ends_ns = []
        self._fat = self._file = None

    def record(self) -> Recording:
        """Of every sector that is written from now on."""
        self.sectors.recording = Recording(dict(self.sectors.sectors))
        return self.sectors.recording

    # With the card in a computer: without a robot, and without time.

    def put(self, name: str, data: bytes) -> None:
        """A file, new or replaced."""
        fat = self._mounted()
        result, file = fat.open(name.encode(), fatfs.WRITE | fatfs.CREATE_ALWAYS)
        written = 0
        if result == fatfs.OK:
            result, written = fat.write(file, data)
            result = result or fat.close(file)
        if result != fatfs.OK or written < len(data):
            raise LocalError(f"{name}: cannot be put on the card (FatFs {result}, {written} of {len(data)} bytes)")

    def get(self, name: str) -> bytes:
        fat = self._mounted()
        result, file = fat.open(name.encode(), fatfs.READ)
        data = b""
        while result == fatfs.OK:
            result, more = fat.read(file, 1 << 20)
            data += more
            if not more:
                break
        if result != fatfs.OK:
            raise LocalError(f"{name}: cannot be read from the card (FatFs {result})")
        return data

    def leave(self, data: bytes) -> None:
        """An older log that was deleted: its bytes lie where the next file will."""
        self.put("DELETED.TMP", data)
        self._mounted().remove(b"DELETED.TMP")
        self._fat = None
        info = self.layout.start + 1
        if self.layout.bits == 32:  # A computer's hint where to look for free clusters.
            old = self.sectors.sectors[info]
            self.sectors.sectors[info] = old[:492] + struct.pack("<I", 2) + old[496:]

    def save(self, path: str) -> None:
        """The card as an image, with holes where nothing was ever written; a file that exists is left alone."""
        try:
            with Path(path).open("xb") as out:
                try:
                    self._write_image(out)
                except BaseException:
                    Path(path).unlink()  # A part of an image would pass for one.
                    raise
        except FileExistsError:
            raise LocalError(f"{path} exists and is not overwritten: name another file, or remove it") from None
        except OSError as error:
            raise LocalError(f"{path}: {error.strerror}") from error

    def _write_image(self, out: IO[bytes]) -> None:
        out.truncate(self.sectors.count * SECTOR)
        for sector, data in sorted(self.sectors.sectors.items()):
            out.seek(sector * SECTOR)
            out.write(data)
        out.flush()

    def image(self) -> bytes:
        """All of it at once; save() for large cards."""
        out = bytearray(self.sectors.count * SECTOR)
        for sector, data in self.sectors.sectors.items():
            out[sector * SECTOR : (sector + 1) * SECTOR] = data
        return bytes(out)

    # Operations.

    def _do(self, operation: int, arguments: bytes) -> tuple[int, bytes]:
        if self._fat is None:
            self._fat = fatfs.FatFs(self._library, self.sectors)
        if self._fat.mounted != fatfs.OK:
            result, self._fat = self._fat.mounted, None
            return error_of(result), b""
        if operation in (CREATE, OPEN):
            return self._open(operation, arguments), b""
        if self._file is None:
            return DISK, b""
        if operation == READ:
            result, data = self._fat.read(self._file, int.from_bytes(arguments, "little"))
            self._position += len(data)
            if result != fatfs.OK:
                self._open_again()
                return error_of(result), b""
            return len(data), data
        if operation == WRITE:
            return self._write(arguments), b""
        if operation == SEEK:
            return self._seek(int.from_bytes(arguments, "little")), b""
        if operation == CLOSE:
            result, self._file = self._fat.close(self._file), None
            return error_of(result), b""
        if operation == TRUNCATE:
            result = self._fat.truncate(self._file)
            self._size = self._position
        else:
            result = self._fat.sync(self._file) if operation == SYNC else fatfs.DISK_ERROR
        if result != fatfs.OK:
            self._open_again()
        return error_of(result), b""

    def _open(self, operation: int, name: bytes) -> int:
        assert self._fat is not None
        if self._file is not None:
            return DISK  # One file at a time.
        mode = fatfs.READ if operation == OPEN else fatfs.READ | fatfs.WRITE | fatfs.CREATE_NEW
        result, file = self._fat.open(name, mode)
        if result == fatfs.OK:
            self._file, self._name, self._mode = file, name, mode & ~fatfs.CREATE_NEW
            self._position = self._size = 0
        elif self.sectors.failed:
            self._fat = None
        return error_of(result)

    def _write(self, data: bytes) -> int:
        assert self._fat is not None
        result, written = self._fat.write(self._file, data)
        if result != fatfs.OK:
            self._open_again()
            return error_of(result)
        self._position += written
        self._size = max(self._size, self._position)
        return written

    def _seek(self, place: int) -> int:
        """FatFs goes as far as there is room, and says nothing: a byte can be read before the place if it got there."""
        assert self._fat is not None
        result = self._fat.seek(self._file, place)
        if result == fatfs.OK and place > self._size and self._mode & fatfs.WRITE:
            result = self._fat.seek(self._file, place - 1)
            data = b""
            if result == fatfs.OK:
                result, data = self._fat.read(self._file, 1)
            if result == fatfs.OK and not data:
                self._fat.seek(self._file, self._position)
                return FULL
        if result != fatfs.OK:
            self._open_again()
            return error_of(result)
        self._position = place
        self._size = max(self._size, place)
        return 0

    def _open_again(self) -> None:
        """FatFs does nothing more with a file after an error. Its next request gets another try, at the same place."""
        assert self._fat is not None
        if self.sectors.failed == "read":  # Nothing may be written of what FatFs now believes to have read.
            self._fat = fatfs.FatFs(self._library, self.sectors)
        else:
            self._fat.close(self._file)
        result, self._file = self._fat.open(self._name, self._mode)
        if result != fatfs.OK or self._fat.seek(self._file, self._position) != fatfs.OK:
            self._fat = self._file = None

    def _mounted(self) -> fatfs.FatFs:
        if self._file is not None:
            raise LocalError("the robot has a file open on the card: cut() first")
        self._fat = fatfs.FatFs(self._library, self.sectors)
        if self._fat.mounted != fatfs.OK:
            raise LocalError(f"the card cannot be mounted (FatFs {self._fat.mounted})")
        return self._fat

    def _removed(self, true_ns: int) -> bool:
        return self.removed_ns is not None and true_ns >= self.removed_ns


def error_of(result: int) -> int:
    return ERRORS.get(result, DISK)
