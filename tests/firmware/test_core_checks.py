"""The three checksums against published check values and against Python's own."""

import binascii
import random
import zlib

import pytest
from c_memory import Bytes

from host.native import ffi, lib


def crc32(data: bytes, so_far: int = 0) -> int:
    return int(lib.crc32_zlib(so_far, Bytes(data).view))


def crc16(data: bytes) -> int:
    return int(lib.crc16_ccitt_false(Bytes(data).view))


def test_published_check_values() -> None:
    assert crc16(b"123456789") == 0x29B1
    assert crc32(b"123456789") == 0xCBF43926


def test_nothing_at_all() -> None:
    nothing = ffi.new("bytes_t *", (ffi.NULL, 0))[0]
    assert lib.xor8(nothing) == 0
    assert lib.crc16_ccitt_false(nothing) == 0xFFFF
    assert lib.crc32_zlib(0, nothing) == 0


@pytest.mark.parametrize(
    ("frame", "check"), [("ff 04 0a 04 20 01", 0xD4), ("ff 04 51 04 32 01", 0x9D), ("", 0), ("5a 5a", 0)]
)
def test_xor8(frame: str, check: int) -> None:
    assert lib.xor8(Bytes(bytes.fromhex(frame)).view) == check


def test_every_entry_of_the_crc16_table() -> None:
    for value in range(256):
        assert crc16(bytes([value])) == binascii.crc_hqx(bytes([value]), 0xFFFF)


def test_every_entry_of_the_crc32_table() -> None:
    for place in range(16):
        for value in range(256):
            data = bytearray(16)
            data[place] = value
            assert crc32(bytes(data)) == zlib.crc32(data), (place, value)


@pytest.mark.parametrize("size", range(70))
def test_every_size_at_every_alignment(size: int) -> None:
    data = random.Random(size).randbytes(size + 16)
    memory = Bytes(data).memory
    for start in range(16):
        part = ffi.new("bytes_t *", (memory + start, size))[0]
        assert lib.crc32_zlib(0, part) == zlib.crc32(data[start : start + size]), start
        assert lib.crc16_ccitt_false(part) == binascii.crc_hqx(data[start : start + size], 0xFFFF), start


def test_crc32_goes_on_from_any_split() -> None:
    data = random.Random(1).randbytes(67)
    for split in range(len(data) + 1):
        assert crc32(data[split:], crc32(data[:split])) == zlib.crc32(data), split


def test_a_whole_picture() -> None:
    data = random.Random(2).randbytes(324 * 244)
    assert crc32(data) == zlib.crc32(data)
