"""`host usd plot`: what names mean, files that are written, and wrong input."""

import json
import sys
from pathlib import Path

import pytest

from host.cli import main

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from logs import FIXED, Writer, fill


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    whole = fill(Writer(session=1), seed=1, rows=400).close()
    (tmp_path / "log00").write_bytes(whole)
    (tmp_path / "cut00").write_bytes(whole[:5000])
    (tmp_path / "empty00").write_bytes(b"")
    names = [f"g.v{number}(B)" for number in range(9)]
    many = Writer(types={FIXED: ("fixedFrequency", [*names, "acc.x(f)"]), 1: ("estPose", ["acc.x(f)"])})
    for number in range(20):
        many.row(FIXED, number * 1000, *range(9), 0)
    (tmp_path / "many00").write_bytes(many.close())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("names", "panels"),
    [
        (["acc.x"], [["acc.x"]]),
        (["acc", "pm.vbatMV"], [["acc.x", "acc.y"], ["pm.vbatMV"]]),
        (["acc.x,estTDOA:distanceDiff"], [["acc.x", "distanceDiff"]]),
        (["fixedFrequency:acc"], [["acc.x", "acc.y"]]),
        (["acc.*"], [["acc.x", "acc.y"]]),
    ],
)
@pytest.mark.parametrize("output", ["p.svg", "p.PNG"])
def test_names(
    folder: Path, names: list[str], panels: list[list[str]], output: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["usd", "plot", "log00", *names, "-o", output, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["panels"] == panels
    assert (folder / output).read_bytes()[:4] in (b"<svg", b"\x89PNG")


def test_a_log_that_is_not_whole(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "plot", "cut00", "acc", "-o", "p.svg"]) == 0
    printed = capsys.readouterr()
    assert printed.out == "p.svg: 2 variables in 1 panel\n"
    assert "not whole" in printed.err
    assert "unverified" in (folder / "p.svg").read_text()


@pytest.mark.parametrize(
    ("words", "code", "says"),
    [
        (["nowhere", "acc.x"], 2, "No such file"),
        ([".", "acc.x"], 2, "directory"),
        (["empty00", "acc.x"], 4, "no rows: empty"),
        (["log00", "acc.X"], 2, "did you mean acc.x?"),
        (["log00", "accx"], 2, "did you mean acc.x"),
        (["log00", "estTODA:acc"], 2, "no type of rows estTODA in it: did you mean estTDOA?"),
        (["log00", "quite else"], 2, "'host usd info' lists"),
        (["log00", "acc.x,"], 2, "a name is empty"),
        (["log00", "acc.x", "--from-us", "nan"], 2, "microseconds"),
        (["log00", "acc.x", "--from-us", "9e9"], 2, "the log has 5000000 to"),
        (["log00", *["acc"] * 21], 2, "21 panels, and 20 fit"),
        (["many00", "g"], 2, "9 variables in one panel, and 8 fit"),
        (["many00", "acc.x"], 2, "write estPose:acc.x or fixedFrequency:acc.x"),
        (["many00", "estPose:acc.x"], 2, "no rows of estPose"),
    ],
)
def test_errors(folder: Path, words: list[str], code: int, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "plot", *words, "-o", "p.svg"]) == code
    printed = capsys.readouterr()
    assert says in printed.err
    assert len(printed.err.splitlines()) == 1
    assert not (folder / "p.svg").exists()


def test_files_that_cannot_be_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    there = folder / "there.svg"
    there.write_text("precious")
    for output, says in (("there.svg", "--force"), ("p.jpg", ".svg, .png"), ("nowhere/p.svg", "No such file")):
        assert main(["usd", "plot", "log00", "acc", "-o", output]) == 2
        assert says in capsys.readouterr().err
    assert there.read_text() == "precious"
    assert main(["usd", "plot", "log00", "acc", "-o", "there.svg", "--force"]) == 0
