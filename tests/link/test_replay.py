"""A replay gives the bytes that were recorded, read for read, with their times."""

import json
import random
import socket
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from mcap.writer import CompressionType, Writer
from recordings import FakePort, Tee, read, record, record_reads, summary

import host
from host.cli import main
from host.link import recording
from host.link.ports import open_port
from host.link.recover import recover
from host.link.replay_server import ReplayServer
from host.link.replay_url import from_url, to_url
from host.link.serial import protocol_replay
from host.protocol.errors import LocalError

WIRES = [
    "sim://hover?pace=max&seed=21",
    "sim://stock?pace=max&seed=22",
    "sim://hover?pace=max&seed=23&wire=uart2",
    "sim://hover?pace=max&seed=24&wire=uart1",
]


@pytest.fixture(scope="module")
def four(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[Tee]]:
    path = tmp_path_factory.mktemp("replay") / "four.mcap"
    return path, record(path, *WIRES)


def play(url: str, most: int | None = None) -> list[tuple[int, bytes]]:
    """The reads of a port, until its end or so many bytes."""
    port = open_port(url)
    found: list[tuple[int, bytes]] = []
    size = 0
    try:
        while most is None or size < most:
            data = port.read(1000)
            if data is not None:
                if not len(data):
                    assert port.ended == ""
                    break
                found.append((port.clock_ns(), bytes(data)))
                size += len(data)
    finally:
        port.close()
    return found


def told(events: list[Any]) -> list[Any]:
    """Events as values that compare."""
    return [recording.foxglove.as_json(each) + getattr(each, "body", b"")[:].tobytes()
            if hasattr(each, "body") else each for each in events]  # fmt: skip


@pytest.mark.parametrize("robot", range(4))
def test_every_read_comes_again_at_its_time(four: tuple[Path, list[Tee]], robot: int) -> None:
    path, tees = four
    assert play(to_url(str(path), pace="max", robot=robot)) == tees[robot].reads


@pytest.mark.parametrize("robot", range(4))
def test_a_session_sees_the_same_events(four: tuple[Path, list[Tee]], robot: int) -> None:
    path, tees = four
    with host.open(to_url(str(path), pace="max", robot=robot)) as stream:
        events = list(stream.events())
    original = tees[robot].events
    assert len(original) >= 5
    assert told(events[: len(original)]) == told(original)
    assert stream.port.framing == ["tcp", "tcp", "cpx-uart", "stamps"][robot]


@pytest.mark.parametrize("seed", range(20))
def test_reads_of_any_size(tmp_path: Path, seed: int) -> None:
    """Single bytes, several at one time, long silences."""
    dice = random.Random(seed)
    reads, now_ns = [], dice.randrange(10**12)
    for _ in range(dice.randrange(1, 60)):
        reads.append((now_ns, dice.randbytes(dice.choice([1, 1, 2, 300, 70_000]))))
        now_ns += dice.choice([0, 0, 1, 10**6, 10**8, 3 * 10**9])
    record_reads(tmp_path / "any.mcap", reads)
    assert play(to_url(str(tmp_path / "any.mcap"), pace="max")) == reads


def test_a_recovered_recording_plays_what_is_in_it(four: tuple[Path, list[Tee]], tmp_path: Path) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(recording, "CHUNK_BYTES", 50_000)
        (tee,) = record(tmp_path / "flight.mcap", WIRES[0], frames=10)
    data = (tmp_path / "flight.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    recover(str(tmp_path / "cut.mcap"), str(tmp_path / "out.mcap"))
    reads = play(to_url(str(tmp_path / "out.mcap"), pace="max"))
    assert reads == tee.reads[: len(reads)]
    assert len(reads) > len(tee.reads) // 3


def test_recorded_again_it_is_the_same(four: tuple[Path, list[Tee]], tmp_path: Path) -> None:
    (again,) = record(tmp_path / "again.mcap", to_url(str(four[0]), pace="max", robot=0))
    assert again.reads == four[1][0].reads
    a, b = ([(m.log_time, m.publish_time, m.data) for _, m, _ in read(path, "/robot0/image", "/robot0/frame")]
            for path in (four[0], tmp_path / "again.mcap"))  # fmt: skip
    assert a == b


def test_dates_and_dialect_of_a_recording_are_kept(tmp_path: Path) -> None:
    recorder = recording.Recorder(str(tmp_path / "real.mcap"))
    track = recorder.track(0, FakePort(), "native")
    track.received(b"abc", 5000)
    recorder.close()
    port = open_port(to_url(str(tmp_path / "real.mcap"), pace="max"))
    assert port.epoch_ns == track.epoch_ns > 10**18
    assert port.dialect == "native"
    port.close()


def test_start(four: tuple[Path, list[Tee]]) -> None:
    reads = four[1][0].reads
    from_ns = reads[0][0] + 250_000_000
    expected = [each for each in reads if each[0] >= from_ns]
    assert 0 < len(expected) < len(reads)
    assert play(to_url(str(four[0]), pace="max", start=0.25)) == expected


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_rate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: float) -> None:
    """On a clock of the test's own."""
    now_s = [1000.0]

    def sleep(seconds: float) -> None:
        now_s[0] += seconds

    monkeypatch.setattr(protocol_replay.time, "monotonic", lambda: now_s[0])
    monkeypatch.setattr(protocol_replay.time, "sleep", sleep)
    reads = [(5 * 10**9 + index * 10**9, bytes([index])) for index in range(5)]
    record_reads(tmp_path / "rate.mcap", reads)
    port = open_port(to_url(str(tmp_path / "rate.mcap"), rate=rate))
    came = []
    while (data := port.read(1000)) is None or len(data):
        if data is not None:
            came.append((now_s[0], port.clock_ns(), bytes(data)))
    assert [(at, data) for _, at, data in came] == reads
    assert [wall - 1000 for wall, _, _ in came] == pytest.approx([index / rate for index in range(5)], abs=1e-6)


def serve(url: str, told: list[dict[str, Any]]) -> ReplayServer:
    server = ReplayServer(url, ("127.0.0.1", 0), told.append)
    server.start()
    return server


def connect(server: ReplayServer) -> socket.socket:
    host_, _, port = server.address.rpartition(":")
    return socket.create_connection((host_, int(port)), timeout=60)


def receive_all(client: socket.socket) -> bytes:
    received = b""
    while data := client.recv(1 << 16):
        received += data
    return received


def test_served_bytes_are_the_recorded_ones(four: tuple[Path, list[Tee]]) -> None:
    events: list[dict[str, Any]] = []
    server = serve(to_url(str(four[0]), pace="max", robot=0), events)
    with connect(server) as client:
        client.sendall(b"nobody listens to this" * 1000)
        received = receive_all(client)
    expected = b"".join(data for _, data in four[1][0].reads)
    assert received == expected
    assert server.wait(60)
    server.close()
    assert [each["event"] for each in events] == ["listening", "connected", "ended"]
    assert events[-1]["bytes"] == len(expected)


def test_a_client_that_leaves_does_not_end_the_replay(four: tuple[Path, list[Tee]]) -> None:
    events: list[dict[str, Any]] = []
    server = serve(to_url(str(four[0]), rate=20, robot=0), events)
    with connect(server) as client:
        assert client.recv(1000)
    with connect(server) as client:
        received = receive_all(client)
    assert received == b"".join(data for _, data in four[1][0].reads)
    assert server.wait(60)
    server.close()
    assert len(events) == 5


def test_a_server_is_closed_while_it_plays(four: tuple[Path, list[Tee]]) -> None:
    server = serve(to_url(str(four[0]), rate=0.01, robot=0), [])
    with connect(server) as client:
        assert client.recv(1)
        closing = threading.Thread(target=server.close)
        closing.start()
        closing.join(60)
        assert not closing.is_alive()


def mcap_with(path: Path, *messages: bytes, topic: str = "/robot0/received", metadata: dict[str, str] | None = None,
              schema: str = "spindeck.Bytes", compression: CompressionType = CompressionType.NONE) -> None:  # fmt: skip
    """By the package's own writer: schemas and channels inside the chunks."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        number = writer.register_schema(schema, "protobuf", recording.foxglove.PROTOBUF_SCHEMAS["spindeck.Bytes"])
        channel = writer.register_channel(topic, "protobuf", number, metadata or {})
        for index, data in enumerate(messages):
            writer.add_message(channel, index, b"".join(recording.foxglove.raw(data)), index)
        writer.finish()


OURS = {"robot": "0", "framing": "tcp", "epoch_ns": "0"}


@pytest.mark.parametrize("compression", list(CompressionType))
def test_files_that_went_through_other_tools(tmp_path: Path, compression: CompressionType) -> None:
    mcap_with(tmp_path / "x.mcap", b"abc", b"de", metadata=OURS, compression=compression)
    assert play(to_url(str(tmp_path / "x.mcap"), pace="max")) == [(0, b"abc"), (1, b"de")]
    recover(str(tmp_path / "x.mcap"), str(tmp_path / "y.mcap"))
    assert play(to_url(str(tmp_path / "y.mcap"), pace="max")) == [(0, b"abc"), (1, b"de")]
    assert summary(tmp_path / "y.mcap").statistics.message_count == 2


def empty(path: Path) -> None:
    path.write_bytes(b"")


def picture(path: Path) -> None:
    path.write_bytes(b"P5\n2 2\n255\n1234")


def cut(path: Path) -> None:
    record_reads(path, [(1, b"abc")])
    path.write_bytes(path.read_bytes()[:-9])


def without_raw(path: Path) -> None:
    record(path, WIRES[0], frames=1, without="raw")


def of_others(path: Path) -> None:
    mcap_with(path, b"abc", topic="/camera", schema="foxglove.RawImage")


def no_metadata(path: Path) -> None:
    mcap_with(path, b"abc")


def other_framing(path: Path) -> None:
    mcap_with(path, b"abc", metadata={**OURS, "framing": "smoke"})


def no_messages(path: Path) -> None:
    mcap_with(path, metadata=OURS)


def flipped(path: Path) -> None:
    record_reads(path, [(1, bytes(1000))])
    data = bytearray(path.read_bytes())
    data[summary(path).chunk_indexes[0].chunk_start_offset + 500] ^= 1
    path.write_bytes(data)


def folder(path: Path) -> None:
    path.mkdir()


def nothing(path: Path) -> None:
    pass


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (empty, "empty"),
        (picture, "not an MCAP file"),
        (cut, "host recover"),
        (without_raw, "no robot's bytes"),
        (of_others, "no robot's bytes"),
        (no_metadata, "metadata"),
        (other_framing, "smoke"),
        (no_messages, "sent nothing"),
        (flipped, "check fails"),
        (folder, "directory"),
        (nothing, "No such file"),
    ],
)
@pytest.mark.parametrize("command", ["replay", "stream"])
def test_wrong_files_are_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Any, says: str, command: str
) -> None:
    path = tmp_path / "flight.mcap"
    make(path)
    words = [str(path), "--listen", "127.0.0.1:0"] if command == "replay" else ["--port", f"replay://{path}?pace=max"]
    assert main([command, *words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert says in line
    assert "flight.mcap" in line


@pytest.mark.parametrize(
    ("query", "says"),
    [
        ("rat=1", "rate, loop, start"), ("rate=0", "0.001"), ("rate=fast", "number"), ("rate=nan", "number"),
        ("loop=yes", "0 or 1"), ("start=-1", "seconds"), ("start=1000", "ends after"), ("robot=7", "only 0, 1, 2, 3"),
        ("robot=x", "robot"), ("rate=1_0", "number"), ("robot=\uff11", "robot"), ("pace=slow", "real or max"),
    ],
)  # fmt: skip
def test_wrong_urls(four: tuple[Path, list[Tee]], query: str, says: str) -> None:
    with pytest.raises(LocalError, match=says):
        open_port(f"replay://{four[0]}?{query}")


def test_an_address_that_is_none(four: tuple[Path, list[Tee]], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", str(four[0]), "--listen", "nowhere.invalid:5000"]) == 2
    assert "there is no such address" in capsys.readouterr().err


def test_urls_there_and_back() -> None:
    choice = from_url(to_url("/a b/ü?&.mcap", rate=2.5, loop=1, start=3, robot=4, pace="max"))
    assert (choice.path, choice.rate, choice.loop, choice.start, choice.robot, choice.pace) == (
        "/a b/ü?&.mcap", 2.5, True, 3.0, 4, "max",
    )  # fmt: skip
    assert from_url("replay://x.mcap").robot is None
    with pytest.raises(LocalError, match="replay://FILE"):
        from_url("replay://?rate=2")


def test_two_robots_are_served_on_two_ports(four: tuple[Path, list[Tee]], capsys: pytest.CaptureFixture[str]) -> None:
    busy = socket.create_server(("127.0.0.1", 0))
    port = busy.getsockname()[1]
    assert main(["replay", str(four[0]), "--listen", f"127.0.0.1:{port}", "--robot", "0"]) == 2
    assert capsys.readouterr().err == (
        f"host: --listen 127.0.0.1:{port}: port {port} is in use: another simulator, or another program; "
        "name another port, or 0 for any\n"
    )
    busy.close()
    running = threading.Thread(target=main, args=(["replay", str(four[0]), "--listen", "127.0.0.1:0", "--rate", "50"],))
    running.start()
    lines: list[dict[str, Any]] = []
    while len(lines) < 4:
        time.sleep(0.01)
        lines += [json.loads(line) for line in capsys.readouterr().out.splitlines() if line]
    for each in lines[:4]:
        with socket.create_connection(("127.0.0.1", int(each["port"].rpartition(":")[2])), timeout=60) as client:
            assert receive_all(client) == b"".join(data for _, data in four[1][each["robot"]].reads)
    running.join(60)
    assert not running.is_alive()
