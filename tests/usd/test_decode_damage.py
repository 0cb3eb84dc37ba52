"""Logs that are not as they were written: everything before the damage comes back, and nothing verified is wrong.

SPINDECK_USD_CASES=1000 takes as many cases for each log and kind of damage; a failing one names its seed.
"""

import os
import random
import re

import pytest
from logs import FIXED, VERSION_2, VERSION_2019, Writer, check_account, check_damaged, fill, real, spans

from host.usd.decode import decode
from host.usd.repair import repair

CASES = int(os.environ.get("SPINDECK_USD_CASES", "3"))
SECTOR = 512
SESSION, OLD_SESSION = 0xABCD1234, 0x01DE55


@pytest.fixture(scope="module")
def own() -> bytes:
    """A log as this project's logger writes them."""
    return fill(Writer(session=SESSION), seed=1).close()


@pytest.fixture(scope="module")
def old() -> bytes:
    """What was on the card before: the same types, an hour later after its power-up."""
    start = 3_600_000_000
    return fill(Writer(session=OLD_SESSION, start=start), seed=2, rows=1500, start_us=start).close()


@pytest.mark.parametrize("name", VERSION_2)
def test_real_logs_cut_off_anywhere(name: str) -> None:
    data = real(name)
    for seed in range(CASES):
        cut = random.Random(f"{name} {seed}").randrange(len(data))
        log = decode(data[:cut])
        check_damaged(log, data, cut)
        assert log.verified_count == 0, seed  # The stock logger has no CRC but that at the end.
        lost = cut - (log.parts[-1].end if log.parts else 0)
        assert sum(each.size for each in log.damages) == lost if log.row_count else True, seed


@pytest.mark.parametrize("name", VERSION_2)
def test_real_logs_with_flipped_bits(name: str) -> None:
    data = real(name)
    for seed in range(CASES):
        rng = random.Random(f"{name} {seed}")
        broken = bytearray(data)
        places = sorted(rng.randrange(len(data)) for _ in range(rng.choice([1, 1, 3, 20])))
        for place in places:
            broken[place] ^= 1 << rng.randrange(8)
        log = decode(broken)
        check_damaged(log, data, places[0])
        if places[0] >= log.header_bytes > 0:
            # A flipped bit costs at most some rows around it, not what is behind.
            assert log.row_count >= len(spans(data)) - 4 * len(places) - 4, seed


@pytest.mark.parametrize("apart", [1, 2, 5])
@pytest.mark.parametrize("first", [0, 1, 300])
def test_a_time_that_leaps_ahead_of_another_damage(first: int, apart: int) -> None:
    """Nothing tells that the first of two broken rows is wrong but the rows behind it, or else those behind both."""
    data = fill(Writer(), seed=3).close()
    rows = spans(data)
    broken = bytearray(data)
    broken[rows[first][1] + 2 + 3] ^= 1 << 4  # 268 s later
    broken[rows[first + apart][1]] ^= 0xFF
    log = decode(broken)
    damages = [(each.offset, each.offset + each.size) for each in log.damages[:-1]]
    if first and apart > 3:  # Three rows between them go on from the row before.
        assert log.row_count == len(rows) - 2
        assert damages == [rows[place][1:] for place in (first, first + apart)]
    else:
        assert log.row_count == len(rows) - apart - 1
        assert damages == [(rows[first][1], rows[first + apart][2])]
    assert len(log.epochs) == 1
    assert log.epochs[0].last_us < 7_000_000


@pytest.mark.parametrize("first", [1, 2, 300])
def test_a_time_that_leaps_ahead_alone(first: int) -> None:
    """Which is no reset of the clock behind it."""
    data = fill(Writer(), seed=3).close()
    rows = spans(data)
    broken = bytearray(data)
    broken[rows[first][1] + 2 + 3] ^= 1 << 4
    log = decode(broken)
    assert log.row_count == len(rows) - 1
    damage = log.damages[0]
    assert (damage.offset, damage.offset + damage.size) == rows[first][1:]
    assert len(log.epochs) == 1
    assert log.epochs[0].last_us < 7_000_000


@pytest.mark.parametrize("begin_us", [0, 200_000_000])
def test_a_reset_behind_a_hole_is_a_reset(begin_us: int) -> None:
    log = fill(Writer(), seed=3)
    log.row(FIXED, 273_000_000, 0, 0, 0)
    fill(log, seed=4, start_us=begin_us)
    decoded = decode(bytes(log.data))
    assert decoded.row_count == len(log.rows)
    assert decoded.damages == ()
    assert [each.last_us // 1_000_000 for each in decoded.epochs] == [273, begin_us // 1_000_000]


@pytest.mark.parametrize("name", VERSION_2[::4])
@pytest.mark.parametrize("kind", ["zeros", "erased", "noise", "stale"])
def test_real_logs_with_a_foreign_tail(name: str, kind: str) -> None:
    data, other = real(name), real(VERSION_2[(VERSION_2.index(name) + 3) % len(VERSION_2)])
    for seed in range(CASES):
        rng = random.Random(f"{name} {kind} {seed}")
        cut = rng.randrange(1000, len(data) - SECTOR) // SECTOR * SECTOR
        size = rng.randrange(1, 40) * SECTOR
        tail = {
            "zeros": bytes(size),
            "erased": b"\xff" * size,
            "noise": rng.randbytes(size),
            "stale": other[cut : cut + size],
        }
        log = decode(data[:cut] + tail[kind])
        check_damaged(log, data, cut)
        assert log.verified_count == 0, seed


@pytest.mark.parametrize("kind", ["zeros", "noise", "stale"])
def test_behind_the_end_of_a_closed_log(own: bytes, old: bytes, kind: str) -> None:
    tail = {"zeros": bytes(5000), "noise": random.Random(5).randbytes(5000), "stale": old[len(own) :]}[kind]
    log = decode(own + tail)
    assert (log.crc, log.is_whole, log.verified_count) == ("good", False, len(spans(own)))
    assert [(each.offset, each.size) for each in log.damages] == [(len(own), len(tail))]


def test_what_a_sync_has_put_on_the_card_is_verified(own: bytes) -> None:
    """Wherever a log is cut off: all up to the last status row before."""
    rows = spans(own)
    statuses = [end for number, _, end in rows if number == 7]
    for seed in range(15 * CASES):
        cut = random.Random(seed).randrange(statuses[0], len(own) - 4)
        log = decode(own[:cut])
        check_damaged(log, own, cut)
        last = max(end for end in statuses if end <= cut)
        assert [(each.begin, each.end) for each in log.verified] == [(0, last)], seed
        assert log.verified_count == sum(end <= last for _, _, end in rows), seed
        assert log.row_count == sum(end <= cut for _, _, end in rows), seed


@pytest.mark.parametrize("kind", ["zeros", "stale", "aligned"])
def test_a_torn_log_with_status_rows(own: bytes, old: bytes, kind: str) -> None:
    """Aligned: the older log's rows lie exactly where this one's would."""
    aligned = fill(Writer(session=OLD_SESSION), seed=1).close()
    tail = {"zeros": bytes(len(own)), "stale": old, "aligned": aligned}[kind]
    statuses = [end for number, _, end in spans(own) if number == 7]
    for seed in range(5 * CASES):
        cut = random.Random(f"{kind} {seed}").randrange(SECTOR, len(own)) // SECTOR * SECTOR
        log = decode(own[:cut] + tail[cut:])
        check_damaged(log, own, cut)
        assert [(each.begin, each.end) for each in log.verified] == [(0, max(s for s in statuses if s <= cut))], seed
        if kind == "stale":
            assert all(each.last_us < 3_600_000_000 for each in log.epochs), f"stale rows are returned: {seed}"


def test_stale_sectors_in_the_middle(own: bytes, old: bytes) -> None:
    """Sectors that were never written, between such that were: what is around them stays verified."""
    for seed in range(5 * CASES):
        rng = random.Random(seed)
        begin = rng.randrange(SECTOR, len(own) - 4 * SECTOR) // SECTOR * SECTOR
        end = begin + rng.randrange(1, 4) * SECTOR
        for middle in (old[begin:end], bytes(end - begin), rng.randbytes(end - begin)):
            log = decode(own[:begin] + middle + own[end:])
            check_damaged(log, own, begin)
            statuses = [(b, e) for number, b, e in spans(own) if number == 7]
            behind = next((e for b, e in statuses if b >= end), None)
            if behind is not None:
                assert log.verified[-1].begin == behind, seed


@pytest.mark.parametrize(("byte", "word"), [(0x00, "zeros"), (0xFF, "0xFF only")])
def test_a_damage_says_which_of_its_bytes_were_never_written(own: bytes, byte: int, word: str) -> None:
    rows = spans(own)
    begin, size = rows[len(rows) // 2][1] + 3, 5000  # In a row's stamp: what is left of the row is no filling.
    blank = own[:begin] + bytes([byte]) * size + own[begin + size :]
    damage = decode(blank).damages[0]
    assert damage.offset < begin
    found = re.search(rf"bytes (\d+) to (\d+) are {word}", damage.why)
    assert found
    assert begin - 8 < int(found[1]) <= begin
    assert begin + size <= int(found[2]) < begin + size + 8


def test_flipped_bits_with_status_rows(own: bytes) -> None:
    for seed in range(15 * CASES):
        rng = random.Random(seed)
        broken = bytearray(own)
        places = sorted(rng.randrange(len(own)) for _ in range(rng.choice([1, 1, 2, 5, 50])))
        for place in places:
            broken[place] ^= 1 << rng.randrange(8)
        check_damaged(decode(broken), own, places[0])


def test_a_crc_over_segments_proves_nothing_about_their_order(own: bytes) -> None:
    """Two logs of the same shape: a file of parts of both has a good CRC. The sessions tell."""
    twin = fill(Writer(session=OLD_SESSION), seed=1).close()
    statuses = [end for number, _, end in spans(own) if number == 7]
    mixed = own[: statuses[3]] + twin[statuses[3] :]
    log = decode(mixed)
    assert log.session == SESSION
    assert [(each.begin, each.end) for each in log.verified] == [(0, statuses[3])]
    assert not log.is_whole


def test_a_damaged_header_verifies_nothing(own: bytes) -> None:
    for place in range(decode(own).header_bytes):
        broken = bytearray(own)
        broken[place] ^= 0x01
        log = decode(broken)
        assert log.verified_count == 0
        assert log.damages, place
        check_account(log)


def test_one_wrong_time_is_not_believed() -> None:
    log = fill(Writer(), seed=1, rows=100)
    place = len(log.data)
    log.row(FIXED, 1 << 40, 0, 0, 0)
    fill(log, seed=2, rows=100, start_us=5_100_000)
    decoded = decode(bytes(log.data))
    assert len(decoded.epochs) == 1
    assert [(each.offset, each.size) for each in decoded.damages] == [(place, 20)]


@pytest.mark.parametrize(
    "data", [b"", b"\0", b"\xbc", bytes(4096), b"\xff" * 4096, b"PK\x03\x04" * 100, b"\xbc\x03\0\1\0" * 9]
)
def test_what_is_no_log(data: bytes) -> None:
    log = decode(data)
    assert (log.version, log.rows, log.row_count) == (None, {}, 0)
    assert [(each.offset, each.size) for each in log.damages] == [(0, len(data))]
    assert log.damages[0].why


@pytest.mark.parametrize("name", VERSION_2019)
def test_the_format_of_2019_cut_off_and_flipped(name: str) -> None:
    data = real(name)
    whole = decode(data).rows["fixedFrequency"].data
    for seed in range(CASES):
        rng = random.Random(f"{name} {seed}")
        cut = rng.randrange(700, len(data))
        rows = decode(data[:cut]).rows["fixedFrequency"]
        assert (rows.data == whole[: len(rows)]).all()
        assert (cut - 624) // 102 - cut // 200 <= len(rows)  # Each block has five bytes besides its rows.
        broken = bytearray(data)
        broken[cut] ^= 1 << rng.randrange(8)
        log = decode(broken)
        rows = log.rows["fixedFrequency"]
        assert len(whole) - 60 <= len(rows) <= len(whole)
        assert set(rows.data[rows.is_verified].tolist()) <= set(whole.tolist())
        assert not log.is_whole
        check_account(log)


def test_damaged_names_of_2019_make_a_log_that_can_be_read() -> None:
    data = real("swap-3/cf50_00")
    kept = 0
    for seed in range(20 + CASES):
        rng = random.Random(f"names {seed}")
        broken = bytearray(data[:3000])
        for _ in range(3):
            broken[rng.randrange(10, 610)] = rng.randrange(256)
        log = decode(broken)
        if log.row_count:
            again = decode(repair(broken, log))
            rows, before = (each.rows["fixedFrequency"] for each in (again, log))
            assert (len(rows), rows.type.variables) == (len(before), before.type.variables), seed
            kept += 1
    assert kept > 5


def test_random_bytes_behind_a_header() -> None:
    header = bytes(Writer(session=SESSION).data[:197])
    for seed in range(20 * CASES):
        rng = random.Random(seed)
        noise = bytes(rng.choice([0, 0, 7, 255, rng.randrange(256)]) for _ in range(rng.randrange(600)))
        log = decode(header + noise)
        assert log.verified_count == 0
        check_account(log)
