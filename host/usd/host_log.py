"""A host's own log of the beacons that it has sent, in the format of the µSD card's: what reads robots' logs reads it.

Its rows are those that robots log of what they hear, but for the name of the event and the clock of the stamps, which
is the host's: when the dongle had taken the beacon.
"""

from __future__ import annotations

import struct
import zlib
from typing import IO

import numpy as np

from .log import EventType, Variable
from .repair import encode_header

EVENT = "beaconSent"
NUMBER = 1
VARIABLES = (Variable("sequence", "I"), Variable("hostUs", "I"), Variable("hostUsHigh", "H"))
ROW = struct.Struct("<HQIIH")
CRC = struct.Struct("<I")


class HostLog:
    """Writes it. A file that was not ended lacks its CRC; its rows are there."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._crc = 0
        self._write(encode_header([EventType(NUMBER, EVENT, VARIABLES, np.dtype([]))]))

    def add(self, sequence: int, host_us: int, done_us: int) -> None:
        self._write(ROW.pack(NUMBER, done_us, sequence, host_us & 0xFFFFFFFF, host_us >> 32 & 0xFFFF))

    def end(self) -> None:
        self._write(CRC.pack(self._crc))

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._file.write(data)
        self._file.flush()
