"""`host usd`: what people see, files that are written, and exit codes."""

import csv
import errno
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from host.cli import main
from host.cli.new_file import new_file
from host.protocol.errors import LocalError
from host.usd.decode import decode

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from existing_reader import decode as existing
from logs import TYPES, Writer, fill


@pytest.fixture
def logs(tmp_path: Path) -> dict[str, Path]:
    whole = fill(Writer(session=0xABCD1234, dropped=3), seed=1, rows=400).close()
    contents = {"whole": whole, "cut": whole[:5000], "empty": b"", "other": b"PK\x03\x04"}
    for name, data in contents.items():
        (tmp_path / name).write_bytes(data)
    return {name: tmp_path / name for name in contents}


def events(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_info(logs: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "info", str(logs["whole"])]) == 0
    shown = capsys.readouterr().out
    for words in ("version 2, whole", "400 fixedFrequency", "acc.x(f)", "session abcd1234", "dropped 3"):
        assert words in shown
    assert main(["usd", "info", "--json", str(logs["whole"]), str(logs["empty"])]) == 4
    first, second = events(capsys)
    assert (first["whole"], first["types"][0]["rows"], first["counters"]["dropped"]) == (True, 400, 3)
    assert (second["version"], second["damages"][0]["size"]) == (None, 0)


def test_check(logs: dict[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "check", "--json", str(logs["whole"])]) == 4  # Three rows were dropped.
    assert [each["event"] for each in events(capsys)] == ["drop", "clock", "checked"]
    assert main(["usd", "check", "--json", str(logs["cut"])]) == 4
    found = events(capsys)
    assert {"open", "damage", "unverified"} <= {each["event"] for each in found}
    damage = next(each for each in found if each["event"] == "damage")
    assert damage["offset"] + damage["size"] == 5000
    assert main(["usd", "check", str(logs["empty"])]) == 4
    assert "power goes" in capsys.readouterr().out


def test_a_file_that_cannot_be_read_does_not_keep_the_others_from_it(
    logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for verb in ("info", "check"):
        assert main(["usd", verb, str(tmp_path / "nowhere"), str(tmp_path), str(logs["whole"])]) == 2
        shown = capsys.readouterr()
        assert "No such file" in shown.err
        assert shown.err.count("\n") == 2
        assert shown.out.startswith(f"{logs['whole']}: ")


def test_a_good_log_is_good(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log00"
    path.write_bytes(fill(Writer(session=1), seed=1, rows=400).close())
    assert main(["usd", "check", str(path)]) == 0
    assert "good" in capsys.readouterr().out


def test_csv_gives_every_number_back(logs: dict[str, Path], tmp_path: Path) -> None:
    assert main(["usd", "decode", str(logs["whole"]), "-o", str(tmp_path / "out.csv")]) == 0
    log = decode(logs["whole"].read_bytes())
    for name, rows in log.rows.items():
        with (tmp_path / f"out.{name}.csv").open(newline="") as file:
            read = list(csv.DictReader(file))
        assert [int(row["stamp_stm32_us"]) for row in read] == rows.stamp_us.tolist()
        for variable in rows.type.variables:
            values = np.array([row[variable.name] for row in read]).astype(rows.data.dtype[variable.name])
            assert (values == rows.data[variable.name]).all()


def test_npz_and_verified_only(logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "out.npz"
    log = decode(logs["cut"].read_bytes())
    assert main(["usd", "decode", str(logs["cut"]), "-o", str(path)]) == 0
    assert "not whole" in capsys.readouterr().err
    rows = log.rows["fixedFrequency"]
    with np.load(path) as made:
        assert (made["fixedFrequency"] == rows.data).all()
        assert (made["fixedFrequency.verified"] == rows.is_verified).all()
    assert 0 < rows.is_verified.sum() < len(rows)
    assert main(["usd", "decode", str(logs["cut"]), "-o", str(path), "--verified-only", "--force"]) == 0
    with np.load(path) as made:
        assert (made["fixedFrequency"] == rows.data[rows.is_verified]).all()


def test_mcap_is_read_by_its_own_package(logs: dict[str, Path], tmp_path: Path) -> None:
    from mcap.reader import make_reader

    path = tmp_path / "out.mcap"
    assert main(["usd", "decode", str(logs["whole"]), "-o", str(path)]) == 0
    rows = decode(logs["whole"].read_bytes()).rows["fixedFrequency"]
    with path.open("rb") as file:
        messages = list(make_reader(file).iter_messages(log_time_order=False))
    assert [message.log_time for _, _, message in messages] == sorted(message.log_time for _, _, message in messages)
    read = [json.loads(message.data) for _, channel, message in messages if channel.topic == "/usd/fixedFrequency"]
    assert [each["acc.x"] for each in read] == rows.data["acc.x"].tolist()
    assert [each["stamp_stm32_us"] for each in read] == rows.stamp_us.tolist()


def test_parquet_is_read_by_its_own_package(tmp_path: Path) -> None:
    """Every column of every type, value by value and in its own type."""
    parquet = pytest.importorskip("pyarrow.parquet", reason="pyarrow is not installed: pip install 'spindeck[parquet]'")
    log = Writer(session=0xABCD1234, types={**TYPES, 9: ("odd", [f"{letter}({letter})" for letter in "BbHhIife"])})
    fill(log, seed=3, rows=300)
    for number in range(50):
        numbers = [number % 7, -number, number, -number, number * 80_000_000, -number, number / 3, number / 4]
        log.row(9, log.last + 1 + number, *numbers)
    source, out = tmp_path / "log00", tmp_path / "out.parquet"
    source.write_bytes(bytes(log.data))
    assert main(["usd", "decode", str(source), "-o", str(out)]) == 0
    found = decode(bytes(log.data))
    assert 0 < found.verified_count < found.row_count
    for name, rows in found.rows.items():
        read = parquet.read_table(tmp_path / f"out.{name}.parquet")
        expected = {each: rows.data[each] for each in rows.data.dtype.names or ()}
        expected |= {"epoch": rows.epoch, "verified": rows.is_verified}
        assert set(read.column_names) == set(expected)
        for column, values in expected.items():
            made = read[column].to_numpy()
            assert (made == values).all()
            assert made.dtype == values.dtype, (name, column)
    assert main(["usd", "decode", str(source), "-o", str(out)]) == 2, "what is there is not overwritten"
    assert main(["usd", "decode", str(source), "-o", str(out), "--verified-only", "--force"]) == 0
    rows = found.rows["fixedFrequency"]
    read = parquet.read_table(tmp_path / "out.fixedFrequency.parquet")
    assert read["acc.x"].to_pylist() == rows.data["acc.x"][rows.is_verified].tolist()


def test_names_that_are_alike_keep_their_own_columns_and_files(tmp_path: Path) -> None:
    log = Writer(types={1: ("a/b", ["epoch(B)", "verified(B)", "stamp_stm32_us(B)"]), 2: ("a:b", ["v(B)"])})
    for number in range(50):
        log.row(1, 1000 * number, 7, 8, 9)
        log.row(2, 1000 * number, 5)
    (tmp_path / "log00").write_bytes(log.close())
    for ending in (".csv", ".npz", ".mcap"):
        out = ["-o", str(tmp_path / f"out{ending}"), "--force"]
        assert main(["usd", "decode", str(tmp_path / "log00"), *out]) == 0
    with (tmp_path / "out.a_b.csv").open() as file:
        first = next(csv.DictReader(file))
    assert {name: first[name] for name in ("epoch", "verified", "stamp_stm32_us")} == {
        "epoch": "0",
        "verified": "1",
        "stamp_stm32_us": "0",
    }
    assert (first["epoch#2"], first["verified#2"], first["stamp_stm32_us#2"]) == ("7", "8", "9")
    with (tmp_path / "out.a_b#2.csv").open() as file:
        assert [row["v"] for row in csv.DictReader(file)] == ["5"] * 50


def test_times_that_mcap_cannot_hold_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = Writer()
    log.row(0xFFFF, 2**64 // 1000 + 1, 1, 2, 3)
    (tmp_path / "log00").write_bytes(log.close())
    assert main(["usd", "decode", str(tmp_path / "log00"), "-o", str(tmp_path / "out.mcap")]) == 2
    assert "choose .csv" in capsys.readouterr().err
    assert main(["usd", "decode", str(tmp_path / "log00"), "-o", str(tmp_path / "out.csv")]) == 0
    assert sorted(each.name for each in tmp_path.iterdir()) == ["log00", "out.csv"]


def test_only_the_first_of_many_notes_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = Writer(types={1: ("a", ["v(B)"])})
    for _ in range(16):
        for stamp in (0, 1, 2, 200_000, 200_001):
            log.row(1, stamp, 1)
    (tmp_path / "log00").write_bytes(log.close())
    assert main(["usd", "check", str(tmp_path / "log00")]) == 0
    shown = capsys.readouterr().out
    assert shown.count("note: the clock was reset") == 10
    assert "reset: 5 more, all with --json" in shown
    assert main(["usd", "info", str(tmp_path / "log00")]) == 0
    assert "5 more: see" in capsys.readouterr().out


def test_without_pyarrow_parquet_is_refused(
    logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["usd", "decode", str(logs["whole"]), "-o", str(tmp_path / "out.parquet")]) == 2
    assert "spindeck[parquet]" in capsys.readouterr().err
    assert list(tmp_path.glob("out*")) == []


def test_repair_is_what_the_existing_reader_takes(logs: dict[str, Path], tmp_path: Path) -> None:
    out = tmp_path / "repaired"
    before = logs["cut"].read_bytes()
    assert main(["usd", "repair", str(logs["cut"]), "-o", str(out)]) == 0
    assert logs["cut"].read_bytes() == before
    theirs = existing(out.read_bytes())
    found = decode(before)
    assert theirs is not None
    assert theirs["fixedFrequency"]["acc.x"].tolist() == found.rows["fixedFrequency"].data["acc.x"].tolist()
    # The new file's CRC is good, and makes nothing of it verified that was not.
    again = decode(out.read_bytes())
    assert again.is_whole
    for name, rows in found.rows.items():
        assert (again.rows[name].data[rows.is_verified] == rows.data[rows.is_verified])[
            : 0 if name == "log.status" else None
        ].all()
        assert (again.rows[name].is_verified == rows.is_verified).all()


def test_nothing_is_overwritten(logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there = tmp_path / "there.npz"
    there.write_text("precious")
    for verb, out in (("decode", there), ("repair", there)):
        assert main(["usd", verb, str(logs["whole"]), "-o", str(out)]) == 2
        assert "--force" in capsys.readouterr().err
    assert there.read_text() == "precious"
    assert main(["usd", "repair", str(logs["whole"]), "-o", str(logs["whole"]), "--force"]) == 2
    assert sorted(each.name for each in tmp_path.iterdir()) == ["cut", "empty", "other", "there.npz", "whole"]


def test_what_is_no_file_is_not_replaced(
    logs: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pipe, folder = tmp_path / "pipe.npz", tmp_path / "made" / "whole.npz"
    os.mkfifo(pipe)
    folder.mkdir(parents=True)
    for words in (["repair", "-o", str(pipe)], ["decode", "-o", str(folder.parent), "--format", "npz"]):
        assert main(["usd", *words, str(logs["whole"]), "--force"]) == 2
        assert "name a file" in capsys.readouterr().err
    assert pipe.is_fifo()
    assert folder.is_dir()
    assert not list(tmp_path.glob("*.part"))


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["info", "/nonexistent"], 2, "No such file"),
        (["decode", "empty", "-o", "x.csv"], 4, "power goes"),
        (["decode", "other", "-o", "x.csv"], 4, "not a log"),
        (["repair", "empty", "-o", "x"], 4, "no rows"),
        (["decode", "whole", "-o", "x.txt"], 2, ".parquet"),
        (["decode", "whole", "-o", "/nonexistent/x.csv"], 2, "No such file"),
    ],
)
def test_errors(
    logs: dict[str, Path], words: list[str], code: int, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [str(logs.get(word, word)) for word in words]
    assert main(["usd", *words]) == code
    err = capsys.readouterr().err
    assert says in err
    assert err.count("\n") == 1


def test_a_disk_that_fills_up_leaves_nothing_behind(tmp_path: Path) -> None:
    def write_half() -> None:
        with new_file(tmp_path / "out.csv", force=False) as file:
            file.write(b"half")
            raise OSError(errno.ENOSPC, "no space")

    for _ in range(2):  # so the next try is not told of what the first one left
        with pytest.raises(LocalError, match="No space left"):
            write_half()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("words", "endings"),
    [
        (["decode"], [".fixedFrequency.csv", ".estTDOA.csv", ".log.status.csv"]),
        (["decode", "--format", "npz"], [".npz"]),
        (["repair"], [""]),
        (["plot"], [".svg"]),
    ],
)
def test_several_logs_have_a_file_each_in_a_folder(
    words: list[str], endings: list[str], logs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """What is wrong with one does not stop the others."""
    out = tmp_path / "made"
    given = [str(logs[name]) for name in ("whole", "empty", "cut")]
    asked = [given[0], "acc", "--also", *given[1:]] if words == ["plot"] else given
    ask = ["usd", *words, *asked, "-o", f"{out}/"]
    assert main([*ask, "--json"]) == 4
    output = capsys.readouterr()
    assert [json.loads(line)["event"][:4] for line in output.out.splitlines()] == [f"{words[0]}"[:4]] * 2
    assert f"host: {given[1]}: no rows" in output.err
    assert {each.name for each in out.iterdir()} == {f"{log}{ending}" for log in ("whole", "cut") for ending in endings}
    before = {each: each.read_bytes() for each in out.iterdir()}
    assert main([*ask[:-1], str(out)]) == 2, "it is there"
    assert {each: each.read_bytes() for each in out.iterdir()} == before
    assert main([*ask[:-2], str(tmp_path / "none"), "-o", f"{tmp_path}/again/"]) == 2
    assert {each.name for each in (tmp_path / "again").iterdir()} == {each.name for each in out.iterdir()}


@pytest.mark.parametrize(("words", "ending"), [(["decode", "--format", "npz"], ".npz"), (["repair"], "")])
def test_one_log_goes_into_a_folder_that_is_there(
    words: list[str], ending: str, logs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    made = tmp_path / "made.npz"
    made.mkdir()
    assert main(["usd", *words, str(logs["whole"]), "-o", str(made)]) == 0
    assert [each.name for each in made.iterdir()] == [f"whole{ending}"]
    assert main(["usd", *words, f"{logs['cut']}/", "-o", str(made)]) == 0
    assert sorted(each.name for each in made.iterdir()) == [f"cut{ending}", f"whole{ending}"]
    capsys.readouterr()
    assert main(["usd", *words, str(logs["whole"]), "-o", str(made)]) == 2
    assert f"whole{ending}: exists" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["decode", "repair"])
def test_several_logs_are_not_one_file(
    verb: str, logs: dict[str, Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    whole, cut = str(logs["whole"]), str(logs["cut"])
    assert main(["usd", verb, whole, cut, "-o", str(tmp_path / "one.csv")]) == 2
    assert "one.csv.d/" in capsys.readouterr().err
    (tmp_path / "other_card").mkdir()
    again = tmp_path / "other_card" / "whole"
    again.write_bytes(logs["whole"].read_bytes())
    assert main(["usd", verb, whole, str(again), "-o", f"{tmp_path}/made/"]) == 2
    assert "of several logs of this name" in capsys.readouterr().err
    assert not (tmp_path / "made").exists()
    assert main(["usd", verb, whole, "-o", f"{tmp_path}/no/made/"]) == 2
    assert capsys.readouterr().err.endswith("No such file or directory\n")
    assert main(["usd", "decode", whole, "--format", "npz", "-o", str(tmp_path / "a.csv")]) == 2
    assert f"write -o {tmp_path}/a.csv/" in capsys.readouterr().err
    assert not (tmp_path / "a.csv").exists()
    if verb == "repair":
        assert main(["usd", verb, whole, cut, "--force", "-o", f"{tmp_path}/"]) == 2
        assert "a log that is only read here" in capsys.readouterr().err
        assert logs["cut"].read_bytes() == logs["whole"].read_bytes()[:5000]
