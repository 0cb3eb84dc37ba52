"""`host usd config check`: what people and programs see of a config.txt."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from host.cli import main

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "usd"))

from logs import Writer, fill

GOOD = b"1\n4096\nlog\n0\non:fixedFrequency\n500\n1\nacc.x\nacc.y\npm.vbatMV\non:estTDOA\nacc.x\n"


@pytest.fixture
def card(tmp_path: Path) -> Path:
    (tmp_path / "log00").write_bytes(fill(Writer(session=1), seed=1, rows=2000).close())
    (tmp_path / "good").write_bytes(GOOD)
    (tmp_path / "bad").write_bytes(GOOD.replace(b"500", b"300").replace(b"acc.y", b"acc.Y")[:-1])
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "utf16").write_bytes(GOOD.decode().encode("utf-16"))
    (tmp_path / "huge").write_bytes(b"1\n" * 40000)
    (tmp_path / "latin").write_bytes(GOOD.replace(b"log", b"log # f\xfcr"))
    return tmp_path


def records(capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_what_a_config_costs(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "config", "check", str(card / "good"), "--log", str(card / "log00")]) == 0
    shown = capsys.readouterr().out
    for words in ("no errors, no warnings", "500 Hz, 3 variables, rows of 20 bytes", "log00 to log99", "4096 bytes"):
        assert words in shown
    assert main(["usd", "config", "check", str(card / "good"), "--any", "--rate", "estTDOA=50", "--json"]) == 0
    (record,) = records(capsys)
    assert record["bytes_per_s"] == 500 * 22 + 50 * (10 + 6 + 4) + 42 * 4
    assert (record["types_known"], record["uncounted"]) == (False, [])


def test_names_of_this_firmware(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (card / "ours").write_bytes(GOOD.replace(b"estTDOA", b"estGyroscope"))
    assert main(["usd", "config", "check", str(card / "ours"), "--json"]) == 0
    (record,) = records(capsys)
    assert record["rows_per_s"] == 1500
    (card / "theirs").write_bytes(GOOD.replace(b"acc.y", b"acc.w"))
    assert main(["usd", "config", "check", str(card / "theirs")]) == 4
    shown = capsys.readouterr().out
    assert "no variable 'acc.w' in this project's firmware" in shown
    assert "no event 'estTDOA' in this project's firmware" in shown
    assert "of another: --log with a log of the robot, or --any" in shown


def test_findings_name_their_lines(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "config", "check", str(card / "bad"), "--log", str(card / "log00"), "--json"]) == 4
    *found, summary = records(capsys)
    assert [(each["line"], each["kind"], each["severity"]) for each in found] == [
        (6, "rounded", "warning"),
        (9, "variable", "error"),
        (12, "no_newline", "warning"),
    ]
    assert (summary["good"], summary["errors"], summary["warnings"]) == (False, 1, 2)
    assert main(["usd", "config", "check", str(card / "bad"), "--log", str(card / "log00")]) == 4
    assert "line 9    error    no variable 'acc.Y'" in capsys.readouterr().out


def test_what_is_not_ascii_in_a_comment_does_not_matter(card: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["usd", "config", "check", str(card / "latin"), "--any"]) == 0
    assert "no errors, no warnings" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nowhere", "--any"], "No such file"),
        (["log00", "--any"], "a log: name the config.txt"),
        (["empty", "--any"], "empty: name the config.txt"),
        (["utf16", "--any"], "save it as ASCII"),
        (["huge", "--any"], "80000 bytes"),
        ([".", "--any"], "directory"),
        (["good", "--log", "empty"], "no names in it: empty"),
        (["good", "--log", "good"], "not a log"),
        (["good", "--any", "--rate", "estTDOA"], "EVENT=HZ"),
        (["good", "--any", "--rate", "estTDOA=nan"], "EVENT=HZ"),
        (["good", "--any", "--rate", "estPose=100"], "no block of this event"),
    ],
)
def test_errors(
    card: Path, words: list[str], says: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(card)
    assert main(["usd", "config", "check", *words]) == 2
    err = capsys.readouterr().err
    assert says in err
    assert len(err.splitlines()) == 1
