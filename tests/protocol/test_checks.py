"""The three checksums against crcmod and zlib."""

import zlib

from hypothesis import given, settings
from hypothesis import strategies as st

from host.native import ffi, lib
from host.protocol.spec import checks

seeded = settings(derandomize=True, deadline=None, max_examples=200)
blocks = st.binary(max_size=300)


def view(data: bytes) -> tuple[object, int]:
    return ffi.from_buffer("uint8_t[]", data), len(data)


def test_known_values() -> None:
    digits = b"123456789"
    assert lib.crc16_ccitt_false(view(digits)) == checks.crc16(digits) == 0x29B1
    assert lib.crc32_zlib(0, view(digits)) == checks.crc32(digits) == 0xCBF43926
    assert lib.xor8(view(digits)) == checks.xor8(digits) == 0x31
    assert (lib.crc16_ccitt_false(view(b"")), lib.crc32_zlib(0, view(b"")), lib.xor8(view(b""))) == (0xFFFF, 0, 0)


@given(blocks)
@seeded
def test_random_data(data: bytes) -> None:
    assert lib.crc16_ccitt_false(view(data)) == checks.crc16(data)
    assert lib.crc32_zlib(0, view(data)) == checks.crc32(data) == zlib.crc32(data)
    assert lib.xor8(view(data)) == checks.xor8(data)


@given(blocks)
@settings(seeded, max_examples=20)
def test_crc32_goes_on_at_every_split_point(data: bytes) -> None:
    for at in range(len(data) + 1):
        assert lib.crc32_zlib(lib.crc32_zlib(0, view(data[:at])), view(data[at:])) == zlib.crc32(data)
