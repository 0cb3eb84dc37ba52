"""The Crazyflie's log service over CRTP: its table, blocks of variables, and their values in time."""

import struct
import zlib

import pytest
from board import CREDIT, CRTP, ESP32, HOST, STM32, WIFI_CTRL, cpx, uart
from log_rig import SECOND, Rig, config
from memory_card import MemoryCard

from host.native import ffi, lib

TOC, SETTINGS, VALUES = 0x50, 0x51, 0x52
CREATE, APPEND, DELETE, START, STOP, RESET = 6, 7, 2, 3, 4, 5
ENOENT, E2BIG, ENOMEM, EEXIST, EINVAL = 2, 7, 12, 17, 22
TYPES = {"B": 1, "H": 2, "I": 3, "b": 4, "h": 5, "i": 6, "f": 7}
TABLE = lib.stm32_table()
VARIABLES = [(ffi.string(each.name).decode(), each.type.decode()) for each in TABLE.variables[0 : TABLE.variable_count]]
PLACE = {name: place for place, (name, _) in enumerate(VARIABLES)}


def answers(rig: Rig, data: bytes = b"") -> list[bytes]:
    """CRTP packets that the STM32 sends at this instant, after one from the host."""
    if data:
        rig.app.receive("UART2", uart(cpx(HOST, STM32, CRTP, data)), rig.now_us)
    packets = []
    for _ in range(12):
        rig.app.receive("UART2", CREDIT, rig.now_us)
        packets += rig.app.uart_packets(rig.now_us)
    assert {packet[:2] for packet in packets} <= {cpx(STM32, HOST, CRTP, b"", last=0)[:2]}
    return [packet[2:] for packet in packets]


def after(rig: Rig, us: int) -> list[bytes]:
    """What it sends in so many microseconds, none of it before the last."""
    rig.run(rig.now_us + us - 1)
    rig.now_us += 1
    packets = answers(rig)
    rig.poll()
    return packets


def wants(*names: str) -> bytes:
    return b"".join(struct.pack("<BH", TYPES[VARIABLES[PLACE[name]][1]], PLACE[name]) for name in names)


def set_(rig: Rig, command: int, block: int = 0, rest: bytes = b"") -> int:
    """The error that comes back."""
    (answer,) = answers(rig, bytes([SETTINGS, command, block]) + rest)
    assert answer[:3] == bytes([SETTINGS, command, block])
    assert len(answer) == 4
    return answer[3]


@pytest.fixture
def rig() -> Rig:
    made = Rig(MemoryCard(config()))
    made.run(SECOND)
    return made


def test_the_table(rig: Rig) -> None:
    (info,) = answers(rig, bytes([TOC, 3]))
    crc = zlib.crc32(b"".join(f"{name}\0{letter}".encode() for name, letter in VARIABLES))
    assert info == struct.pack("<BBHIBB", TOC, 3, len(VARIABLES), crc, 4, 104)
    for place, (name, letter) in enumerate(VARIABLES):
        (item,) = answers(rig, struct.pack("<BBH", TOC, 2, place))
        group, own = name.split(".")
        assert item == struct.pack("<BBHB", TOC, 2, place, TYPES[letter]) + f"{group}\0{own}\0".encode()
        assert len(item) <= 31, "a packet of CRTP"
    for place in (len(VARIABLES), 65535):
        assert answers(rig, struct.pack("<BBH", TOC, 2, place)) == [bytes([TOC, 2])]


def test_the_logs_counters_are_among_the_variables_and_come_as_often_as_asked(rig: Rig) -> None:
    names = ["usd.eventsRequested", "usd.eventsAccepted", "usd.eventsDropped", "usd.stallUs", "usd.cardErrors"]
    assert set_(rig, CREATE, 7, wants(*names, "usd.state")) == 0
    told, first = answers(rig, bytes([SETTINGS, START, 7, 5]))
    assert (told, first[:2]) == (bytes([SETTINGS, START, 7, 0]), bytes([VALUES, 7]))
    got = []
    for _ in range(100):
        for packet in after(rig, 10_000):
            assert packet[:2] == bytes([VALUES, 7])
            counters = rig.app.log.log.counters
            assert int.from_bytes(packet[2:5], "little") == rig.now_us // 1000
            values = struct.unpack("<5IB", packet[5:])
            assert values == (counters.requested, counters.accepted, 0, counters.stall_us, 0, lib.LOG_ON)
            got.append(rig.now_us // 1000)
    assert got == list(range(1050, 2001, 50))
    assert set_(rig, STOP, 7) == 0
    assert after(rig, SECOND) == []


def test_values_are_packed_as_their_types(rig: Rig) -> None:
    assert set_(rig, CREATE, 1, wants("pm.vbatMV", "stateEstimateZ.z", "stateEstimate.qw")) == 0
    assert set_(rig, APPEND, 1, wants("usd.session")) == 0
    (_, values) = answers(rig, bytes([SETTINGS, START, 1, 100]))
    session = rig.app.log.log.counters.session
    assert values[5:] == struct.pack("<HhfI", 4198, 0, 1.0, session)


def test_requests_that_cannot_be(rig: Rig) -> None:
    assert set_(rig, START, 9, b"\x01") == ENOENT
    assert [set_(rig, command, 9) for command in (APPEND, DELETE, STOP)] == [ENOENT] * 3
    assert set_(rig, CREATE, 1, struct.pack("<BH", 7, len(VARIABLES))) == ENOENT
    assert set_(rig, CREATE, 1, struct.pack("<BH", 8, PLACE["gyro.x"])) == EINVAL
    assert set_(rig, CREATE, 1, wants(*["gyro.x"] * 7)) == E2BIG
    assert set_(rig, CREATE, 1, wants(*["usd.state"] * 26)) == 0
    assert set_(rig, CREATE, 1) == EEXIST
    assert set_(rig, APPEND, 1, wants("usd.state")) == E2BIG
    assert set_(rig, START, 1, b"\0") == EINVAL
    assert set_(rig, START, 1) == EINVAL
    assert [set_(rig, CREATE, block) for block in range(2, 7)] == [0, 0, 0, ENOMEM, ENOMEM]
    assert set_(rig, DELETE, 3) == 0
    assert set_(rig, CREATE, 6) == 0


@pytest.mark.parametrize(
    "data", [b"\x50", b"\x50\x00", b"\x50\x02\x01", b"\x51\x06", b"\x51\x09\x01", b"\x52\x01", b"\x53\x05\x01"]
)
def test_what_is_no_request_is_counted(rig: Rig, data: bytes) -> None:
    assert answers(rig, data) == []
    assert rig.app.crtp_ignored == 1


@pytest.mark.parametrize("ends", ["reset", "reset with a byte", "deleted", "client gone"])
def test_after_the_end_nothing_comes(rig: Rig, ends: str) -> None:
    for block in range(4):
        assert set_(rig, CREATE, block, wants("usd.state")) == 0
    answers(rig, bytes([SETTINGS, START, 2, 1]))
    assert len(after(rig, 10_000)) == 1
    if ends == "client gone":
        rig.app.receive("UART2", uart(cpx(ESP32, STM32, WIFI_CTRL, b"\x32\0")), rig.now_us)
    elif ends == "deleted":
        assert set_(rig, DELETE, 2) == 0
    else:
        packet = bytes([SETTINGS, RESET, 9])[: 2 if ends == "reset" else 3]
        assert answers(rig, packet)[0][:2] == bytes([SETTINGS, RESET])
    assert after(rig, SECOND) == []


def test_all_blocks_at_one_instant(rig: Rig) -> None:
    for block in range(4):
        assert set_(rig, CREATE, block, wants("stateEstimate.x", "usd.syncs")) == 0
        answers(rig, bytes([SETTINGS, START, block, 2]))
    assert sorted(packet[1] for packet in after(rig, 20_000)) == [0, 1, 2, 3]
