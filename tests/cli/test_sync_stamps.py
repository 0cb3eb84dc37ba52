"""`host sync stamps` from a recording to its CSV file, against the simulator's truth."""

import csv
import json
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

import host
from host.cli import main
from host.cli.sync_stamps import own_error, work_out
from host.cli.sync_stamps_read import read


def record(tmp_path: Path, url: str, seconds: str = "12") -> str:
    path = str(tmp_path / "flight.mcap")
    assert main(["stream", "--port", url, "--duration", seconds, "--record", path, "--json"]) == 0
    return path


def stamps(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> dict:
    capsys.readouterr()
    assert main(["sync", "stamps", *words, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def true_errors(url: str, table: list[dict[str, str]]) -> np.ndarray:
    """Of the same run once more: equal seeds give equal bytes."""
    with host.open(url) as stream:
        for frame in stream:
            if frame.index >= int(table[-1]["frame_index"]):
                break
        truth = stream.port.world.truth
    key = zip(truth["frame"].tolist(), truth["gap8_stamp_us"].tolist(), strict=True)
    known = dict(zip(key, truth["stm32_stamp_ns"].tolist(), strict=True))
    return np.array(
        [
            float(row["frame_stm32_us"]) - known[int(row["frame"]), int(row["frame_gap8_us"])] / 1000
            for row in table
            if row["frame_stm32_us"]
        ]
    )


@pytest.mark.parametrize(
    ("keys", "slow"),
    [
        ("", False),
        ("&stm32_divider=84&uart1_loss=0.3&uart1_duplicate=0.1&uart1_reorder=0.05", True),
        ("&gap8_quantum=1us&stm32_ppm=-250&gap8_ppm=4000", False),
    ],
    ids=["clean", "84-of-85-bad-wire", "fine-ticks"],
)
def test_against_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str], keys: str, slow: bool) -> None:
    url = f"sim://hover?pace=max&seed=7&camera_jitter_us=0{keys}"
    out = tmp_path / "times.csv"
    said = stamps(capsys, record(tmp_path, url), "--apply", str(out), "--plot", str(tmp_path / "a.svg"))
    table = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    error = np.abs(true_errors(url, table))
    bound = np.array([float(row["bound_us"]) for row in table])
    assert said["stamped"] == len(table) == len(error) > 100
    assert (error <= bound).mean() >= 0.985
    tick_us = 1 if "1us" in keys else 31
    assert np.sqrt(np.mean(error**2)) < (12 if tick_us > 1 else 8)
    assert np.median(bound) < 30
    assert said["epochs"][0]["stm32_counts_84_of_85"] is slow
    assert (tmp_path / "a.svg").read_text(encoding="utf-8").startswith("<svg")


@pytest.mark.parametrize(
    ("keys", "tick_us", "rms_us"),
    [
        ("&stm32_quantum=1ms&stm32_divider=84", 1000, 60),
        ("&stm32_quantum=rtc", 30.517578125, 16),
        ("&stm32_quantum=rtc&stm32_divider=84&gap8_quantum=1us", 30.517578125, 16),
        ("&stm32_quantum=1ms&uart1_loss=0.3", 1, 12),
        ("&gap8_quantum=1us&gap8_ppm=8000", 1, 2),
        ("&gap8_ppm=11000", 1, 12),
    ],
)
def test_clocks_that_are_coarse_or_far_off(
    keys: str, tick_us: float, rms_us: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sim://hover?pace=max&seed=7&camera_jitter_us=0{keys}"
    out = tmp_path / "times.csv"
    said = stamps(capsys, record(tmp_path, url), "--apply", str(out))
    table = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    error = np.abs(true_errors(url, table))
    assert said["stm32_tick_us"] == tick_us
    assert said["epochs"][0]["stm32_counts_84_of_85"] is ("divider" in keys)
    assert said["epochs"][0]["sure_of_84_of_85"]
    assert (error <= [float(row["bound_us"]) for row in table]).mean() >= 0.985
    assert np.sqrt(np.mean(error**2)) < rms_us


@pytest.mark.parametrize(
    ("keys", "mean_us", "rms_us"),
    [("", 20, 5), ("&gap8_quantum=1us", 20, 1.2), ("&camera_jitter_us=300&stm32_divider=84", 300, 14)],
)
def test_how_late_the_gap8_read_its_clock_is_found(
    keys: str, mean_us: float, rms_us: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The README has these figures of 60 s of sim://hover."""
    url = f"sim://hover?pace=max&seed=7{keys}"
    out = tmp_path / "times.csv"
    said = stamps(capsys, record(tmp_path, url, "20"), "--apply", str(out))
    table = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    error = np.abs(true_errors(url, table))
    bound = np.array([float(row["bound_us"]) for row in table])
    assert said["frames_paced"] >= len(table) - 1
    assert said["read_late_us"] == pytest.approx(mean_us, rel=0.25)
    assert np.sqrt(np.mean(error**2)) < rms_us
    assert (error <= bound).mean() >= 0.985
    assert said["bound_us_median"] < 3 * rms_us + 4


def test_bursts_keep_the_lateness_in_the_bound(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """No pace tells of it; the robot says how late its readings may be."""
    url = "sim://hover?pace=max&seed=7&camera_burst=3"
    out = tmp_path / "times.csv"
    said = stamps(capsys, record(tmp_path, url), "--apply", str(out))
    table = list(csv.DictReader(out.read_text(encoding="utf-8").splitlines()))
    error = np.abs(true_errors(url, table))
    assert (said["frames_paced"], said["read_late_us"]) == (0, None)
    assert (error <= [float(row["bound_us"]) for row in table]).mean() >= 0.985
    assert error.max() > 40


@pytest.mark.parametrize(("latency_us", "most_us"), [(0, 0), (400, 800)])
def test_what_echoes_say_stands_beside_what_is_unseen(
    latency_us: int, most_us: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    url = f"sim://hover?pace=max&seed=7&gap8_quantum=1us&uart1_jitter_us=0&uart1_latency_us={latency_us}"
    path = record(tmp_path, url, "5")
    said = stamps(capsys, path)
    with host.open(f"replay://{path}?pace=max") as stream:
        last = [frame for frame in stream if frame.native][-1].native.echo
    assert (said["minimum_delay_us"], said["minimum_delay_error_us"], said["echoes"]) == astuple(last)
    found_us = said["minimum_delay_us"] + said["minimum_delay_error_us"]
    assert found_us == pytest.approx(most_us, abs=8)
    assert f"beyond the wire (0 to {found_us} us, by {last.echoes} echoes)" in said["not_in_bound"]


def test_without_echoes_no_figure_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = stamps(capsys, record(tmp_path, "sim://hover?pace=max&firmware=nanocockpit", "5"))
    assert (said["minimum_delay_us"], said["minimum_delay_error_us"], said["echoes"]) == (None, None, 0)
    assert "beyond the wire;" in said["not_in_bound"]


def test_the_middle_of_a_row(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Rows are counted in the GAP8's time: of 45 ms of it the 84/85 clock makes half a millisecond less."""
    path = record(
        tmp_path, "sim://hover?pace=max&seed=7&stm32_divider=84&stm32_ppm=30&gap8_ppm=-170&camera_exposure_lines=400"
    )
    plain, out, copy = (str(tmp_path / name) for name in ("plain.csv", "row.csv", "row.mcap"))
    stamps(capsys, path, "--apply", plain)
    stamps(capsys, path, "--apply", out, "--row", "0")
    stamps(capsys, path, "--apply", copy, "--row", "0")
    table = list(csv.DictReader(Path(out).read_text(encoding="utf-8").splitlines()))
    without = [line.rsplit(",", 1)[0] for line in Path(out).read_text(encoding="utf-8").splitlines()]
    assert Path(plain).read_text(encoding="utf-8").splitlines() == without
    before = np.array([float(row["frame_stm32_us"]) - float(row["row_stm32_us"]) for row in table])
    rate = (1 + 30e-6) / (1 - 170e-6) * 84 / 85
    assert before == pytest.approx(443 * 125.333 * rate, abs=1)
    capsys.readouterr()
    with Path(copy).open("rb") as file:
        rows = [json.loads(each[2].data) for each in make_reader(file).iter_messages(topics=["/robot0/restamped"])]
    assert [str(each["row_stm32_us"]) for each in rows] == [row["row_stm32_us"] for row in table]
    assert main(["sync", "stamps", path, "--row", "0"]) == 2
    assert "--apply" in capsys.readouterr().err
    assert main(["sync", "stamps", path, "--apply", str(tmp_path / "x.csv"), "--row", "244"]) == 2
    assert not (tmp_path / "x.csv").exists()


def test_flags_are_drawn_over_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path, "sim://hover?pace=max&seed=7&reset_s=3&uart1_burst_per_s=0.3&uart1_burst_ms=1500", "8")
    with host.open(f"replay://{path}?pace=max") as stream:
        told = [frame.native.flag_names for frame in stream if frame.native]
    cold, lost, reset = (sum(name in names for names in told) for name in ("COLD", "HOLDOVER", "EPOCH_NEW"))
    assert min(cold, lost, reset) > 0
    said = stamps(capsys, path, "--plot", str(tmp_path / "a.svg"))
    assert said["own_flags"] == {"COLD": cold, "HOLDOVER": lost, "EPOCH_NEW": reset, "QUANTISED": len(told)}
    panel = (tmp_path / "a.svg").read_text(encoding="utf-8").split("red: refused<")[1]
    for name, frames in said["own_flags"].items():
        dots = panel.split(f">{name}<")[1].split("<text")[0]
        assert dots.count("h0") == frames, name
    other = str(tmp_path / "other.mcap")
    assert main(["stream", "--port", "sim://nanocockpit?pace=max", "--duration", "2", "--record", other]) == 0
    assert stamps(capsys, other, "--plot", str(tmp_path / "b.svg"))["own_flags"] == {}
    assert "flags" not in (tmp_path / "b.svg").read_text(encoding="utf-8")


def test_a_wrap_is_no_error_of_the_robots(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    url = "sim://hover?pace=max&seed=7&stm32_stamp_bits=32&stm32_stamp_start_us=4291000000"
    own = stamps(capsys, record(tmp_path, url, "10"))["own_error_us"]
    assert abs(own["median"]) < 100
    assert own["sd"] < 100
    assert abs(own["worst"]) < 1000


@pytest.mark.parametrize(("keys", "wraps"), [("", 1), ("&stm32_stamp_bits=32&stm32_stamp_start_us=4291000000", 2)])
def test_a_time_that_is_wrong_by_a_wrap_that_never_was_is_an_error(tmp_path: Path, keys: str, wraps: int) -> None:
    source = read(record(tmp_path, f"sim://hover?pace=max&seed=7{keys}", "5"), 0)
    source.own_stm32_us[20] += wraps * 2.0**32
    own = own_error(source, work_out(source))
    assert own["worst"] == pytest.approx(wraps * 2.0**32, abs=1000)
    assert abs(own["median"]) < 100


def test_other_firmware_says_what_cannot_be_repaired(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path, "sim://paper?pace=max&seed=7", "3")
    said = stamps(capsys, path, code=4)
    assert said["stamped"] == 0
    assert "cannot be worked out anew" in said["notes"][0]
    assert main(["sync", "stamps", path, "--apply", str(tmp_path / "x.csv")]) == 4
    assert not (tmp_path / "x.csv").exists()


def test_nanocockpit_is_repaired_to_its_tick(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = stamps(capsys, record(tmp_path, "sim://nanocockpit?pace=max&seed=7", "6"))
    assert said["stm32_tick_us"] == 1000
    assert said["stamped"] > 300
    assert 500 < said["bound_us_median"] < 2000


@pytest.mark.parametrize("out", ["times.txt", "times", "times.svg", "times.CSV.gz"])
def test_another_ending_is_no_csv_by_another_name(tmp_path: Path, capsys: pytest.CaptureFixture[str], out: str) -> None:
    assert main(["sync", "stamps", str(tmp_path / "none.mcap"), "--apply", str(tmp_path / out)]) == 2
    assert capsys.readouterr().err.endswith(f"{out}: its ending chooses the format: .csv, .mcap\n")


def test_nothing_is_overwritten(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = record(tmp_path, "sim://hover?pace=max&seed=7", "3")
    out = tmp_path / "times.csv"
    out.write_text("mine", encoding="utf-8")
    assert main(["sync", "stamps", path, "--apply", str(out)]) == 2
    assert out.read_text(encoding="utf-8") == "mine"
    assert main(["sync", "stamps", path, "--plot", str(tmp_path / "x.gif")]) == 2
    assert ".svg, .png" in capsys.readouterr().err
    assert main(["sync", "stamps", path, "--apply", str(tmp_path / "new.csv"), "--plot", str(tmp_path / "x.gif")]) == 2
    picture = tmp_path / "x.svg"
    picture.touch()
    assert main(["sync", "stamps", path, "--apply", str(tmp_path / "new.csv"), "--plot", str(picture)]) == 2
    assert sorted(each.name for each in tmp_path.iterdir()) == ["flight.mcap", "times.csv", "x.svg"]
    assert main(["sync", "stamps", str(out)]) == 2
    assert main(["sync", "stamps", path, "--robot", "3"]) == 2
