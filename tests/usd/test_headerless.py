"""Logs whose beginning is lost or overwritten, read by the header of another log of the same configuration."""

import random
import re
from pathlib import Path

import pytest
from logs import FIXED, STATUS, TYPES, VERSION_2, Writer, fill, real, rows_of, spans

from host.cli import main
from host.protocol.errors import LocalError
from host.usd.decode import decode
from host.usd.log import Log
from host.usd.repair import repair

SESSION = 0xABCD1234
CLUSTER = 2048


@pytest.fixture(scope="module")
def own() -> bytes:
    return fill(Writer(session=SESSION), seed=1).close()


@pytest.fixture(scope="module")
def other() -> bytes:
    """Of another flight, with fewer rows."""
    return fill(Writer(session=0x5EED), seed=2, rows=100, start_us=77_000_000).close()


def expected(own: bytes, begin: int, first: int = 0) -> tuple[dict[int, list[bytes]], int]:
    """The rows from that byte on, and from where on they are verified: behind the first status row that is left, or
    was before the `first` byte that is left."""
    rows: dict[int, list[bytes]] = {number: [] for number in TYPES}
    for number, at, end in spans(own):
        if at >= begin:
            rows[number].append(own[at + 2 : end])
    statuses = [end for number, at, end in spans(own) if number == STATUS and (at >= begin or end == first)]
    return rows, statuses[0] - first if statuses else len(own)


def check(log: Log, own: bytes, begin: int, shift: int = 0) -> None:
    """All rows behind the damage; those that a CRC covers, which is a status row's, verified and no other. One more,
    unverified, may come out of the damage: 0xFF with what follows looks like a row whose id is 0xFFFF."""
    rows, verified_from = expected(own, begin, shift)
    found = rows_of(log)
    assert all(found[number][len(found[number]) - len(each) :] == each for number, each in rows.items())
    assert log.row_count <= sum(map(len, rows.values())) + 1
    assert [(each.begin, each.end) for each in log.verified] == [(verified_from, len(own) - 4 - shift)]
    assert log.verified_count == sum(at >= verified_from + shift for _, at, _ in spans(own))
    assert log.damages[0].offset == 0
    assert "another log" in log.damages[0].why
    assert not log.is_whole
    assert log.session == SESSION


@pytest.mark.parametrize("fill_with", [b"\0", b"\xff", None])
def test_the_beginning_is_overwritten(own: bytes, other: bytes, fill_with: bytes | None) -> None:
    for size in [*range(20, 400, 7), 512, CLUSTER, 2 * CLUSTER]:
        lost = random.Random(size).randbytes(size) if fill_with is None else fill_with * size
        changed = max(at for at in range(size) if lost[at] != own[at])
        check(decode(lost + own[size:], other), own, changed + 1)


def test_the_beginning_is_gone(own: bytes, other: bytes) -> None:
    """The chain of clusters begins with a later one."""
    for begin in [*range(200, 400), 512, CLUSTER, 5 * CLUSTER]:
        check(decode(own[begin:], other), own, begin, begin)


def test_more_damage_and_a_stale_tail(own: bytes, other: bytes) -> None:
    """Of the rest nothing verified is wrong, whatever else there is."""
    stale = fill(Writer(session=0xDEAD), seed=5, rows=3000, start_us=1_000_000).close()
    for seed in range(20):
        rng = random.Random(seed)
        data = bytearray(own[CLUSTER:-4] + stale[CLUSTER:])
        at = rng.randrange(len(own) - CLUSTER)
        data[at] ^= 1 << rng.randrange(8)
        log = decode(data, other)
        assert log.session == SESSION, seed
        for each in log.verified:
            assert data[each.begin : each.end] == own[CLUSTER:][each.begin : each.end], seed
        assert log.verified_count > 900, seed


def test_without_status_rows_nothing_is_verified(other: bytes) -> None:
    own = fill(Writer(), seed=3).close()
    log = decode(own[CLUSTER:], other)
    rows, _ = expected(own, CLUSTER)
    assert rows_of(log) == rows
    assert (log.verified, log.session) == ((), None)


def test_version_1(other: bytes) -> None:
    own, like = Writer(version=1), Writer(version=1)
    for number in range(200):
        for log in (own, like):
            log.row(FIXED, 1000 + 10 * number, number, 1, 2)
    found = decode(own.close()[500:], like.close())
    assert found.version == 1
    assert found.rows["fixedFrequency"].data["acc.x"][-1] == 199
    assert len(found.rows["fixedFrequency"]) == sum(at >= 500 for _, at, _ in spans(own.close()))


def test_any_bytes_with_any_header(own: bytes, other: bytes) -> None:
    for seed in range(300):
        rng = random.Random(seed)
        data = rng.randbytes(rng.randrange(3000))
        log = decode(data, other)
        assert not log.verified, seed
        assert sum(each.size for each in log.damages) + sum(p.end - p.begin for p in log.parts) == len(data), seed
    with pytest.raises(LocalError, match="no header to borrow"):
        decode(own, b"PK\x03\x04")


@pytest.mark.parametrize("name", VERSION_2[:2])
def test_real_logs(name: str) -> None:
    data = real(name)
    begin = 32_768
    log = decode(data[begin:], data)
    assert sum(len(rows) for rows in log.rows.values()) == sum(at >= begin for _, at, _ in spans(data))
    assert not log.verified


def test_repair_makes_it_a_log_again(own: bytes, other: bytes) -> None:
    broken = bytes(CLUSTER) + own[CLUSTER:]
    log = decode(broken, other)
    again = decode(repair(broken, log, other))
    assert again.is_whole
    for name, rows in log.rows.items():
        if name != "log.status":  # Their CRCs fit the new file.
            assert again.rows[name].data.tobytes() == rows.data.tobytes()
        assert (again.rows[name].is_verified == rows.is_verified).all()


def test_the_command(own: bytes, other: bytes, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    broken = bytes(CLUSTER) + own[CLUSTER:]
    for name, data in {"own": own, "other": other, "broken": broken, "text": b"x" * 999}.items():
        (tmp_path / name).write_bytes(data)

    def run(verb: str, name: str, out: str, *header_of: str) -> int:
        given = [word for each in header_of for word in ("--header-of", str(tmp_path / each))]
        return main(["usd", verb, str(tmp_path / name), "-o", str(tmp_path / out), *given])

    assert run("decode", "broken", "no.npz") == 4
    assert "--header-of OTHER" in capsys.readouterr().err
    assert run("decode", "own", "no.npz", "other") == 2
    assert "leave out --header-of" in capsys.readouterr().err
    assert run("decode", "broken", "no.npz", "text") == 2
    assert re.search("text: there is no header to borrow", capsys.readouterr().err)
    assert run("decode", "text", "no.npz", "other") == 4
    assert "was the config.txt another one?" in capsys.readouterr().err
    assert not (tmp_path / "no.npz").exists()
    assert run("decode", "broken", "yes.npz", "other") == 0
    assert "unverified" in capsys.readouterr().err
    assert main(["usd", "check", str(tmp_path / "broken")]) == 4
    assert "--header-of OTHER" in capsys.readouterr().out
    assert main(["usd", "check", str(tmp_path / "broken"), "--header-of", str(tmp_path / "other")]) == 4
    shown = capsys.readouterr().out
    assert "rows are read as those of another log" in shown
    assert " 0 verified" not in shown
    before = (tmp_path / "other").read_bytes()
    words = ["usd", "repair", str(tmp_path / "broken"), "--header-of", str(tmp_path / "other"), "--force", "-o"]
    assert main([*words, str(tmp_path / "other")]) == 2
    assert "a log that is only read here" in capsys.readouterr().err
    assert (tmp_path / "other").read_bytes() == before
    assert run("repair", "broken", "mended", "other") == 0
    capsys.readouterr()
    assert main(["usd", "info", str(tmp_path / "mended")]) == 0
    assert "whole" in capsys.readouterr().out
