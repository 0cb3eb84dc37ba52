"""The STM32's app with a card in memory: files as bytes, operations that take time, and whatever goes wrong."""

import random
import struct
from collections.abc import Callable

from board import CRTP, HOST, STM32, App, cpx, uart

from host.native import ffi, lib

CREATE, OPEN, READ, WRITE, SEEK, TRUNCATE, SYNC, CLOSE = range(1, 9)
NO_FILE, EXISTS, FULL, DISK, NO_CARD = -1, -2, -3, -4, -5
STAMPS_OFF = 2**32 - 1
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


class Rig:
    """The app as a board runs it; time is the uptime and the stamp clock at once."""

    def __init__(self, card: MemoryCard, seed: int = 1, operation_us: int = 2000, **config: object) -> None:
        self.app = App("stm32", stamp_period_us=STAMPS_OFF, **config)
        self.card = card
        self.now_us = 0
        self.operation_us: Callable[[], int] = lambda: operation_us
        self.rng = random.Random(seed)
        self._answer: tuple[int, bytes] | None = None
        self._byte, self._request = ffi.new("uint8_t[]", 1), ffi.new("uint8_t[]", lib.STORAGE_REQUEST_MAX)
        self.poll()

    def poll(self) -> None:
        """Asks the idle ports, as App.transmit does, in a hundredth of its time."""
        now, ask = (self.now_us, self.now_us), lib.stm32_transmit
        while ask(self.app.state, lib.STM32_PORT_UART2, (self._byte, 1), now):
            pass
        if self._answer is not None:
            return
        size = ask(self.app.state, lib.STM32_PORT_STORAGE, (self._request, lib.STORAGE_REQUEST_MAX), now)
        if size:
            answer = self.card.answer(bytes(ffi.buffer(self._request, size)))
            self._answer = (self.now_us + self.operation_us(), answer)

    def run(self, until_us: int) -> None:
        while True:
            deadline_us = lib.stm32_deadline(self.app.state)
            due = [deadline_us] if deadline_us > self.now_us else []
            due += [self._answer[0]] if self._answer is not None else []
            now_us = min(due, default=until_us + 1)
            if now_us > until_us:
                self.now_us = until_us
                return
            self.now_us = now_us
            if self._answer is not None and self._answer[0] == now_us:
                answer, self._answer = self._answer[1], None
                self.app.receive("STORAGE", answer, now_us)
            self.poll()

    def crtp(self, data: bytes) -> None:
        """From the host."""
        self.app.receive("UART2", uart(cpx(HOST, STM32, CRTP, data)), self.now_us)
        self.poll()

    def logging(self, on: bool) -> None:
        self.crtp(b"\x23\0usd\0logging\0\x08" + bytes([on]))
