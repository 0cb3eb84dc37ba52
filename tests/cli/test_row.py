"""host stream --row: the time of one row of each picture."""

import json
import subprocess
import sys

import pytest

SHORT = "sim://hover?pace=max&camera_fps=10"


def stream(*more):
    command = [sys.executable, "-m", "host", "stream", "--port", SHORT, "--count", "8", "--json", *more]
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.parametrize(("row", "number"), [("first", 0), ("middle", 121.5), ("last", 243), ("100", 100)])
def test_a_row_s_time(row, number, tmp_path):
    done = stream("--row", row, "--images", str(tmp_path / "kept"))
    assert done.returncode == 0, done.stderr
    events = [json.loads(line) for line in done.stdout.splitlines()]
    frames = [event for event in events if event["event"] == "frame"]
    assert {frame["row"] for frame in frames} == {number}
    timed = [frame for frame in frames if frame["frame_stm32_us"] is not None]
    assert timed
    for frame in timed:
        before_us = (243 - number + 50) * 125.333 * (1 + (frame["clock"]["skew_ppb"] if frame["clock"] else 0) * 1e-9)
        assert frame["row_stm32_us"] == pytest.approx(frame["frame_stm32_us"] - before_us, abs=0.1)
    assert {frame["row_stm32_us"] for frame in frames if frame["frame_stm32_us"] is None} <= {None}
    kept = [json.loads(line) for line in (tmp_path / "kept" / "frames.jsonl").read_text().splitlines()]
    assert [frame["row_stm32_us"] for frame in kept] == [frame["row_stm32_us"] for frame in frames]


@pytest.mark.parametrize(
    ("row", "why"), [("244", "244 rows"), ("-1", "a row's number"), ("bottom", "first, middle, last")]
)
def test_rows_that_there_are_not(row, why):
    done = stream(f"--row={row}")
    assert done.returncode == 2
    assert why in done.stderr
