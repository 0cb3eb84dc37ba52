"""Checks made to match, so that more than the check is tried of random bytes, and of values out of range."""

from host.protocol.spec import checks


def repair_uart(data: bytes) -> bytes:
    if len(data) < 2 or len(data) < data[1] + 3:
        return data
    end = data[1] + 2
    return data[:end] + bytes([checks.xor8(data[:end])]) + data[end + 1 :]


def repair_stamp(data: bytes) -> bytes:
    return data[:15] + checks.crc16(data[2:15]).to_bytes(2, "little") + data[17:] if len(data) >= 17 else data


def repair_crc16(data: bytes) -> bytes:
    """Of an echo's question, or of its answer."""
    size = 5 if data[1:2] == b"\x2b" else 17
    return (
        data[: size - 2] + checks.crc16(data[2 : size - 2]).to_bytes(2, "little") + data[size:]
        if len(data) >= size
        else data
    )


def repair_frame(data: bytes) -> bytes:
    """All checks; the later ones are not there in a short message, and then not judged."""
    return repair_check32(repair_check32(repair_check32(data, 100), 124), 140)


def repair_pairs(data: bytes) -> bytes:
    return repair_check32(data, 8 + 21 * data[2]) if len(data) > 2 else data


def repair_status(data: bytes) -> bytes:
    return repair_check32(data, 60)


def repair_log(data: bytes) -> bytes:
    return repair_check32(data, 48)


def repair_check32(data: bytes, at: int) -> bytes:
    return data[:at] + checks.crc32(data[:at]).to_bytes(4, "little") + data[at + 4 :] if len(data) >= at + 4 else data


def repair_paper(data: bytes) -> bytes:
    return data[:39] + bytes([checks.xor8(data[2:39])]) + data[40:] if len(data) >= 40 else data


def repair_state(data: bytes) -> bytes:
    return data[:36] + checks.crc32(data[:36]).to_bytes(4, "little") + data[40:] if len(data) >= 40 else data
