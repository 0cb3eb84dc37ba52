"""`host firmware run`: what it shows, on a pseudo-terminal too, and what it says about wrong input."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from host.cli import main
from host.firmware.build import build
from host.firmware.toolchains import MissingError
from host.link.session import Session
from host.protocol.dissect import split
from host.protocol.errors import LocalError

pytest.importorskip("unicorn", reason="Unicorn is not installed")
pytest.importorskip("elftools", reason="pyelftools is not installed")

ROOT = Path(__file__).resolve().parents[2]


def image(mcu: str) -> str:
    try:
        return str(build(mcu).elf)
    except MissingError as error:
        pytest.skip(str(error))


def test_time_messages_explained_as_hex_and_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["firmware", "run", image("stm32"), "--seconds", "0.05", "--pace", "max"]
    assert main([*words, "--form", "explained"]) == 0
    out, said = capsys.readouterr()
    assert len(out.splitlines()) == 5
    assert out.splitlines()[3].strip() == "0.030000    17 stamp: stamp message; sequence 3, stm32_us 30000, epoch 0"
    assert said.startswith("stm32: 0.050 s simulated; 85 bytes in 5 runs on uart1; ")
    assert main([*words, "--form", "hex"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[:6] == ["0.010000", "17", "d5", "2a", "01", "00"]
    assert main([*words, "--json"]) == 0
    *records, summary = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [record["fields"]["stm32_us"] for record in records] == [0, 10000, 20000, 30000, 40000]
    assert [record["local_ns"] for record in records] == [0, 10_000_000, 20_000_000, 30_000_000, 40_000_000]
    assert summary["bytes"] == 85
    assert 100 < summary["stack_used_bytes"] < 8192


def test_other_wires(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--seconds", "1", "--pace", "max", "--form", "explained"]
    assert main(["firmware", "run", image("stm32"), "--wire", "uart2", *words]) == 0
    assert "STM32 to ESP32, WIFI_CTRL: SET_SSID" in capsys.readouterr().out
    assert main(["firmware", "run", image("gap8"), *words]) == 0
    assert "GAP8 to HOST, APP (last): image body, bytes 0..1019 of 79056" in capsys.readouterr().out


def test_piped_bytes_are_raw() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "host", "firmware", "run", image("stm32"), "--seconds", "2"],
        capture_output=True, cwd=ROOT, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    session = Session("stamps", "native")
    assert len(session.receive(done.stdout, 0)) == 200
    assert len(done.stdout) == 202 * 17, "two answers to echoes among them"


def test_raw_spi_is_windows_that_dissect_reads() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "host", "firmware", "run", image("gap8"), "--seconds", "1"],
        capture_output=True, cwd=ROOT, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    pieces = list(split(done.stdout, "spi"))
    assert {piece.kind for piece in pieces} == {"packet", "idle"}
    assert sum(piece.kind == "packet" for piece in pieces) > 100


def test_a_pseudo_terminal(tmp_path: Path) -> None:
    program = subprocess.Popen(
        [sys.executable, "-m", "host", "firmware", "run", image("stm32"), "--pty"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, cwd=ROOT, text=True,
    )  # fmt: skip
    assert program.stdout is not None
    path = program.stdout.readline().strip()
    try:
        reader = os.open(path, os.O_RDWR | os.O_NOCTTY)
        got = b""
        while len(got) < 200:
            got += os.read(reader, 1024)
        os.close(reader)
    finally:
        program.terminate()
        _, said = program.communicate(timeout=60)
    assert program.returncode == 0, said
    assert b"\xd5\x2a" in got
    assert "bytes of stack used" in said


def test_damaged_images_are_refused_and_never_a_crash(tmp_path: Path) -> None:
    """Loaded alone: what a damaged instruction does is the emulator's to say."""
    from sim import images

    damaged = tmp_path / "damaged.elf"
    whole = Path(image("stm32")).read_bytes()
    table = int.from_bytes(whole[32:36], "little")
    said = []
    for at in range(table, len(whole), 4):  # each number of the section headers
        damaged.write_bytes(whole[:at] + bytes([whole[at] ^ 0x0F]) + whole[at + 1 :])
        try:
            images.load(damaged)
        except LocalError as error:
            said.append(str(error))
    assert len(said) > 5
    assert all(each.startswith(f"{damaged}") for each in said)


WRONG = [
    (["/nonexistent.elf"], "/nonexistent.elf: No such file"),
    (["BIN"], "not an ELF file"),
    ([sys.executable], "images that can be run are those of stm32, gap8"),
    (["GAP8", "--pty"], "the GAP8's UART only receives"),
    (["GAP8", "--wire", "uart1"], "the gap8 sends nothing there, but on spi"),
    (["STM32", "--wire", "spi"], "the stm32 sends nothing there, but on uart1 and uart2"),
    (["STM32", "--pty", "--form", "hex"], "its bytes are raw"),
]


@pytest.mark.parametrize(("words", "said"), WRONG)
def test_wrong_input(words: list[str], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    binary = tmp_path / "stm32.bin"
    binary.write_bytes(b"\xff" * 64)
    known = {"BIN": str(binary), "GAP8": image("gap8"), "STM32": image("stm32")}
    assert main(["firmware", "run", *(known.get(word, word) for word in words)]) == 2
    out, error = capsys.readouterr()
    assert out == ""
    assert said in error
    assert len(error.splitlines()) == 1
