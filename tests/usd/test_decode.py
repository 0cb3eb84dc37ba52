"""Logs that are as they were written."""

import mmap
import struct
from pathlib import Path

import numpy as np
import pytest
from existing_reader import decode as existing
from logs import FIXED, MINIMAL, VERSION_2, VERSION_2019, Writer, fill, real

from host.usd.decode import decode
from host.usd.log import Log, Rows


def same_as_existing(log: Log, data: bytes) -> None:
    """Every value, bit by bit, as the existing reader has it."""
    theirs = existing(data)
    assert theirs is not None
    assert {name for name, rows in log.rows.items() if len(rows)} == theirs.keys()
    for name, event in theirs.items():
        rows = log.rows[name]
        assert (rows.stamp_us / 1000.0 == event.pop("timestamp")).all()
        for variable, values in event.items():
            ours = rows.data[variable]
            assert np.array_equal(ours.astype(values.dtype), values, equal_nan=values.dtype.kind == "f"), variable


def test_the_smallest_log() -> None:
    log = decode(MINIMAL)
    assert (log.version, log.header_bytes, log.crc, log.is_whole) == (2, 33, "good", True)
    assert log.rows["fixedFrequency"].data.tolist() == [(1000, 1.0)]
    assert log.rows["fixedFrequency"].verified == (range(1),)
    assert (log.damages, log.session) == ((), None)
    assert [(each.offset, each.first_us, each.last_us) for each in log.epochs] == [(33, 1000, 1000)]
    same_as_existing(log, MINIMAL)


@pytest.mark.parametrize("wrap", [bytes, bytearray, memoryview])
def test_any_buffer(wrap: type) -> None:
    assert decode(wrap(MINIMAL)).is_whole


def test_a_mapped_file(tmp_path: Path) -> None:
    path = tmp_path / "log00"
    path.write_bytes(MINIMAL)
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as mapped:
        log = decode(mapped)
    assert log.rows["fixedFrequency"].data["acc.x"][0] == 1.0  # A copy: the file is closed.


@pytest.mark.parametrize("name", VERSION_2)
def test_real_logs_are_as_the_existing_reader_has_them(name: str) -> None:
    data = real(name)
    log = decode(data)
    assert log.is_whole
    assert log.verified_count == log.row_count > 0
    assert len(log.epochs) == 1
    same_as_existing(log, data)


def test_version_1_counts_in_milliseconds() -> None:
    log = fill(Writer(version=1), seed=1, rows=20, start_us=500)
    data = log.close()
    decoded = decode(data)
    assert decoded.version == 1
    stamps = decoded.rows["fixedFrequency"].stamp_us
    assert (stamps == decoded.rows["fixedFrequency"].data["stamp_stm32_ms"] * np.uint64(1000)).all()
    same_as_existing(decoded, data)


@pytest.mark.parametrize("name", VERSION_2019)
def test_the_format_of_2019(name: str) -> None:
    """Against a reading of it with struct."""
    data = real(name)
    log = decode(data)
    assert (log.version, log.is_whole) == (2019, True)
    names = data[1 : data.index(b"ctrlFa.Faz(f),") + 14].decode().split(",")[:-1]
    row = struct.Struct("<" + "".join(each[-2] for each in names))
    at = 1 + sum(len(each) + 1 for each in names) + 4
    rows = []
    while at < len(data):
        rows += [row.unpack_from(data, at + 1 + number * row.size) for number in range(data[at])]
        at += 1 + data[at] * row.size + 4
    ours = log.rows["fixedFrequency"]
    assert [each.name for each in ours.type.variables] == [each[:-3] for each in names[1:]]
    assert ours.data.tolist() == rows
    assert ours.verified == (range(len(rows)),)


def test_status_rows_and_a_session() -> None:
    log = decode(fill(Writer(session=0xABCD1234, dropped=3), seed=1).close())
    assert (log.is_whole, log.session) == (True, 0xABCD1234)
    last = log.rows["log.status"].data[-1]
    assert last["requested"] == last["accepted"] + 3 == log.row_count - len(log.rows["log.status"]) + 3


def test_a_reset_of_the_clock_is_a_new_epoch() -> None:
    log = fill(Writer(), seed=1, rows=300)
    border = len(log.data)
    fill(log, seed=2, rows=300, start_us=0)
    for data in (log.close(), bytes(log.data)):
        decoded = decode(data)
        assert [each.offset for each in decoded.epochs] == [decoded.header_bytes, border]
        assert decoded.epochs[1].why.endswith(f"{decoded.epochs[0].last_us} us")
        rows = decoded.rows["fixedFrequency"]
        assert rows.epochs == (range(300), range(300, 600))
        assert (rows.epoch == np.repeat([0, 1], 300)).all()


def test_more_resets_than_16_bits_count() -> None:
    kind = decode(MINIMAL).rows["fixedFrequency"].type
    count = 65_540
    rows = Rows(kind, np.zeros(count, kind.dtype), (), tuple(range(each, each + 1) for each in range(count)))
    assert (rows.epoch == np.arange(count)).all()


def test_rows_out_of_order_are_no_reset() -> None:
    log = fill(Writer(), seed=1, rows=300)
    log.row(FIXED, 5_299_000 - 65_536, 0, 0, 0)
    fill(log, seed=2, rows=300, start_us=5_300_000)
    assert len(decode(log.close()).epochs) == 1
    assert len(decode(bytes(log.data)).epochs) == 1


def test_one_time_that_goes_back_is_no_reset() -> None:
    """Written so by the logger: the CRC says so. The row stays, as it is."""
    log = fill(Writer(), seed=1, rows=300)
    log.row(FIXED, 1_000_000, 0, 0, 0)
    fill(log, seed=2, rows=300, start_us=5_300_000)
    decoded = decode(log.close())
    assert (len(decoded.epochs), len(decoded.rows["fixedFrequency"])) == (1, 601)


@pytest.mark.parametrize("damaged", [False, True])
def test_rows_that_come_only_late(damaged: bool) -> None:
    """Of these nothing is known when memory is asked for."""
    log = Writer()
    for number in range(60_000):
        log.row(FIXED, 1000 * number, number, -number, number % 65536)
    for number in range(60_000):
        log.row(0, 60_000_000 + 100 * number, number % 256, 1, number)
    data = bytearray(log.close())
    if damaged:
        data[900_000:900_100] = bytes(100)
    found = decode(data)
    assert found.is_whole != damaged
    if not damaged:
        same_as_existing(found, bytes(data))
    assert found.rows["estTDOA"].data["distanceDiff"].tolist() == list(range(60_000))
    assert found.rows["estTDOA"].stamp_us.tolist() == list(range(60_000_000, 66_000_000, 100))
    fixed = found.rows["fixedFrequency"]
    assert fixed.data["acc.x"].tolist() == [stamp // 1000 for stamp in fixed.stamp_us.tolist()]
    assert len(fixed) > 59_990 - 10 * damaged
