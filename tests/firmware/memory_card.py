"""A card in memory for the STM32's storage port: files as bytes, without FAT and without sectors."""

import itertools
import struct
from collections.abc import Callable

CREATE, OPEN, READ, WRITE, SEEK, TRUNCATE, SYNC, CLOSE = range(1, 9)
NO_FILE, EXISTS, FULL, DISK, NO_CARD = -1, -2, -3, -4, -5
MS = 1_000_000
STALE = b"\x5a"
"""What a card holds where nothing has been written yet."""


class MemoryCard:
    """Answers requests. `fails` may give a result in the place of doing what is asked."""

    def __init__(self, config: bytes | None, room: int = 1 << 40) -> None:
        self.files: dict[str, bytearray] = {} if config is None else {"config.txt": bytearray(config)}
        self.room = room
        self.fails: Callable[[int, bytes], int | None] = lambda operation, argument: None
        self.done: list[tuple[int, int]] = []
        """Every operation and its result."""
        self.synced: dict[str, bytes] = {}
        """What a loss of power would leave of each file."""
        self._open = ""
        self._at = 0

    def answer(self, request: bytes) -> bytes:
        operation, argument = request[0], request[1:]
        failed = self.fails(operation, argument)
        result, data = self._do(operation, argument) if failed is None else (failed, b"")
        if failed is not None and (operation == CLOSE or failed == NO_CARD):
            self._open = ""
        self.done.append((operation, result))
        return struct.pack("<Bi", operation, result) + data

    def _do(self, operation: int, argument: bytes) -> tuple[int, bytes]:
        if operation in (CREATE, OPEN):
            assert not self._open, "one file at a time"
            name = argument.decode("ascii")
            if (operation == CREATE) == (name in self.files):
                return (EXISTS if operation == CREATE else NO_FILE), b""
            self.files.setdefault(name, bytearray())
            self._open, self._at = name, 0
            return 0, b""
        assert self._open, "no file is open"
        file = self.files[self._open]
        if operation == READ:
            data = bytes(file[self._at : self._at + struct.unpack("<H", argument)[0]])
            self._at += len(data)
            return len(data), data
        if operation == WRITE:
            assert argument
            fit = argument[: self._free() + len(file) - self._at]
            file[self._at : self._at + len(fit)] = fit
            self._at += len(fit)
            return len(fit), b""
        if operation == SEEK:
            (place,) = struct.unpack("<I", argument)
            if place - len(file) > self._free():
                return FULL, b""
            file += STALE * (place - len(file))
            self._at = place
        elif operation == TRUNCATE:
            del file[self._at :]
        else:
            self.synced[self._open] = bytes(file)
            self._open = "" if operation == CLOSE else self._open
        return 0, b""

    def _free(self) -> int:
        return self.room - sum(map(len, self.files.values()))


class Store(MemoryCard):
    """One of a simulated world. A request takes 2 ms, and each 40th a stall."""

    def __init__(self, config: bytes, stall_ms: int = 0, fails: frozenset[int] | set[int] = frozenset()) -> None:
        """`fails`: requests that fail, by their number."""
        super().__init__(config)
        self.fails = lambda operation, argument: DISK if len(self.requests) in fails else None
        self.cuts: list[int] = []
        self.took = itertools.cycle([2 * MS] * 39 + [max(2, stall_ms) * MS])
        self.requests: list[tuple[int, bytes]] = []

    def request(self, request: bytes, true_ns: int) -> tuple[bytes, int]:
        self.requests.append((true_ns, request))
        return self.answer(request), next(self.took)

    def cut(self, true_ns: int) -> None:
        self.cuts.append(true_ns)
        self._open = ""
