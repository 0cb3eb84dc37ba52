"""The host's CRC-32, by every way that this processor has, against zlib."""

import random
import zlib

import pytest

from host.native import ffi, lib

WAYS = [lib.CRC32_TABLES, lib.CRC32_CARRY_LESS, lib.CRC32_CARRY_LESS_WIDE, lib.CRC32_INSTRUCTIONS]


def by(way: int, crc: int, data: bytes) -> int | None:
    out = ffi.new("uint32_t *", 0xA5A5A5A5)
    done = lib.crc32_by(way, crc, (ffi.from_buffer("uint8_t[]", data), len(data)), out)
    assert done or out[0] == 0xA5A5A5A5
    return out[0] if done else None


@pytest.mark.parametrize("way", WAYS)
def test_every_way_is_zlibs(way: int) -> None:
    if by(way, 0, b"") is None:
        pytest.skip("this processor cannot, or this build")
    assert by(way, 0, b"123456789") == 0xCBF43926
    rng = random.Random(20261122)
    data = rng.randbytes(5000)
    for size in [*range(600), *(rng.randrange(300, 4000) for _ in range(200))]:
        begin, crc = rng.randrange(900), rng.getrandbits(32)
        piece = data[begin : begin + size]
        assert by(way, crc, piece) == zlib.crc32(piece, crc), (way, begin, size, crc)


def test_one_way_is_chosen() -> None:
    data = random.Random(7).randbytes(100_003)
    assert lib.crc32_host(0, (ffi.from_buffer("uint8_t[]", data), len(data))) == zlib.crc32(data)


def test_an_unknown_way_is_refused() -> None:
    assert by(lib.CRC32_WAYS, 0, b"x") is None
