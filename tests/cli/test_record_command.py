"""`host stream --record` as a user meets it."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from mcap.reader import make_reader

from host.cli import main

ROOT = Path(__file__).resolve().parents[2]


def topics(path: Path) -> dict[str, int]:
    with path.open("rb") as file:
        found = make_reader(file, validate_crcs=True).get_summary()
    return {found.channels[number].topic: count for number, count in found.statistics.channel_message_counts.items()}


def test_two_robots_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "two.mcap"
    ports = [f"sim://hover?robots=2&robot={robot}&pace=max" for robot in (0, 1)]
    words = ["stream", "--port", ports[0], "--port", ports[1], "--count", "3", "--record", str(path)]
    assert main(words) == 0
    summaries = [json.loads(line) for line in capsys.readouterr().out.splitlines() if '"summary"' in line]
    for each in summaries:
        assert each["recorded"]["file"] == str(path)
        assert each["recorded"]["frames"] == 3
        assert not any(each["recorded"]["missing"].values())
    found = topics(path)
    assert [found[f"/robot{robot}/image"] for robot in (0, 1)] == [3, 3]
    assert main(words) == 2
    assert "ever overwritten" in capsys.readouterr().err


def test_a_port_that_cannot_be_opened_leaves_no_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["stream", "--port", "socket://127.0.0.1:1", "--record", str(tmp_path / "none.mcap")]
    assert main(words) == 2
    assert not (tmp_path / "none.mcap").exists()


@pytest.mark.parametrize(("part", "gone"), [("images", "/robot0/image"), ("raw", "/robot0/received")])
def test_record_without(tmp_path: Path, part: str, gone: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "half.mcap"
    words = ["--port", "sim://hover?pace=max", "--count", "3", "--record", str(path), "--record-without", part]
    assert main(["stream", *words]) == 0
    assert gone not in topics(path)
    assert topics(path)["/robot0/frame"] == 3


def test_images_made_again_from_the_raw_bytes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small, full = tmp_path / "small.mcap", tmp_path / "full.mcap"
    words = ["--count", "3", "--record", str(small), "--record-without", "images"]
    assert main(["stream", "--port", "sim://hover?pace=max", *words]) == 0
    assert main(["stream", "--port", f"replay://{small}?pace=max", "--record", str(full)]) == 0
    assert topics(full)["/robot0/image"] == 3


def test_ctrl_c_keeps_everything(tmp_path: Path) -> None:
    """The file is whole, and has every frame that was shown."""
    path = tmp_path / "stopped.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "host", "stream", "--port", "sim://hover?camera_fps=20", "--record", str(path)],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    lines = [process.stdout.readline() for _ in range(20)]
    process.send_signal(signal.SIGINT)
    rest, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    shown = sum('"event":"frame"' in line for line in [*lines, *rest.splitlines()])
    assert topics(path)["/robot0/frame"] >= shown > 0


def test_the_file_grows_while_it_is_recorded(tmp_path: Path) -> None:
    path = tmp_path / "growing.mcap"
    process = subprocess.Popen(
        [sys.executable, "-m", "host", "stream", "--port", "sim://hover", "--record", str(path)],
        cwd=ROOT, stdout=subprocess.DEVNULL,
    )  # fmt: skip
    sizes: set[int] = set()
    until = time.monotonic() + 60
    while len(sizes) < 5 and time.monotonic() < until:
        if path.exists():
            sizes.add(path.stat().st_size)
        time.sleep(0.01)
    process.kill()
    process.wait()
    assert len(sizes) >= 5
