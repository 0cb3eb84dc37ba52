"""A copy of a recording with times added: everything else is there as it was, for the MCAP package too."""

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from host.cli import main

URL = "sim://swarm?robots=2&pace=max&seed=7&camera_width=64&camera_height=48&robot={}"


def record(folder: Path, robots: int = 1, url: str = URL, seconds: str = "4") -> str:
    path = str(folder / "flight.mcap")
    ports = [word for robot in range(robots) for word in ("--port", url.format(robot))]
    assert main(["stream", *ports, "--duration", seconds, "--record", path, "--json"]) == 0
    return path


def messages(path: str) -> dict[str, list[tuple[int, int, bytes]]]:
    """By topic, in the order of the file."""
    found: dict[str, list[tuple[int, int, bytes]]] = {}
    with Path(path).open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append((message.log_time, message.publish_time, message.data))
    return found


@pytest.mark.parametrize("robots", [1, 2])
def test_the_copy_has_all_and_the_times(robots: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, out = record(tmp_path, robots), str(tmp_path / "times.mcap")
    before = Path(path).read_bytes()
    assert main(["sync", "stamps", path, "--apply", out]) == 0
    assert Path(path).read_bytes() == before
    old, new = messages(path), messages(out)
    assert new.keys() - old.keys() == {f"/robot{robot}/restamped" for robot in range(robots)}
    assert {topic: new[topic] for topic in old} == old
    capsys.readouterr()
    for robot in range(robots):
        table = tmp_path / f"{robot}.csv"
        assert main(["sync", "stamps", path, "--apply", str(table), "--robot", str(robot)]) == 0
        frames = [json.loads(each[2]) for each in new[f"/robot{robot}/frame"]]
        times = [json.loads(each[2]) for each in new[f"/robot{robot}/restamped"]]
        # The first frame came as stock, and has no GAP8 time.
        frames = [each for each in frames if "native" in each]
        # Frames that were read together with the event that ended the recording are in its bytes alone: how many is
        # up to the threads of the two ports.
        assert len(times) >= len(frames) > 8
        assert [each[:2] for each in new[f"/robot{robot}/restamped"][: len(frames)]] == [
            each[:2] for each in new[f"/robot{robot}/frame"] if "native" in json.loads(each[2])
        ]
        among = times[: len(frames)]
        assert [each["frame_index"] for each in among] == [each["index"] for each in frames]
        assert [each["frame_gap8_us"] for each in among] == [each["native"]["frame_gap8_us"] for each in frames]
        rows = [line.split(",") for line in table.read_text(encoding="utf-8").splitlines()[1:]]
        told = [(each.get("frame_stm32_us"), each.get("bound_us"), each.get("refused", "")) for each in times]
        assert [(row[3], row[4], row[6]) for row in rows] == [
            ("" if time is None else str(time), "" if bound is None else str(bound), why) for time, bound, why in told
        ]
        assert [row[7] for row in rows] == [str(int(each["holdover"])) if "holdover" in each else "" for each in times]
        # Of so few frames no pace is found: how late readings may be is in the bound, 93 us.
        assert np.median([bound for _, bound, _ in told if bound is not None]) < 143
    # It is a recording like any other.
    capsys.readouterr()
    assert main(["stream", "--port", f"replay://{out}?pace=max", "--json"]) == 0
    assert main(["sync", "stamps", out, "--robot", "0", "--json"]) == 0
    assert '"stamped"' in capsys.readouterr().out
    assert main(["recover", out, "-o", str(tmp_path / "again.mcap")]) == 0
    assert messages(str(tmp_path / "again.mcap")) == new


def test_what_is_not_written(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path)
    before = Path(path).read_bytes()
    for words in ([], ["--force"]):
        assert main(["sync", "stamps", path, "--apply", path, *words]) == 2
        assert "that is the recording" in capsys.readouterr().err
    linked = tmp_path / "linked.mcap"
    linked.symlink_to(path)
    assert main(["sync", "stamps", path, "--apply", str(linked), "--force"]) == 2
    out = tmp_path / "times.mcap"
    assert main(["sync", "stamps", path, "--apply", str(out)]) == 0
    assert main(["sync", "stamps", path, "--apply", str(out)]) == 2
    assert main(["sync", "stamps", str(out), "--apply", str(tmp_path / "twice.mcap")]) == 2
    assert "/robot0/restamped already" in capsys.readouterr().err
    assert Path(path).read_bytes() == before
    (tmp_path / "paper").mkdir()
    paper = record(tmp_path / "paper", url="sim://paper?pace=max", seconds="2")
    assert main(["sync", "stamps", paper, "--apply", str(tmp_path / "paper.mcap")]) == 4
    assert "nothing was written" in capsys.readouterr().err
    assert sorted(each.name for each in tmp_path.iterdir()) == ["flight.mcap", "linked.mcap", "paper", "times.mcap"]
