"""The stamp message, and its search in a byte stream."""

import binascii
import random
import struct
from typing import Any

import pytest
from c_memory import POISONS, Bytes, Room, poisoned, untouched

from host.native import ffi, lib

FIELDS = (0x04030201, 0x0C0B0A0908070605, 0x0D)
MESSAGE = bytes.fromhex("d5 2a 01 02 03 04 05 06 07 08 09 0a 0b 0c 0d ad f9")


def message(sequence: int, stm32_us: int, epoch: int) -> bytes:
    """A message made without the C."""
    body = struct.pack("<IQB", sequence, stm32_us, epoch)
    return b"\xd5\x2a" + body + struct.pack("<H", binascii.crc_hqx(body, 0xFFFF))


def fields(stamp: Any) -> tuple[int, int, int]:
    return (stamp.sequence, stamp.stm32_us, stamp.epoch)


def decode(data: bytes, stamp: Any) -> int:
    return int(lib.stamp_decode(Bytes(data).view, stamp))


def test_the_literal_is_the_format() -> None:
    assert message(*FIELDS) == MESSAGE


@pytest.mark.parametrize("poison", POISONS)
def test_encode(poison: int) -> None:
    room = Room(18, poison)
    lib.stamp_encode(ffi.new("stamp_t *", FIELDS), room.memory)
    assert bytes(room) == MESSAGE + bytes([poison])


@pytest.mark.parametrize("tail", [b"", b"\xd5", bytes(50)])
def test_decode(tail: bytes) -> None:
    stamp = ffi.new("stamp_t *")
    assert decode(MESSAGE + tail, stamp) == 17
    assert fields(stamp) == FIELDS


@pytest.mark.parametrize("poison", POISONS)
def test_refusals_leave_the_stamp_alone(poison: int) -> None:
    stamp = poisoned("stamp_t", poison)
    for size in range(17):
        assert decode(MESSAGE[:size], stamp) == lib.ERR_SHORT
    assert decode(b"\xd4" + MESSAGE[1:], stamp) == lib.ERR_START
    assert decode(b"\xd5\x2b", stamp) == lib.ERR_START
    for bit in range(16, 17 * 8):
        wire = bytearray(MESSAGE)
        wire[bit // 8] ^= 1 << bit % 8
        assert decode(bytes(wire), stamp) == lib.ERR_CHECK, bit
    assert untouched(stamp, poison)


class Rx:
    def __init__(self) -> None:
        self.state = ffi.new("uart1_rx_t *")
        lib.uart1_rx_init(self.state, lib.UART1_STAMP)
        self.stamps: list[tuple[int, int, int]] = []

    def take(self, data: bytes) -> None:
        message = ffi.new("uart1_message_t *")
        for byte in data:
            lib.uart1_rx_put(self.state, byte)
            if lib.uart1_rx_take(self.state, message):
                self.stamps.append(fields(message.stamp))
                assert not lib.uart1_rx_take(self.state, message)


def test_a_clean_stream() -> None:
    rx = Rx()
    sent = [(n, 10_000 * n, 0) for n in range(300)]
    rx.take(b"".join(message(*stamp) for stamp in sent))
    assert rx.stamps == sent
    assert (rx.state.received, rx.state.bad_check, rx.state.garbage_bytes) == (300, 0, 0)


# Each of these before a message; none may cost the message. The longest are starts that swallow it at first.
@pytest.mark.parametrize(
    "garbage",
    [
        b"\x00",
        b"\xd5",
        b"\xd5\xd5\xd5",
        b"\xd5\x2a",
        b"\xd5\x2a\xd5",
        b"\x2a\xd5",
        *(MESSAGE[:n] for n in range(3, 17)),
    ],
)
def test_a_false_start_costs_nothing(garbage: bytes) -> None:
    rx = Rx()
    rx.take(garbage + MESSAGE + message(1, 2, 3))
    assert rx.stamps == [FIELDS, (1, 2, 3)]
    assert rx.state.garbage_bytes == len(garbage)


def test_one_byte_lost_or_changed_costs_one_message() -> None:
    sent = [(n, 10_000 * n, 1) for n in range(4)]
    wire = b"".join(message(*stamp) for stamp in sent)
    for place in range(17, 34):
        for damaged in (
            wire[:place] + wire[place + 1 :],
            wire[:place] + bytes([wire[place] ^ 0x10]) + wire[place + 1 :],
        ):
            rx = Rx()
            rx.take(damaged)
            assert rx.stamps == [sent[0], sent[2], sent[3]], place


def test_a_message_inside_a_message() -> None:
    """The payload of a damaged message may hold a sync; the search stays in step."""
    stm32_us = int.from_bytes(b"\xd5\x2a\xd5\x2a\xd5\x2a\xd5\x2a", "little")
    damaged = bytearray(message(0x2AD52AD5, stm32_us, 0xD5))
    damaged[-1] ^= 1
    rx = Rx()
    rx.take(bytes(damaged) + MESSAGE)
    assert rx.stamps == [FIELDS]


@pytest.mark.parametrize("seed", range(20))
def test_every_byte_is_accounted_for(seed: int) -> None:
    rng = random.Random(seed)
    wire = b"".join(
        rng.choice(
            [message(rng.getrandbits(32), rng.getrandbits(64), rng.getrandbits(8)), rng.randbytes(rng.randrange(9))]
        )
        for _ in range(200)
    )
    wire = bytes(byte ^ (1 << rng.randrange(8) if rng.random() < 0.01 else 0) for byte in wire)
    rx = Rx()
    for count, byte in enumerate(wire, 1):
        rx.take(bytes([byte]))
        assert rx.state.fill < 17
        assert count == 17 * rx.state.received + rx.state.garbage_bytes + rx.state.fill
    assert rx.state.received > 0
