"""A recording that ends anywhere is made whole, with every message of every complete chunk.

SPINDECK_KILLS=200 kills that many recording processes instead of a few.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from recordings import in_complete_chunks, read, record, summary

from host.cli import main
from host.link import recording
from host.link.frame import Frame
from host.link.mcap import MAGIC, encode_header
from host.link.recover import recover
from host.protocol.errors import LocalError

ROOT = Path(__file__).resolve().parents[2]
KILLS = int(os.environ.get("SPINDECK_KILLS", "6"))
CUTS = 200
URL = "sim://hover?pace=max&seed=11&camera_width=64&camera_height=48&camera_exposure_lines=40&camera_fps=60"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Frame]]:
    """Some frames in many chunks."""
    path = tmp_path_factory.mktemp("recover") / "whole.mcap"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "CHUNK_BYTES", 20_000)
        (tee,) = record(path, URL, frames=60)
    return path, [event for event in tee.events if isinstance(event, Frame)]


def recovered(source: Path, target: Path, something: bool) -> bool:
    """Nothing to be saved is an error, and leaves no file."""
    with contextlib.nullcontext() if something else pytest.raises(LocalError, match="nothing can be recovered"):
        recover(str(source), str(target))
    assert target.exists() == something
    return something


def check(cut: Path, frames: list[Frame]) -> int:
    """Recovers, compares with what the independent reader finds from the start; the number of frames."""
    before = cut.read_bytes()
    target = cut.with_suffix(".whole")
    with cut.open("rb") as file:
        expected = in_complete_chunks(file)
    if not recovered(cut, target, bool(expected)):
        return 0
    assert cut.read_bytes() == before
    messages = [message for _, message, _ in read(target)]
    assert [(m.channel_id, m.sequence, m.log_time, m.data) for m in messages] == expected
    assert summary(target).statistics.message_count == len(expected)
    pictures = [decoded.data for _, _, decoded in read(target, "/robot0/image")]
    assert pictures == [frame.body.tobytes() for frame in frames[: len(pictures)]]
    target.unlink()
    return len(pictures)


@pytest.mark.parametrize("seed", range(CUTS))
def test_cut_at_a_random_byte(whole: tuple[Path, list[Frame]], tmp_path: Path, seed: int) -> None:
    path, frames = whole
    data = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: random.Random(seed).randrange(8, len(data))])
    check(tmp_path / "cut.mcap", frames)


def test_cut_around_every_end_of_a_record(whole: tuple[Path, list[Frame]], tmp_path: Path) -> None:
    """One byte less than a chunk loses that chunk; its last byte keeps it, whatever comes after."""
    path, frames = whole
    data = path.read_bytes()
    counts = []
    chunks = summary(path).chunk_indexes
    assert len(chunks) > 10
    for chunk in chunks:
        end = chunk.chunk_start_offset + chunk.chunk_length
        for cut in (end - 1, end, end + 1):
            (tmp_path / "cut.mcap").write_bytes(data[:cut])
            counts.append(check(tmp_path / "cut.mcap", frames))
    assert counts == sorted(counts)
    assert counts[-1] == len(frames)
    assert len(set(counts)) > 10


def test_a_whole_file_stays_as_it_is(whole: tuple[Path, list[Frame]], tmp_path: Path) -> None:
    found = recover(str(whole[0]), str(tmp_path / "again.mcap"))
    assert (tmp_path / "again.mcap").read_bytes() == whole[0].read_bytes()
    assert found.has_end
    assert not found.damage


def test_a_damaged_chunk_costs_itself(whole: tuple[Path, list[Frame]], tmp_path: Path) -> None:
    data = bytearray(whole[0].read_bytes())
    chunk = summary(whole[0]).chunk_indexes[3]
    data[chunk.chunk_start_offset + 200] ^= 1
    (tmp_path / "flipped.mcap").write_bytes(data)
    found = recover(str(tmp_path / "flipped.mcap"), str(tmp_path / "out.mcap"))
    ((offset, size),) = [(each.offset, each.size) for each in found.damage]
    assert (offset, size) == (chunk.chunk_start_offset, chunk.chunk_length)
    lost = {(m.channel_id, m.sequence) for _, m, _ in read(whole[0])} - {
        (m.channel_id, m.sequence) for _, m, _ in read(tmp_path / "out.mcap")
    }
    assert 0 < len(lost) < 300


@pytest.mark.parametrize("seed", range(100))
def test_any_flipped_bit_is_survived(whole: tuple[Path, list[Frame]], tmp_path: Path, seed: int) -> None:
    """Whatever is damaged: a readable file, and no message that was not there."""
    dice = random.Random(seed)
    data = bytearray(whole[0].read_bytes())
    for _ in range(dice.choice([1, 1, 5])):
        data[dice.randrange(8, len(data))] ^= 1 << dice.randrange(8)
    (tmp_path / "flipped.mcap").write_bytes(data)
    recover(str(tmp_path / "flipped.mcap"), str(tmp_path / "out.mcap"))
    kept = {(m.channel_id, m.sequence, m.data) for _, m, _ in raw_messages(tmp_path / "out.mcap")}
    assert kept <= {(m.channel_id, m.sequence, m.data) for _, m, _ in raw_messages(whole[0])}


def raw_messages(path: Path) -> list[tuple[Any, Any, Any]]:
    from mcap.reader import make_reader

    with path.open("rb") as file:
        return [(s, m, c) for s, c, m in make_reader(file, validate_crcs=True).iter_messages(log_time_order=False)]


def test_zeros_at_the_end_as_a_power_cut_leaves_them(whole: tuple[Path, list[Frame]], tmp_path: Path) -> None:
    data = whole[0].read_bytes()
    end = summary(whole[0]).chunk_indexes[5].chunk_start_offset
    (tmp_path / "zeros.mcap").write_bytes(data[:end] + bytes(50_000))
    found = recover(str(tmp_path / "zeros.mcap"), str(tmp_path / "out.mcap"))
    assert [(each.offset, each.size) for each in found.damage] == [(end, 50_000)]
    assert found.chunks == 5


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "empty"),
        (b"\x89MCAP", "cut off after 5 bytes"),
        (b"P5\n324 244\n255\n", "not an MCAP file"),
        (None, "No such file"),
        (MAGIC + encode_header("x"), "cut off before the first message"),
        (MAGIC + encode_header("x")[:-1], "no message is whole (from byte 8 on"),
        (MAGIC + bytes(5000), "no message is whole (from byte 8 on"),
    ],
)
def test_what_cannot_be_recovered_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], content: bytes | None, says: str
) -> None:
    if content is not None:
        (tmp_path / "x.mcap").write_bytes(content)
    assert main(["recover", str(tmp_path / "x.mcap")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert not (tmp_path / "x.recovered.mcap").exists()


def test_a_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in (str(tmp_path), "."):
        assert main(["recover", folder]) == 2
        assert "a folder: name one recording in it" in capsys.readouterr().err


def test_a_whole_recording_of_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recording.Recorder(str(tmp_path / "x.mcap")).close()
    assert main(["recover", str(tmp_path / "x.mcap")]) == 2
    assert "it is whole, and no message is in it" in capsys.readouterr().err
    assert not (tmp_path / "x.recovered.mcap").exists()


def test_nothing_is_overwritten(whole: tuple[Path, list[Frame]], tmp_path: Path) -> None:
    (tmp_path / "there").write_bytes(b"mine")
    with pytest.raises(LocalError, match="ever overwritten"):
        recover(str(whole[0]), str(tmp_path / "there"))
    assert (tmp_path / "there").read_bytes() == b"mine"
    with pytest.raises(LocalError, match="ever overwritten"):
        recover(str(whole[0]), str(whole[0]))


def test_the_command_says_what_was_lost(
    whole: tuple[Path, list[Frame]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = whole[0].read_bytes()
    chunk = summary(whole[0]).chunk_indexes[4]
    (tmp_path / "flight.mcap").write_bytes(data[: chunk.chunk_start_offset + 100])
    assert main(["recover", str(tmp_path / "flight.mcap")]) == 0
    said = capsys.readouterr().out
    assert f"lost        100 bytes from byte {chunk.chunk_start_offset} on" in said
    assert "in 4 chunks" in said
    assert (tmp_path / "flight.recovered.mcap").is_file()


@pytest.mark.parametrize("seed", range(KILLS))
def test_killed_while_recording(tmp_path: Path, seed: int) -> None:
    """SIGKILL at a random time; then every frame that is in a complete chunk is there, and is the right one."""
    path = tmp_path / "killed.mcap"
    url = "sim://hover?pace=max&seed=11&camera_encoding=jpeg"
    words = ["stream", "--port", url, "--record", str(path)]
    process = subprocess.Popen(
        [sys.executable, "-m", "host", *words], cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    try:
        while not (path.exists() and path.stat().st_size) and process.poll() is None:
            time.sleep(0.01)
        time.sleep(random.Random(seed).uniform(0, 1.2))
    finally:
        process.send_signal(signal.SIGKILL)
        _, stderr = process.communicate()
    assert process.returncode == -signal.SIGKILL, stderr.decode()
    target = tmp_path / "recovered.mcap"
    with path.open("rb") as file:
        expected = in_complete_chunks(file)
    if not recovered(path, target, bool(expected)):
        return
    rows = read(target)
    assert [(m.channel_id, m.sequence, m.log_time, m.data) for _, m, _ in rows] == expected
    pictures = [decoded.data for topic, _, decoded in rows if topic == "/robot0/compressed_image"]
    told = [decoded for topic, _, decoded in rows if topic == "/robot0/frame"]
    assert [each["index"] for each in told] == list(range(len(told)))
    assert len(told) - len(pictures) in (0, 1)
    assert all(picture[:2] == b"\xff\xd8" and picture[-2:] == b"\xff\xd9" for picture in pictures)
