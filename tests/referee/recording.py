"""The calls that one app got in a simulated run, for another machine to make again, and what must come of them."""

import struct
from dataclasses import dataclass

from host.native import ffi, lib
from sim.world import World

MCUS = {"stm32": lib.MCU_STM32, "gap8": lib.MCU_GAP8, "esp32": lib.MCU_ESP32}
VERBS = ["init", "receive", "transmit", "deadline"]
"""By call_verb_t."""
END = bytes([0xE0])
"""REPLAY_END of replay.h."""


@dataclass(frozen=True)
class Call:
    verb: int
    port: int
    up_us: int
    stamp_us: int
    result: int
    """As 64 bits without sign."""
    room: int
    data: bytes

    def __str__(self) -> str:
        size = f"{self.room} bytes of room" if self.verb == lib.CALL_TRANSMIT else f"{len(self.data)} bytes"
        return f"{VERBS[self.verb]}, port {self.port}, {size}, up_us={self.up_us}, stamp_us={self.stamp_us}"

    @property
    def output(self) -> bytes:
        """What replay.c writes for it."""
        out = self.data if self.verb == lib.CALL_TRANSMIT else b""
        return struct.pack("<BQ", self.verb << 4 | self.port, self.result) + out


@dataclass(frozen=True)
class Recording:
    mcu: str
    calls: tuple[Call, ...]

    @property
    def image(self) -> bytes:
        """What replay.c reads: u32 calls, the calls, their bytes; equal bytes are there once."""
        places: dict[bytes, int] = {b"": 0}
        heads, pool = bytearray(), bytearray()
        for call in self.calls:
            given = b"" if call.verb == lib.CALL_TRANSMIT else call.data
            if given not in places:
                places[given] = len(pool)
                pool += given
            size = call.room if call.verb == lib.CALL_TRANSMIT else len(given)
            heads += struct.pack("<BBHIIQQ", call.verb, call.port, 0, places[given], size, call.up_us, call.stamp_us)
        return struct.pack("<I", len(self.calls)) + heads + pool

    @property
    def output(self) -> bytes:
        """What replay.c must write."""
        return b"".join(call.output for call in self.calls) + END

    def at(self, offset: int) -> str:
        """The call that this byte of the output belongs to."""
        end = 0
        for number, call in enumerate(self.calls):
            end += len(call.output)
            if offset < end:
                return f"call {number}: {call}, byte {offset - end + len(call.output)} of its answer"
        return "the end"


def begin(world: World, mcu: str, robot: int = 0) -> None:
    """Before the world has run."""
    assert lib.kernel_record_calls(world.kernel, robot, MCUS[mcu]) == 0


def take(world: World, mcu: str, robot: int = 0) -> Recording:
    count, size = ffi.new("size_t *"), ffi.new("size_t *")
    calls = lib.kernel_calls(world.kernel, robot, MCUS[mcu], count)
    memory = lib.kernel_calls_data(world.kernel, robot, MCUS[mcu], size)
    assert count[0] > 0, "nothing was recorded, or it did not fit into memory"
    data = bytes(ffi.buffer(memory, size[0]))
    return Recording(
        mcu,
        tuple(
            Call(
                call.verb,
                call.port,
                call.now.up_us,
                call.now.stamp_us,
                call.result,
                call.room,
                data[call.offset : call.offset + call.length],
            )
            for call in ffi.unpack(calls, count[0])
        ),
    )
