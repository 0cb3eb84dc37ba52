"""Recordings, read back with the independent mcap and protobuf packages."""

import json
import random
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from recordings import FakePort, Tee, in_complete_chunks, read, record, summary

from host.link import recording
from host.link.foxglove import PROTOBUF_SCHEMAS, image
from host.link.frame import Frame, LostFrame
from host.link.records import Stamp
from host.protocol.errors import LocalError


@pytest.fixture(scope="module")
def hover(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tee]:
    path = tmp_path_factory.mktemp("recording") / "hover.mcap"
    return path, record(path, "sim://hover?pace=max&seed=5")[0]


def test_bytes_of_both_directions_with_their_times(hover: tuple[Path, Tee]) -> None:
    path, tee = hover
    for topic, expected in (("received", tee.reads), ("sent", tee.writes)):
        rows = read(path, f"/robot0/{topic}")
        assert [(message.publish_time, decoded.data) for _, message, decoded in rows] == expected
        assert len(expected) > 0
        assert [message.sequence for _, message, _ in rows] == list(range(len(rows)))


def test_pixels_and_times_of_images(hover: tuple[Path, Tee]) -> None:
    path, tee = hover
    frames = [event for event in tee.events if isinstance(event, Frame)]
    rows = read(path, "/robot0/image")
    assert len(rows) == len(frames) == 5
    for frame, (_, message, told) in zip(frames, rows, strict=True):
        pixels = np.frombuffer(told.data, np.uint8).reshape(told.height, told.step)[:, : told.width]
        assert np.array_equal(pixels, frame.pixels)
        assert told.encoding == "mono8"
        assert told.frame_id == "robot0"
        assert told.timestamp.seconds * 10**9 + told.timestamp.nanos == frame.arrival_host_ns == message.log_time


def test_times_and_pairs_of_frames(hover: tuple[Path, Tee]) -> None:
    path, tee = hover
    frames = [event for event in tee.events if isinstance(event, Frame)]
    assert sum(len(frame.pairs) for frame in frames if frame.pairs is not None) > 20
    for frame, (_, _, told) in zip(frames, read(path, "/robot0/frame"), strict=True):
        assert told["index"] == frame.index
        assert told["arrival_host_ns"] == frame.arrival_host_ns
        assert "body" not in told
        if frame.native is None:
            assert "native" not in told
            continue
        assert told["native"]["frame_gap8_us"] == frame.native.frame_gap8_us
        assert told["native"].get("frame_stm32_us") == frame.native.frame_stm32_us
        assert told["native"]["counters"] == frame.native.counters
        assert [tuple(pair.values()) for pair in told["pairs"]] == frame.pairs.tolist()


def test_schemas_and_metadata(hover: tuple[Path, Tee]) -> None:
    found = summary(hover[0])
    schemas = {channel.topic: found.schemas[channel.schema_id] for channel in found.channels.values()}
    assert {topic: (schema.name, schema.encoding) for topic, schema in schemas.items()} == {
        "/robot0/received": ("spindeck.Bytes", "protobuf"),
        "/robot0/sent": ("spindeck.Bytes", "protobuf"),
        "/robot0/image": ("foxglove.RawImage", "protobuf"),
        "/robot0/frame": ("spindeck.Frame", "jsonschema"),
        "/robot0/log_status": ("spindeck.LogStatus", "jsonschema"),
    }
    for channel in found.channels.values():
        metadata = {**channel.metadata}
        assert metadata.pop("version")
        assert metadata == {
            "robot": "0", "port": "sim://hover?pace=max&seed=5", "framing": "tcp", "dialect": "auto",
            "clock": "simulated", "epoch_ns": "0", "scenario": "hover", "seed": "5",
        }  # fmt: skip
    described = json.loads(schemas["/robot0/log_status"].data)["properties"]
    said = [told for _, _, told in read(hover[0], "/robot0/log_status")]
    assert [(told["state"], told["files"]) for told in said] == [("no_card", 0)] * len(said)
    assert said
    assert all(set(told) == set(described) for told in said)
    described = json.loads(schemas["/robot0/frame"].data)["properties"]
    for _, _, told in read(hover[0], "/robot0/frame"):
        assert set(told) <= set(described)
        assert set(told.get("native", {})) <= set(described["native"]["properties"])


def test_schemas_are_foxgloves_own(hover: tuple[Path, Tee]) -> None:
    """Field for field, against Foxglove's package."""

    for real in (RawImage, CompressedImage):
        ours = FileDescriptorSet.FromString(PROTOBUF_SCHEMAS[real.DESCRIPTOR.full_name]).file[-1]
        theirs = FileDescriptorProto()
        real.DESCRIPTOR.file.CopyToProto(theirs)
        for file in (ours, theirs):
            file.message_type[0].field.sort(key=lambda field: field.number)
        assert ours == theirs


@pytest.mark.parametrize("seed", range(20))
def test_images_as_the_real_protobuf_reads_them(seed: int) -> None:

    random_ = random.Random(seed)
    width, height, depth = random_.randrange(1, 400), random_.randrange(1, 300), random_.choice([1, 2, 3])
    body = np.frombuffer(random_.randbytes(width * height * depth), np.uint8)
    time_ns = random_.choice([0, 1, 999_999_999, 10**9, 1_780_000_000_123_456_789, 2**63 - 1])
    raw = RawImage.FromString(b"".join(image(Frame(0, 0, width, height, depth, "raw", body), time_ns, "robot3")))
    assert (raw.width, raw.height, raw.step, raw.data) == (width, height, width * depth, body.tobytes())
    assert raw.encoding == {1: "mono8", 2: "8UC2", 3: "rgb8"}[depth]
    jpeg = CompressedImage.FromString(b"".join(image(Frame(0, 0, 1, 1, 1, "jpeg", body), time_ns, "robot3")))
    assert (jpeg.format, jpeg.data, jpeg.frame_id) == ("jpeg", body.tobytes(), "robot3")
    for each in (raw, jpeg):
        assert each.timestamp.seconds * 10**9 + each.timestamp.nanos == time_ns


def test_jpeg(tmp_path: Path) -> None:
    tee = record(tmp_path / "jpeg.mcap", "sim://hover?pace=max&camera_encoding=jpeg")[0]
    frames = [event for event in tee.events if isinstance(event, Frame)]
    rows = read(tmp_path / "jpeg.mcap", "/robot0/compressed_image")
    assert [image.data for _, _, image in rows] == [frame.body.tobytes() for frame in frames]
    assert {image.format for _, _, image in rows} == {"jpeg"}


def test_several_robots_in_one_file(tmp_path: Path) -> None:
    urls = ["sim://hover?pace=max&seed=1", "sim://stock?pace=max&seed=2", "sim://hover?pace=max&wire=uart1"]
    tees = record(tmp_path / "three.mcap", *urls)
    found = summary(tmp_path / "three.mcap")
    assert {channel.metadata["port"] for channel in found.channels.values()} == set(urls)
    for number, tee in enumerate(tees):
        rows = read(tmp_path / "three.mcap", f"/robot{number}/received")
        assert [(message.publish_time, each.data) for _, message, each in rows] == tee.reads
    stamps = [event for event in tees[2].events if isinstance(event, Stamp)]
    told = [each for _, _, each in read(tmp_path / "three.mcap", "/robot2/stamp")]
    assert told == [
        {"arrival_host_ns": s.arrival_host_ns, "sequence": s.sequence, "stm32_us": s.stm32_us, "epoch": s.epoch}
        for s in stamps
    ]


@pytest.mark.parametrize(("part", "topics"), [("images", {"image"}), ("raw", {"received", "sent"})])
def test_a_part_left_out(tmp_path: Path, part: recording.Part, topics: set[str]) -> None:
    record(tmp_path / "part.mcap", "sim://hover?pace=max", without=part)
    found = {channel.topic.rpartition("/")[2] for channel in summary(tmp_path / "part.mcap").channels.values()}
    assert found == {"received", "sent", "image", "frame", "log_status"} - topics


def test_same_seed_same_messages(tmp_path: Path) -> None:
    for name in "ab":
        record(tmp_path / name, "sim://hover?pace=max&seed=9")
    a, b = ([(t, m.log_time, m.data) for t, m, _ in read(tmp_path / name)] for name in "ab")
    assert a == b


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "there.mcap").write_bytes(b"mine")
    with pytest.raises(LocalError, match="ever overwritten"):
        recording.Recorder(str(tmp_path / "there.mcap"))
    assert (tmp_path / "there.mcap").read_bytes() == b"mine"
    with pytest.raises(LocalError, match="No such file"):
        recording.Recorder(str(tmp_path / "no" / "such.mcap"))


def frame(index: int) -> Frame:
    return Frame(index, 2000 + index, 10, 10, 1, "raw", np.full(100, index, np.uint8))


def test_a_real_ports_times_become_dates(tmp_path: Path) -> None:
    recorder = recording.Recorder(str(tmp_path / "dated.mcap"))
    recorder.track(0, FakePort(), "auto").event(frame(0))
    recorder.close()
    ((_, image, _),) = read(tmp_path / "dated.mcap", "/robot0/image")
    assert image.publish_time == 2000
    assert image.log_time > 1_700_000_000 * 10**9
    (channel, *_) = summary(tmp_path / "dated.mcap").channels.values()
    assert image.log_time == 2000 + int(channel.metadata["epoch_ns"])


def test_each_chunk_is_on_the_disk_before_the_next_begins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What has come is in the file, whole, after at most one turn of the writer."""
    synced = threading.Semaphore(0)
    monkeypatch.setattr(recording.os, "fdatasync", lambda number: synced.release(), raising=False)
    recorder = recording.Recorder(str(tmp_path / "live.mcap"))
    track = recorder.track(0, FakePort(), "auto")
    for index in range(3):
        track.event(frame(index))
        assert synced.acquire(timeout=60)
        with (tmp_path / "live.mcap").open("rb") as file:
            assert len(in_complete_chunks(file)) == 2 * (index + 1)
    recorder.close()
    assert recording.FLUSH_S <= 0.25


def test_a_disk_that_is_too_slow_is_told_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    writing, go_on = threading.Event(), threading.Event()

    def slow(number: int) -> None:
        writing.set()
        assert go_on.wait(60)

    monkeypatch.setattr(recording.os, "fdatasync", slow, raising=False)
    monkeypatch.setattr(recording, "QUEUE_BYTES", 2000)
    recorder = recording.Recorder(str(tmp_path / "slow.mcap"))
    track = recorder.track(0, FakePort(), "auto")
    track.received(b"first", 1)
    assert writing.wait(60)
    for index in range(10):  # 300 bytes each with what they cost
        track.event(frame(index))
    track.received(b"x" * 1000, 5000)
    go_on.set()
    while track.missing_now is not None:
        track.received(b"", 6000)
    recorder.close()
    kept = [told["index"] for _, _, told in read(tmp_path / "slow.mcap", "/robot0/frame")]
    assert kept == list(range(len(kept)))
    assert 0 < len(kept) < 10
    ((_, _, missing),) = read(tmp_path / "slow.mcap", "/robot0/missing")
    assert missing["frames"] == 10 - len(kept)
    assert missing["received_bytes"] == 1000
    assert missing["first_host_ns"] == 2000 + len(kept)
    assert track.summary()["missing"]["frames"] == 10 - len(kept)


def test_a_full_disk_ends_the_run_and_keeps_what_was_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced = threading.Semaphore(0)
    monkeypatch.setattr(recording.os, "fdatasync", lambda number: synced.release(), raising=False)
    recorder = recording.Recorder(str(tmp_path / "full.mcap"))
    track = recorder.track(0, FakePort(), "auto")
    track.event(frame(0))
    assert synced.acquire(timeout=60)
    real = recorder._file

    class Full:
        def write(self, data: Any) -> int:
            if len(data) < 100:
                raise OSError(28, "No space left on device")
            return real.write(data[: len(data) // 2])

        def close(self) -> None:
            real.close()

    recorder._file = Full()  # type: ignore[assignment]
    track.event(frame(1))
    recorder._thread.join(60)
    with pytest.raises(LocalError, match="No space left"):
        track.event(frame(2))
    with pytest.raises(LocalError, match="No space left"):
        recorder.close()
    assert [told["index"] for _, _, told in read(tmp_path / "full.mcap", "/robot0/frame")] == [0]


def test_lost_frames_are_told(tmp_path: Path) -> None:
    tee = record(tmp_path / "lossy.mcap", "sim://lossy?pace=max&seed=3", frames=25)[0]
    lost = [event for event in tee.events if isinstance(event, LostFrame)]
    told = [each["cause"] for _, _, each in read(tmp_path / "lossy.mcap", "/robot0/lost_frame")]
    assert told == [event.cause for event in lost]
