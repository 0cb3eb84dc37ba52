"""`host firmware build` and `info`: what they print, what they write, and what they say about wrong input."""

import importlib.util
import json
import random
import shutil
from pathlib import Path
from typing import Any

import pytest

from host.cli import main

pytest.importorskip("elftools", reason="pyelftools is not installed")
needs_gcc = pytest.mark.skipif(not shutil.which("arm-none-eabi-gcc"), reason="arm-none-eabi-gcc is not installed")


def json_lines(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def build(folder: Path, *words: str) -> int:
    return main(["firmware", "build", "--target", "stm32", "--toolchain", "gcc", "--output", str(folder), *words])


@needs_gcc
def test_build_writes_three_files_and_prints_what_takes_how_much(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build(tmp_path / "new") == 0
    out = capsys.readouterr().out
    assert next(line for line in out.splitlines() if line.startswith("  flash ")).split()[2:4] == ["of", "1,048,576"]
    assert "stm32_transmit" in out
    assert {path.name for path in (tmp_path / "new").iterdir()} == {
        "stm32.elf",
        "stm32.bin",
        "stm32.map",
        "spindeck-firmware.json",
    }
    assert build(tmp_path / "new", "--json") == 0
    (record,) = json_lines(capsys.readouterr().out)
    assert record["event"] == "image"
    assert (record["target"], record["toolchain"]) == ("stm32", "gcc")
    assert Path(record["bin"]).stat().st_size == record["load_bytes"]
    sizes = [function["bytes"] for function in record["functions"]]
    assert sizes == sorted(sizes, reverse=True)
    assert len(sizes) > 40
    text = next(part["bytes"] for part in record["sections"] if part["name"] == ".text")
    assert 0.95 * text < sum(sizes) <= text


@needs_gcc
def test_info_of_an_image_says_what_not_to_believe(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert build(tmp_path) == 0
    capsys.readouterr()
    assert main(["firmware", "info", str(tmp_path / "stm32.elf")]) == 0
    out = capsys.readouterr().out
    for said in (
        "STM32F405",
        "GCC: ",
        "board_config",
        ".vectors",
        "entry 0x080",
        "does not fly",
        "never on a Crazyflie",
    ):
        assert said in out
    assert main(["firmware", "info", str(tmp_path / "stm32.elf"), "--json"]) == 0
    (record,) = json_lines(capsys.readouterr().out)
    assert record["symbols"]["_stack_top"] - record["symbols"]["_stack_limit"] == record["stack_bytes"]
    assert record["toolchain"] is None
    assert any("does not fly" in limit for limit in record["limits"])


@needs_gcc
@pytest.mark.parametrize("name", ["stm32.elf", "stm32.bin", "stm32.map", "spindeck-firmware.json"])
def test_what_somebody_else_has_written_stays(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / name).write_text("mine")
    assert build(tmp_path) == 2
    assert f"{tmp_path / name} is " in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "mine"


@needs_gcc
def test_own_files_are_written_again_unless_they_were_changed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert build(tmp_path) == 0
    first = (tmp_path / "stm32.bin").read_bytes()
    assert build(tmp_path, "--stamp-divider", "84") == 0
    assert (tmp_path / "stm32.bin").read_bytes() != first
    with (tmp_path / "stm32.map").open("a") as file:
        file.write("notes")
    assert build(tmp_path) == 2
    assert "stm32.map" in capsys.readouterr().err
    assert (tmp_path / "stm32.map").read_text().endswith("notes")
    assert (tmp_path / "stm32.bin").read_bytes() != first


@needs_gcc
def test_damaged_images_are_refused_and_never_a_crash(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert build(tmp_path) == 0
    whole = (tmp_path / "stm32.elf").read_bytes()
    damaged = tmp_path / "damaged.elf"
    table = int.from_bytes(whole[32:36], "little")
    codes = set()
    for seed in range(40):
        rng = random.Random(seed)
        content = bytearray(whole[: rng.randrange(len(whole))] if seed % 2 else whole)
        for _ in range(4 if seed % 2 == 0 else 0):
            content[rng.choice([rng.randrange(52), rng.randrange(table, len(whole))])] = rng.randrange(256)
        damaged.write_bytes(content)
        code = main(["firmware", "info", str(damaged)])
        err = capsys.readouterr().err
        assert code == 0 or (code == 2 and err.startswith(f"host: {damaged}: ")), f"seed {seed}"
        codes.add(code)
    assert codes == {0, 2}


def test_other_files_are_no_images(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shell = Path("/bin/sh").resolve()
    text = tmp_path / "text.elf"
    text.write_text("hello")
    for path, said in [
        (tmp_path / "none.elf", "No such file"),
        (text, "not an ELF file"),
        (tmp_path, "Is a directory"),
        (shell, "not an image of this project"),
    ]:
        assert main(["firmware", "info", str(path)]) == 2
        err = capsys.readouterr().err
        assert err.startswith(f"host: {path}: {said}"), err
        assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["build", "--target", "gap8", "--stamp-divider", "84"], "--target stm32"),
        (["build", "--stamp-divider", "84"], "--target stm32"),
        (["build", "--target", "esp32", "--toolchain", "zig"], "zig has no code generator for the esp32"),
        (["info", "x.elf", "--target", "gap8"], "leave out --target"),
    ],
)
def test_what_does_not_go_together(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["firmware", *words]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def no_compilers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "ziglang" else find_spec(name))


@pytest.mark.usefixtures("no_compilers")
@pytest.mark.parametrize(
    ("words", "packages"),
    [
        (["--target", "stm32"], ["gcc-arm-none-eabi", "spindeck[firmware]"]),
        (["--target", "gap8", "--toolchain", "gcc"], ["gcc-riscv64-unknown-elf"]),
        (["--target", "gap8", "--toolchain", "zig"], ["spindeck[firmware]"]),
        (["--target", "esp32"], ["gcc-xtensa-lx106"]),
        (["--target", "all"], ["gcc-arm-none-eabi", "gcc-riscv64-unknown-elf", "gcc-xtensa-lx106"]),
    ],
)
def test_a_missing_compiler_is_named_with_its_package(
    words: list[str], packages: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    for command in ("build", "info"):
        assert main(["firmware", command, *words]) == 2
        captured = capsys.readouterr()
        assert captured.out == ""
        for package in packages:
            assert package in captured.err


@needs_gcc
def test_folders_that_cannot_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert build(tmp_path / "file") == 2
    assert str(tmp_path / "file") in capsys.readouterr().err
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert build(tmp_path / "out") == 2
    assert "XDG_CACHE_HOME" in capsys.readouterr().err
