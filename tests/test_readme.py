"""What the README shows works as shown."""

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent / "usd"))

from logs import FIXED, STATUS, TYPES, Writer

from host.cli import parser

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def block(language: str, containing: str) -> str:
    """The one fenced block of that language with that text in it."""
    found = [text for text in re.findall(rf"```{language}\n(.*?)```", README, re.DOTALL) if containing in text]
    assert len(found) == 1, f"{len(found)} {language} blocks with {containing!r} in the README"
    return found[0]


def host(*words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """The command, to its end."""
    return subprocess.run(
        [sys.executable, "-m", "host", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_python_example() -> None:
    result = subprocess.run(
        [sys.executable, "-c", block("python", "host.open")], capture_output=True, text=True, timeout=120, cwd=ROOT
    )
    assert result.returncode == 0, result.stderr
    assert re.search(r"324.*244|244.*324", result.stdout)


def test_pytest_example(tmp_path: Path) -> None:
    (tmp_path / "test_example.py").write_text(block("python", "spindeck_robot"), encoding="utf-8")
    result = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_example.py"],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
    )
    assert result.returncode == 0, result.stdout + result.stderr
    assert re.search(r"\b[1-9]\d* passed", result.stdout)


@pytest.mark.parametrize("command", re.findall(r"^\.venv/bin/host (stream .*sim://.*)$", README, re.MULTILINE))
def test_commands(command: str, tmp_path: Path) -> None:
    """Every `host stream` line on the simulator, cut to two frames and let run as fast as it goes."""
    if "backend=emulated" in command:
        pytest.importorskip("unicorn", reason="Unicorn is not installed")
        if not all(map(shutil.which, ("arm-none-eabi-gcc", "riscv64-unknown-elf-gcc"))):
            pytest.skip("no compilers for the STM32 and the GAP8")
    if "usd_config=" in command:
        pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")
    words = [
        word + ("&pace=max" if "?" in word else "?pace=max")
        if word.startswith("sim://") and "pace=" not in word
        else word
        for word in shlex.split(command, comments=True)
    ]
    result = host(*words, "--count", "2", "--json", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert '"event":"summary"' in result.stdout
    if "usd_config=" in command:
        card = "card.0.img" if "swarm" in command else "card.img"
        log = host("usd", "info", f"{card}:/log00", "--json", cwd=tmp_path)
        assert log.returncode == 0, log.stderr
        assert json.loads(log.stdout)["whole"] is True


@pytest.mark.parametrize("command", re.findall(r"^\.venv/bin/host (doctor .*sim://.*)$", README, re.MULTILINE))
def test_doctor(command: str, tmp_path: Path) -> None:
    words = [f"{word}&pace=max" if word.startswith("sim://") else word for word in shlex.split(command)]
    result = host(*words, "--duration", "10", cwd=tmp_path)
    assert result.returncode == 4, result.stderr
    assert '"cause":"uart1_loss"' in result.stdout


@pytest.mark.parametrize("command", re.findall(r"^\.venv/bin/host (sim serve.*)$", README, re.MULTILINE))
def test_served_robots(command: str, tmp_path: Path) -> None:
    """Every `host sim serve` line, on ports that are free: it says where it is, and ends with Ctrl-C."""
    words = shlex.split(command, comments=True)
    where = [] if "--pty" in words else ["--listen", "127.0.0.1:0"]
    program = subprocess.Popen(
        [sys.executable, "-m", "host", *words, *where],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT), "XDG_RUNTIME_DIR": str(tmp_path)},
    )
    assert program.stdout is not None
    first = program.stdout.readline()
    program.send_signal(signal.SIGINT)
    _, said = program.communicate(timeout=60)
    assert program.returncode == 0, said
    assert first.startswith("/dev/" if "--pty" in words else "socket://127.0.0.1:")


@pytest.mark.parametrize(
    "command", re.findall(r"^(?:echo .*\| )?\.venv/bin/host d(?:eck|issect) .*$", README, re.MULTILINE)
)
def test_decks_and_captures(command: str, tmp_path: Path) -> None:
    """Every line that can be run without a robot, as it stands; the options of the others exist."""
    (tmp_path / "capture.bin").write_bytes(bytes.fromhex("ff040a042001d4"))
    (tmp_path / "lab.key").write_text("12345678\n")
    line = command.replace(".venv/bin/host", f"{shlex.quote(sys.executable)} -m host")
    line = line.replace("socket://192.168.4.1:5000", "sim://hover")
    result = subprocess.run(
        ["bash", "-c", line],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert result.returncode == 0, result.stderr
    assert result.stdout


POSE = ["x", "y", "z", "qx", "qy", "qz", "qw"]
VALUES = [*(f"stateEstimate.{name}(f)" for name in POSE), *(f"gyro.{axis}(f)" for axis in "xyz")]
LOGGED = {FIXED: ("fixedFrequency", VALUES), STATUS: TYPES[STATUS]}


def small_log() -> bytes:
    """From 0.6 to 1.6 s, at 500 Hz."""
    log = Writer(session=1, types=dict(LOGGED), start=600_000)
    for number in range(500):
        log.row(FIXED, 600_000 + 2000 * number, number / 100, 0, 1, 0, 0, 0, 1, 0, 0, number)
    return log.close()


@pytest.mark.parametrize("command", re.findall(r"^\.venv/bin/host (usd .*)$", README, re.MULTILINE))
def test_logs(command: str, tmp_path: Path) -> None:
    """Every `host usd` line, on a small log, on a card with it, and with a recording of the same time."""
    for name in ("log00", "log01"):
        (tmp_path / name).write_bytes(small_log())
    (tmp_path / "config.txt").write_text("1\n4096\nlog\n0\non:fixedFrequency\n500\n1\nstateEstimate.x\ngyro.z\n")
    if "flight1.mcap" in command:
        made = host(
            "stream", "--port", "sim://hover?pace=max", "--count", "5", "--record", "flight1.mcap", cwd=tmp_path
        )
        assert made.returncode == 0, made.stderr
    if "card.img" in command:
        pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")
        from sim.card import Card

        card = Card(16)
        card.put("log00", small_log())
        card.save(str(tmp_path / "card.img"))
    result = host(*shlex.split(command, comments=True), cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert result.stdout


def test_times_afterwards(tmp_path: Path) -> None:
    """The `host sync stamps` lines, on a recording; those about logs need real ones (tests/clock/test_robots.py)."""
    record = ["--port", "sim://hover?pace=max", "--count", "20", "--record", "flight1.mcap", "--json"]
    assert host("stream", *record, cwd=tmp_path).returncode == 0
    commands = re.findall(r"^\.venv/bin/host (sync stamps .*)$", README, re.MULTILINE)
    assert len(commands) == 3
    for command in commands:
        result = host(*shlex.split(command, comments=True), cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert "stamped" in result.stdout


def test_robots_that_heard_beacons(tmp_path: Path) -> None:
    """The line that makes the logs, as it is, and the one that compares them."""
    pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")
    (fly,) = re.findall(r"^\.venv/bin/host (stream .*beacon_hz.*)$", README, re.MULTILINE)
    assert host(*shlex.split(fly, comments=True), cwd=tmp_path).returncode == 0
    (compare,) = re.findall(r"^\.venv/bin/host (sync robots card.*)$", README, re.MULTILINE)
    result = host(*shlex.split(compare, comments=True), cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "card.2.img:/log00 against card.1.img:/log00" in result.stdout


def test_beacons_to_simulated_robots(tmp_path: Path) -> None:
    """The line without a dongle, as it is, and the one that compares the logs; the others' options exist."""
    pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")
    commands = re.findall(r"^\.venv/bin/host (sync beacons .*)$", README, re.MULTILINE)
    (simulated,) = (each for each in commands if "sim://" in each)
    assert len(commands) == 3
    for command in commands:
        parser().parse_args(shlex.split(command, comments=True))
    sent = host(*shlex.split(simulated, comments=True), cwd=tmp_path)
    assert sent.returncode == 0, sent.stderr
    assert "240 beacons sent, 0 that the dongle did not take" in sent.stdout
    (compare,) = re.findall(r"^\.venv/bin/host (sync robots host00 .*)$", README, re.MULTILINE)
    result = host(*shlex.split(compare, comments=True), cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "card.1.img:/log00 against host00" in result.stdout


def test_the_two_commands_exist() -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {"stream", "test"} <= set(targets)
    assert "make stream" in README
    assert "make test" in README


def test_every_figure_has_a_script_and_every_script_a_figure() -> None:
    table = README.split("## How fast")[1].split("\n## ")[0]
    named = set(re.findall(r"benchmarks/(\w+\.py)", table))
    assert named == {path.name for path in (ROOT / "benchmarks").glob("*.py")}
