"""The command line as a user meets it, wrong input included."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def host(*words: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "host", *words],
        capture_output=True,
        text=True,
        timeout=120,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(ROOT), "COLUMNS": "120"},
    )


def records(stdout: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in stdout.splitlines()]


def test_help_lists_exit_codes_and_imports_nothing_heavy() -> None:
    assert "exit codes" in host("--help").stdout
    code = (
        "import sys, host.cli; host.cli.parser();"
        "print(sorted({'numpy', 'rich', 'serial', 'PIL', 'cffi', 'construct', 'sim'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert result.stdout.strip() == "[]", result.stdout + result.stderr


def test_frames_and_summary_as_json() -> None:
    result = host("stream", "--port", "sim://hover?pace=max&seed=3", "--count", "4")
    assert result.returncode == 0, result.stderr
    events = records(result.stdout)
    frames = [event for event in events if event["event"] == "frame"]
    assert [frame["index"] for frame in frames] == [0, 1, 2, 3]
    assert frames[-1]["frame_gap8_us"] > 0
    assert events[-1]["event"] == "summary"
    assert events[-1]["frames"] == 4
    assert events[-1]["stamp_error_us"]["n"] > 0


def test_frames_over_uart2() -> None:
    """The host sits in the STM32's place and must give credits."""
    result = host("stream", "--port", "sim://hover?wire=uart2&pace=max", "--count", "2")
    assert result.returncode == 0, result.stderr
    assert records(result.stdout)[-1]["frames"] == 2


def test_same_seed_same_lines() -> None:
    runs = [host("stream", "--port", "sim://hover?pace=max&seed=5", "--count", "6").stdout for _ in range(2)]
    assert runs[0] == runs[1]
    assert len(runs[0].splitlines()) > 6


def test_several_robots() -> None:
    result = host(
        "stream", "--port", "sim://hover?robots=2&robot=0&pace=max", "--port", "sim://hover?robots=2&robot=1&pace=max",
        "--count", "3",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    summaries = [event for event in records(result.stdout) if event["event"] == "summary"]
    assert [(summary["robot"], summary["frames"]) for summary in summaries] == [(0, 3), (1, 3)]


def test_images_where_a_file_is(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for path in (tmp_path / "file", tmp_path / "file" / "below"):
        result = host("stream", "--port", "sim://hover", "--images", str(path))
        assert result.returncode == 2
        assert result.stderr == f"host: --images {path}: a file is there: name a new folder\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--record", ""], "--record: its name is empty"),
        (["--images", ""], "--images: its name is empty"),
        (["--picture", ""], "--picture: its name is empty"),
        (["--picture", "no-such-folder/last.png"], "there is no folder no-such-folder"),
        (["--record-without", "raw"], "nothing is recorded: add --record FILE"),
    ],
)
def test_what_would_keep_nothing_is_said_before_the_stream(words: list[str], says: str) -> None:
    result = host("stream", "--port", "sim://hover?pace=max", "--count", "1", *words)
    assert result.returncode == 2
    assert result.stdout == ""
    assert says in result.stderr


def test_images_are_kept_and_never_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "flight"
    words = ["stream", "--port", "sim://hover?pace=max", "--count", "3", "--images", str(folder)]
    assert host(*words).returncode == 0
    lines = records((folder / "frames.jsonl").read_text())
    assert [line["image"] for line in lines] == ["000000.pgm", "000001.pgm", "000002.pgm"]
    for line in lines:
        assert (folder / str(line["image"])).read_bytes().startswith(b"P5\n324 244\n255\n")
        assert (folder / str(line["image"])).stat().st_size == 15 + 324 * 244
    again = host(*words)
    assert again.returncode == 2
    assert "not empty" in again.stderr


def test_picture(tmp_path: Path) -> None:
    from PIL import Image

    path = tmp_path / "last.png"
    words = ["stream", "--port", "sim://hover?pace=max", "--count", "2", "--picture", str(path)]
    assert host(*words).returncode == 0
    with Image.open(path) as image:
        assert image.size == (324, 244)
    assert host(*words).returncode == 2


def test_a_picture_that_cannot_be_saved_costs_no_summary(tmp_path: Path) -> None:
    path = tmp_path / "last.png"
    words = ["stream", "--port", "sim://hover?pace=max", "--count", "2", "--images", str(path), "--picture", str(path)]
    result = host(*words)  # whose folder takes the picture's place
    assert result.returncode == 2
    assert "last.png" in result.stderr
    assert records(result.stdout)[-1]["event"] == "summary"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--port", "sim://hoover"], "hover"),
        (["--port", "sim://hover?gap8_pmm=80"], "gap8_ppm"),
        (["--port", "sim://hover?gap8_ppm=90000"], "20000"),
        (["--port", "sim://hover?uart1_loss=much"], "uart1_loss"),
        (["--port", "/dev/no-such-port"], "/dev/no-such-port"),
        (["--port", "nonsense://x"], "nonsense"),
        (["--port", "socket://127.0.0.1:1"], "refused"),
        (["--port", "sim://hover", "--count", "0"], "--count"),
        (["--port", "sim://hover", "--camera", "/no/such/folder"], "/no/such/folder"),
    ],
)
def test_wrong_input_is_told_in_one_line(words: list[str], says: str) -> None:
    result = host("stream", *words)
    assert result.returncode == 2, result.stdout + result.stderr
    assert says in result.stderr
    assert "Traceback" not in result.stderr


def test_a_silent_robot_is_the_peers_fault() -> None:
    result = host("stream", "--port", "sim://hover?pace=max&camera_fps=0", "--timeout", "2")
    assert result.returncode == 3
    assert "Traceback" not in result.stderr


@pytest.mark.parametrize("scenario", ["hover", "paper", "nanocockpit"])
def test_a_tap_on_uart1_hears_the_time_messages_of_each_firmware(scenario: str) -> None:
    result = host("stream", "--port", f"sim://{scenario}?pace=max&wire=uart1", "--duration", "1")
    assert result.returncode == 0, result.stderr
    events = records(result.stdout)
    assert sum(str(event["event"]).endswith("stamp") for event in events) > 90
    assert not any(event["event"] == "garbage" for event in events)
