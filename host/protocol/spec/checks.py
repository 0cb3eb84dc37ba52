"""The three checksums, by crcmod and by definition."""

import crcmod.predefined


def xor8(data: bytes) -> int:
    check = 0
    for byte in data:
        check ^= byte
    return check


def crc16(data: bytes) -> int:
    """CRC-16/CCITT-FALSE."""
    return int(_CRC16(data))


def crc32(data: bytes) -> int:
    """CRC-32 as zlib's."""
    return int(_CRC32(data))


_CRC16 = crcmod.predefined.mkPredefinedCrcFun("crc-ccitt-false")
_CRC32 = crcmod.predefined.mkPredefinedCrcFun("crc-32")
