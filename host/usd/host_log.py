"""A host's own log of the beacons that it has sent, in the format of the µSD card's: what reads robots' logs reads it.

Its rows are those that robots log of what they hear, but for the name of the event and the clock of the stamps, which
is the host's: when the dongle had taken the beacon.
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from ..protocol.errors import LocalError
from .log import EventType, Variable
from .repair import encode_header

EVENT = "beaconSent"
NUMBER = 1
VARIABLES = (Variable("sequence", "I"), Variable("hostUs", "I"), Variable("hostUsHigh", "H"))
ROW = struct.Struct("<HQIIH")
CRC = struct.Struct("<I")


class HostLog:
    """A new file, under its name from the start: whatever ends the program, what was sent is in it. One that was not
    ended lacks its CRC alone. LocalError: it cannot be made, or takes no more."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._file = self.path.open("xb", buffering=0)
        except FileExistsError as error:
            raise LocalError(f"{path}: exists, and is not overwritten: name another file") from error
        except OSError as error:
            raise LocalError(f"{path}: {error.strerror}") from error
        self._crc = 0
        self.rows = 0
        self._write(encode_header([EventType(NUMBER, EVENT, VARIABLES, np.dtype([]))]))

    def add(self, sequence: int, host_us: int, done_us: int) -> None:
        self._write(ROW.pack(NUMBER, done_us, sequence, host_us & 0xFFFFFFFF, host_us >> 32 & 0xFFFF))
        self.rows += 1

    def end(self) -> None:
        """Without a row there is no file. Nothing, if it was closed by a failure."""
        if self._file.closed:
            return
        if self.rows:
            self._write(CRC.pack(self._crc))
        self._close()

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        try:
            while data:
                data = data[self._file.write(data) :]
        except OSError as error:
            self._close()
            raise LocalError(f"{self.path}: {error.strerror}; {self.rows} beacons are in it") from error

    def _close(self) -> None:
        self._file.close()
        if not self.rows:
            self.path.unlink(missing_ok=True)
