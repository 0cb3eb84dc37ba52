"""The bytes of a log file: header, rows, status rows and CRCs, by literal vectors and by the specification."""

import random
import struct
import zlib
from dataclasses import dataclass
from typing import Any

import pytest
from c_memory import POISONS, Bytes, Room
from construct import Container, Struct, Tell
from usd_table import EVENTS, LETTERS, VARIABLES, Config, values

from host.native import ffi, lib
from host.protocol.spec import usd
from host.protocol.spec.checks import crc32
from host.usd.decode import decode

HEAD = b"1\n1024\nlog\n1\n"
STATUS_ID = len(EVENTS)
SESSION = 0x5E551011
CONFIG = (
    HEAD
    + b"on:fixedFrequency\n1000\n1\n"
    + b"".join(b"t.%c0\n" % ord(each) for each in LETTERS)
    + b"on:estTDOA\nt.f1\n"
)
FIXED, TDOA = 0, 1


class Log:
    """A file as it is made; the ring is memory of exactly its size."""

    def __init__(self, text: bytes = CONFIG, stamp_us: int = 1000, **counters: int) -> None:
        self.config = Config(text)
        assert self.config.result == 0, self.config.findings
        self.ring = ffi.new("uint8_t[]", self.config.state.ring_bytes)
        self.state = ffi.new("usd_log_t *")
        start = ffi.new("usd_counters_t *", {"session": SESSION, **counters})
        lib.usd_log_begin(self.state, self.config.state, self.ring, start, stamp_us)
        self.card = b""

    def row(self, block: int, stamp_us: int, numbers: list[float], payload: list[float] | None = None) -> bool:
        name = self.config.blocks[block][0]
        memory = Bytes(values(numbers, payload or [], name))
        return bool(lib.usd_log_row(self.state, self.config.state.blocks + block, stamp_us, memory.memory))

    def status(self, stamp_us: int) -> None:
        lib.usd_log_status(self.state, stamp_us)

    def peek(self, size: int) -> bytes:
        room = Room(size)
        got = int(lib.usd_log_peek(self.state, room.view))
        return bytes(room)[:got]

    def write(self, size: int = 1 << 20) -> bytes:
        """So much of what waits goes to the card."""
        data = self.peek(size)
        lib.usd_log_taken(self.state, len(data))
        self.card += data
        return data

    def close(self, stamp_us: int) -> bytes:
        self.write()
        lib.usd_log_end(self.state, stamp_us)
        self.write()
        return self.card


def numbers_of(rng: random.Random, which: list[tuple[str, str]]) -> list[float]:
    ranges = {"B": (0, 255), "b": (-128, 127), "H": (0, 65535), "h": (-32768, 32767), "I": (0, 2**32 - 1)}
    drawn: list[float] = []
    for _, letter in which:
        if letter == "f":
            drawn.append(struct.unpack("<f", struct.pack("<f", rng.gauss(0, 10)))[0])
        else:
            drawn.append(rng.randint(*ranges.get(letter, (-(2**31), 2**31 - 1))))
    return drawn


@dataclass(frozen=True)
class Row:
    name: str
    stamp_us: int
    values: list[Any]


def read(data: bytes) -> tuple[list[Row], list[Container[Any]]]:
    """By the specification: the rows, and apart from them the status rows, their CRCs checked."""
    rows, statuses = [], []
    at = covered = header_bytes(data)
    for name, stamp_us, numbers in usd.parse(data):
        at += 10 + sum(usd.LETTERS[letter].sizeof() for letter in letters_of(data, name))
        if name != "log.status":
            rows.append(Row(name, stamp_us, numbers))
            continue
        statuses.append(usd.STATUS.parse(data[at - 32 : at]))
        begin = covered if len(statuses) > 1 else 0
        assert statuses[-1].crc == crc32(data[begin : at - 4])
        covered = at
    assert at + 4 == len(data)
    assert covered == at, "the last row is not a status row"
    return rows, statuses


def header_bytes(data: bytes) -> int:
    return int(Struct("header" / usd.HEADER, "end" / Tell).parse(data).end)


def letters_of(data: bytes, name: str) -> str:
    (kind,) = [each for each in usd.HEADER.parse(data).types if each.name == name]
    return "".join(variable[-2] for variable in kind.variables)


ZEROS = [0.0 if letter == "f" else 0 for _, letter in VARIABLES]
LITERAL = bytes.fromhex(
    "bc 0200 0200"
    "ffff 66697865644672657175656e637900 0100 742e6630286629 00"
    "1b00 6c6f672e73746174757300 0800"
    "72657175657374656428492900 6163636570746564284929 00 64726f70706564284929 00"
    "7374616c6c5f7573284929 00 73796e6373284929 00 6572726f7273284929 00"
    "73657373696f6e284929 00 637263284929 00"
)


def test_the_header_byte_for_byte() -> None:
    log = Log(HEAD + b"on:fixedFrequency\n1000\n1\nt.f0\n")
    status = struct.pack("<HQ7I", STATUS_ID, 1000, 0, 0, 0, 0, 0, 0, SESSION)
    assert log.write() == LITERAL + status + struct.pack("<I", zlib.crc32(LITERAL + status))


def test_a_row_byte_for_byte() -> None:
    log = Log()
    log.write()
    numbers = [200, 0, -3, 0, 60000, 0, -300, 0, 4_000_000_000, 0, -70_000, 0, 1.5, -2.0, 0.0]
    assert log.row(FIXED, 0x0102030405060708, numbers)
    assert log.row(TDOA, 0x0102030405060709, numbers, [7, 9, 0.25])
    assert log.write() == bytes.fromhex(
        "ffff 0807060504030201 c8 fd 60ea d4fe 00286bee 90eefeff 0000c03f0000 0907060504030201 07 09 0000803e 000000c0"
    )


@pytest.mark.parametrize("poison", POISONS)
def test_any_piece_of_the_header_is_the_same(poison: int) -> None:
    whole = LITERAL
    config = Config(HEAD + b"on:fixedFrequency\n1000\n1\nt.f0\n")
    for begin in range(len(whole) + 2):
        for size in (0, 1, 2, 7, 64, 512):
            room = Room(size, poison)
            count = lib.usd_header_encode(config.state, begin, room.view)
            assert bytes(room)[:count] == whole[begin : begin + size]
            assert set(bytes(room)[count:]) <= {poison}


@pytest.mark.parametrize("seed", range(20))
def test_a_file_is_what_the_specification_reads_out_of_it(seed: int) -> None:
    rng = random.Random(seed)
    log = Log()
    stamp_us, expected, dropped, syncs = 1000, [], 0, 0
    for _ in range(rng.randrange(400)):
        stamp_us += rng.randrange(2000)
        block = rng.choice([FIXED, FIXED, TDOA])
        numbers = numbers_of(rng, VARIABLES)
        payload = numbers_of(rng, EVENTS[0][1]) if block == TDOA else []
        if log.row(block, stamp_us, numbers, payload):
            expected.append((block, stamp_us, numbers, payload))
        else:
            dropped += 1
        if rng.random() < 0.1:
            log.write(rng.randrange(1, 600))
        if rng.random() < 0.05:
            log.write()
            log.status(stamp_us)
            log.write()
            syncs += 1
    data = log.close(stamp_us)
    rows, statuses = read(data)
    assert len(rows) == len(expected), f"seed {seed}"
    for row, (block, stamp, numbers, payload) in zip(rows, expected, strict=True):
        known = dict(zip([name for name, _ in VARIABLES], numbers, strict=True))
        logged = [known[name] for name in log.config.blocks[block][1]]
        assert row == Row(log.config.blocks[block][0], stamp, payload + logged), f"seed {seed}"
    assert len(statuses) == 2 + syncs
    assert {row.session for row in statuses} == {SESSION}
    last = statuses[-1]
    assert (last.requested, last.accepted, last.dropped) == (len(expected) + dropped, len(expected), dropped)
    decoded = decode(data)
    assert decoded.is_whole
    assert (decoded.session, decoded.verified_count) == (SESSION, decoded.row_count)


def test_what_does_not_fit_is_dropped_whole_and_counted() -> None:
    log = Log()
    log.write()
    taken = sum(log.row(FIXED, 1000 + n, ZEROS) for n in range(100))
    row_bytes = lib.usd_row_bytes(log.config.table.view, log.config.state.blocks)
    assert taken == (1024 - lib.USD_LOG_END_BYTES) // row_bytes
    assert (log.state.counters.requested, log.state.counters.dropped) == (100, 100 - taken)
    log.status(2000)  # for which there is always room
    assert not log.row(FIXED, 2001, ZEROS)
    assert log.peek(1000)[-42:-32] == struct.pack("<HQ", STATUS_ID, 2000)
    assert read(log.close(3000))[1][-1].dropped == 101 - taken
    assert log.state.fill_max <= 1024


def test_a_full_ring_still_takes_the_end_of_the_file() -> None:
    log = Log()
    log.write()
    while log.row(FIXED, 1000, ZEROS):
        pass
    lib.usd_log_end(log.state, 2000)
    log.write()
    assert read(log.card)[1][-1].accepted > 10


def test_rows_that_were_missed_count_as_dropped() -> None:
    log = Log(requested=5, dropped=5)
    lib.usd_log_missed(log.state, 3)
    log.row(FIXED, 1001, ZEROS)
    last = read(log.close(2000))[1][-1]
    assert (last.requested, last.accepted, last.dropped) == (9, 1, 8)


@pytest.mark.parametrize("spare", range(0, 60, 7))
def test_a_limit_leaves_room_for_a_proper_end(spare: int) -> None:
    log = Log()
    log.write()
    limit = log.state.bytes + 400 + spare
    log.state.limit = limit
    stamp_us = 1000
    while log.row(FIXED, stamp_us, ZEROS):
        log.write()
        stamp_us += 1
    assert log.state.full
    assert not log.row(FIXED, stamp_us, ZEROS)
    log.status(stamp_us)  # a sync that was due
    data = log.close(stamp_us)
    assert limit - 42 - 28 < len(data) <= limit
    assert read(data)[1][-1].dropped == 2


@pytest.mark.parametrize("written", [0, 1, 30, 200])
def test_a_file_can_be_cut_back_to_what_is_safe(written: int) -> None:
    log = Log()
    assert lib.usd_log_safe(log.state) == 0
    log.row(FIXED, 1001, ZEROS)
    log.write()
    log.status(1500)
    log.write()
    safe = lib.usd_log_safe(log.state)
    assert safe == len(log.card)
    for n in range(7):
        log.row(FIXED, 2000 + n, ZEROS)
    log.write(written)
    lib.usd_log_cut(log.state)
    log.card = log.card[:safe]
    log.state.counters.errors += 1
    lib.usd_log_end(log.state, 3000)
    log.write()
    last = read(log.card)[1][-1]
    assert (last.accepted, last.dropped, last.errors) == (1, 7, 1)
    assert decode(log.card).is_whole


def test_a_status_row_is_safe_only_once_all_of_it_is_written() -> None:
    log = Log()
    size = len(log.peek(10_000))
    log.write(size - 1)
    assert lib.usd_log_safe(log.state) == 0
    log.write(1)
    assert lib.usd_log_safe(log.state) == size


@pytest.mark.parametrize("piece", [1, 3, 64, 97, 511, 512, 513])
def test_pieces_of_any_size_make_the_same_file(piece: int) -> None:
    log = Log()
    rng = random.Random(1)
    for n in range(200):
        assert log.row(FIXED, 1000 + n, numbers_of(rng, VARIABLES))
        while log.write(piece):
            pass
    assert zlib.crc32(log.close(2000)) == 0x2144DF1C  # of anything that ends with its own CRC-32
    assert len(read(log.card)[0]) == 200


def test_numbers_are_those_of_the_specification() -> None:
    assert usd.ROW.sizeof() + usd.STATUS.sizeof() == lib.USD_STATUS_BYTES
    assert lib.USD_STATUS_CRC_AT == lib.USD_STATUS_BYTES - 4
    assert usd.ROW.sizeof() == lib.USD_ROW_HEAD_BYTES


def state_of(log: Log) -> Any:
    return bytes(ffi.buffer(log.state))


def test_looking_takes_nothing() -> None:
    log = Log()
    log.row(FIXED, 1000, ZEROS)
    before = state_of(log)
    for size in (0, 1, 100, 10_000):
        log.peek(size)
    assert state_of(log) == before
