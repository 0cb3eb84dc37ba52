"""The native stream's pieces of bodies and pairs of times: a literal for each."""

import random

import pytest
from c_memory import POISONS, Bytes, Room, poisoned, seen, untouched

from host.native import ffi, lib


def test_native_data() -> None:
    head = ffi.new("uint8_t[8]")
    lib.native_data_encode_head(0xAABB0102, 0x14131211, head)
    wire = bytes.fromhex("4e 02 02 01 11 12 13 14")
    assert bytes(head) == wire
    frame_low, offset, body = ffi.new("uint16_t *"), ffi.new("uint32_t *"), ffi.new("bytes_t *")
    data = Bytes(wire + b"pixels")
    assert lib.native_data_decode(data.view, frame_low, offset, body) == 14
    assert (frame_low[0], offset[0], seen(body)) == (0x0102, 0x14131211, b"pixels")


@pytest.mark.parametrize("poison", POISONS)
def test_native_data_refusals(poison: int) -> None:
    frame_low, offset, body = (poisoned(name, poison) for name in ("uint16_t", "uint32_t", "bytes_t"))
    wire = bytes.fromhex("4e 02 02 01 11 12 13 14")
    for size in range(9):  # a piece of a body is never empty
        assert lib.native_data_decode(Bytes(wire[:size]).view, frame_low, offset, body) == lib.ERR_SHORT
    assert lib.native_data_decode(Bytes(b"\x4f" + wire[1:] + b"x").view, frame_low, offset, body) == lib.ERR_START
    assert lib.native_data_decode(Bytes(b"\x4e\x03" + wire[2:] + b"x").view, frame_low, offset, body) == lib.ERR_START
    assert all(untouched(out, poison) for out in (frame_low, offset, body))


PAIRS = [(0x04030201, 0x1817161514131211, 0x2827262524232221, 0x31), (5, 6, 7, 8)]
PAIRS_WIRE = bytes.fromhex(
    "4e 03 02 00 41 42 43 44"
    "01 02 03 04 11 12 13 14 15 16 17 18 21 22 23 24 25 26 27 28 31"
    "05 00 00 00 06 00 00 00 00 00 00 00 07 00 00 00 00 00 00 00 08"
    "06 6f b2 7d"
)


@pytest.mark.parametrize("poison", POISONS)
def test_native_pairs_encode(poison: int) -> None:
    pairs = ffi.new("native_pair_t[]", PAIRS)
    room = Room(len(PAIRS_WIRE) + 1, poison)
    assert lib.native_pairs_encode(pairs, 2, 0x44434241, room.view) == len(PAIRS_WIRE)
    assert bytes(room) == PAIRS_WIRE + bytes([poison])
    for size in range(len(PAIRS_WIRE)):
        room = Room(size, poison)
        assert lib.native_pairs_encode(pairs, 2, 0, room.view) == 0
        assert bytes(room) == bytes([poison]) * size


def test_native_pairs_from_none_to_too_many() -> None:
    rng = random.Random(5)
    sent = [(rng.getrandbits(32), rng.getrandbits(64), rng.getrandbits(64), rng.getrandbits(8)) for _ in range(49)]
    pairs = ffi.new("native_pair_t[]", sent)
    room = Room(1100)
    assert lib.native_pairs_encode(pairs, 0, 0, room.view) == 0
    assert lib.native_pairs_encode(pairs, 49, 0, room.view) == 0
    assert set(bytes(room)) == {0xA5}
    assert lib.native_pairs_encode(pairs, 48, 9, room.view) == 1020

    out, count, lost = ffi.new("native_pair_t[48]"), ffi.new("size_t *"), ffi.new("uint32_t *")
    assert lib.native_pairs_decode(Bytes(bytes(room)[:1020]).view, out, count, lost) == 1020
    assert (count[0], lost[0]) == (48, 9)
    assert [(pair.sequence, pair.stm32_us, pair.gap8_us, pair.epoch) for pair in out] == sent[:48]


@pytest.mark.parametrize("poison", POISONS)
def test_native_pairs_decode(poison: int) -> None:
    out, count, lost = ffi.new("native_pair_t[48]"), poisoned("size_t", poison), poisoned("uint32_t", poison)
    ffi.buffer(out)[:] = bytes([poison]) * ffi.sizeof(out)
    for size in range(len(PAIRS_WIRE)):
        assert lib.native_pairs_decode(Bytes(PAIRS_WIRE[:size]).view, out, count, lost) == lib.ERR_SHORT, size
    for stated in (0, 49, 255):
        wire = PAIRS_WIRE[:2] + bytes([stated]) + PAIRS_WIRE[3:] + bytes(6000)
        assert lib.native_pairs_decode(Bytes(wire).view, out, count, lost) == lib.ERR_VALUE
    assert lib.native_pairs_decode(Bytes(b"\x4e\x02" + PAIRS_WIRE[2:]).view, out, count, lost) == lib.ERR_START
    assert all(set(bytes(ffi.buffer(item))) == {poison} for item in (out, count, lost))

    for bit in range(32, 8 * len(PAIRS_WIRE)):
        changed = bytearray(PAIRS_WIRE)
        changed[bit // 8] ^= 1 << bit % 8
        assert lib.native_pairs_decode(Bytes(bytes(changed)).view, out, count, lost) == lib.ERR_CHECK, bit
    assert all(set(bytes(ffi.buffer(item))) == {poison} for item in (out, count, lost))

    assert lib.native_pairs_decode(Bytes(PAIRS_WIRE + b"\xff").view, out, count, lost) == len(PAIRS_WIRE)
    assert (count[0], lost[0]) == (2, 0x44434241)
    assert [(pair.sequence, pair.stm32_us, pair.gap8_us, pair.epoch) for pair in out[0:2]] == PAIRS
    assert set(bytes(ffi.buffer(out))[2 * ffi.sizeof("native_pair_t") :]) == {poison}
