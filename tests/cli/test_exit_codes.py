"""Whose fault it was is in the exit code, and every --help says so."""

import argparse
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from host import cli
from host.cli import EXIT_CODES, main, parser, stream
from host.protocol.errors import ConnectionLostError, LocalError, PeerError, PeerSilentError

ROOT = Path(__file__).resolve().parents[2]
LOG = bytes.fromhex(
    "bc 02 00 01 00 ff ff 66 69 78 65 64 46 72 65 71 75 65 6e 63 79 00 01 00 61 63 63 2e 78 28 66 29 00"
    "ff ff e8 03 00 00 00 00 00 00 00 00 80 3f ca 92 18 1e"
)
"""acc.x = 1.0 at 1000 us."""


def commands(of: argparse.ArgumentParser, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield words
    for action in of._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, command in action.choices.items():
                yield from commands(command, (*words, name))


ALL = list(commands(parser()))


def test_the_commands_are_found() -> None:
    assert {(), ("stream",), ("dissect",), ("deck",), ("deck", "wifi"), ("sim", "serve")} <= set(ALL)


@pytest.mark.parametrize("words", ALL, ids=" ".join)
def test_every_help_lists_them(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main([*words, "--help"])
    assert ended.value.code == 0
    out = capsys.readouterr().out
    assert EXIT_CODES.rstrip() in out
    assert out.count("exit codes:") == 1


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (LocalError("you"), 2),
        (PeerSilentError("silent"), 3),
        (PeerError("nonsense"), 4),
        (ConnectionLostError("lost"), 5),
        (KeyboardInterrupt(), 130),
    ],
)
def test_each_blame_has_its_code(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(arguments: argparse.Namespace) -> int:
        raise error

    monkeypatch.setattr(stream, "run", run)
    assert main(["stream", "--port", "sim://hover"]) == code
    said = capsys.readouterr().err
    assert said == (f"host: {error}\n" if str(error) else "")
    assert f"\n  {code:<4} " in cli.EXIT_CODES


def test_done_and_a_bug() -> None:
    code = (
        "import host.cli, sys\n"
        "def run(arguments): return 0 if arguments.json else 1 // 0\n"
        "host.cli.stream.run = run\n"
        "sys.exit(host.cli.main(sys.argv[1:]))"
    )
    for words, expected in ((["--json"], 0), ([], 1)):
        result = subprocess.run(
            [sys.executable, "-c", code, "stream", "--port", "sim://hover", *words],
            capture_output=True, text=True, cwd=ROOT, timeout=60,
        )  # fmt: skip
        assert result.returncode == expected
        assert ("ZeroDivisionError" in result.stderr) == (expected == 1)


def test_nothing_to_do_and_wrong_words(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    with pytest.raises(SystemExit) as ended:
        main(["strem"])
    assert ended.value.code == 2


def test_a_full_disk_is_no_bug() -> None:
    command = f"{sys.executable} -m host dissect README.md > /dev/full"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert result.returncode == 2
    assert "No space left" in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize(
    "words",
    [
        "usd info {}", "usd info {}:/log00", "usd decode log -o {}.csv", "usd repair log -o {}", "usd config check {}",
        "sync gyro {} log", "recover {}", "sync stamps log --apply {}.csv",
        "stream --port sim://hover --count 1 --picture {}.png",
    ],
)  # fmt: skip
def test_a_name_that_no_file_can_have_is_no_bug(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("log").write_bytes(LOG)
    assert main(words.format("x" * 300).split()) == 2
    said = capsys.readouterr().err
    assert said.startswith("host: ")
    assert said.endswith(": File name too long\n")


@pytest.mark.parametrize(
    ("redirected", "code"), [(">&-", 0), ("<&- >&- 2>&-", 0), ("--framing stamps >&- 2>&-", 4), ("- <&-", 2)]
)
def test_closed_streams_are_no_bug(redirected: str, code: int, tmp_path: Path) -> None:
    capture = tmp_path / "capture.bin"
    capture.write_bytes(bytes.fromhex("ff 04 0a 04 20 01 d4") * 3)
    file = "" if redirected.startswith("- ") else str(capture)
    command = f"{sys.executable} -m host dissect {file} {redirected}"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert result.returncode == code, result.stderr
    assert "Traceback" not in result.stderr
