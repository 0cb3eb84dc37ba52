"""Where the bytes of a replay do not continue those before: a connection that was made again, a round of a loop."""

import contextlib
from pathlib import Path

import pytest
from made_streams import native, pixels, stock
from recordings import FakePort, read, record, record_reads

import host
from host.cli import main
from host.link import recording
from host.link import stream as stream_module
from host.link.frame import Frame, LostFrame
from host.link.records import Event, State
from host.link.replay import Recording
from host.link.replay_url import to_url
from host.link.serial.protocol_replay import Serial
from host.link.session import Framing, Session
from host.link.stream import Stream
from host.protocol.errors import PeerSilentError

S = 1_000_000_000
BODIES = [pixels(8, 6, seed) for seed in range(4)]
STOCK = [b"".join(stock(body, 8, 6, piece=20)) for body in BODIES]
NATIVE = [b"".join(native(number, body, 8, 6)) for number, body in enumerate(BODIES)]


class Script:
    """A port that was connected several times: what each connection sends, then it ends. Time jumps: nobody waits."""

    url, framing, world, robot, baud, seam = "socket://made", "tcp", None, None, None, ""

    def __init__(self, connections: list[list[bytes]]) -> None:
        self.connections = connections
        self.ended = ""
        self.now_ns = 7 * S

    def read(self, wanted: int) -> bytes:
        if not self.connections[0]:
            self.ended = "closed by the robot"
            return b""
        return self.connections[0].pop(0)

    def clock_ns(self) -> int:
        self.now_ns += S // 5
        return self.now_ns

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        pass

    def again(self, first_index: int) -> tuple["Script", Session]:
        self.connections.pop(0)
        self.ended = ""
        return self, Session("tcp", "stock", first_index)


def recorded(path: Path) -> bytes:
    """All that its robot sent."""
    with contextlib.closing(Recording(str(path))) as recording:
        reads = recording.reads(recording.source(0))
        return b"".join(bytes(data) for _, data in reads if not isinstance(data, str))


def live(path: Path, connections: list[list[bytes]]) -> tuple[Stream, list[Event]]:
    """Recorded while it happens, until the last connection has said all."""
    port = Script(connections)
    recorder = recording.Recorder(str(path))
    stream = Stream(port, Session("tcp", "stock"), None, port.again)  # type: ignore[arg-type]
    stream.tap = recorder.track(0, port, "stock")
    events = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stream_module, "POLL_S", 0)
        for event in stream.events():
            events.append(event)
            if len(port.connections) == 1 and not port.connections[0]:
                break
    recorder.close()
    return stream, events


def replayed(url: str) -> tuple[Stream, list[Event]]:
    with host.open(url) as stream:
        return stream, list(stream.events(states=True))


def outline(events: list[Event]) -> list[tuple[object, ...]]:
    """All but the times of the hosts: a replay learns of an end when the next connection begins."""
    told: list[tuple[object, ...]] = []
    for event in events:
        if isinstance(event, Frame):
            told.append(("frame", event.index, event.body.tobytes()))
        elif isinstance(event, LostFrame):
            told.append(("lost", event.cause, event.received_bytes, event.expected_bytes, event.body.tobytes()))
        elif not isinstance(event, State):
            told.append((type(event).__name__,))
    return told


@pytest.mark.parametrize("frames", [STOCK, NATIVE], ids=["stock", "native"])
def test_a_reconnection_is_what_it_was_wherever_the_connection_broke(tmp_path: Path, frames: list[bytes]) -> None:
    for cut in range(len(frames[1])):
        path = tmp_path / f"{cut}.mcap"
        was, told = live(path, [[frames[0] + frames[1][:cut]], [frames[2], frames[3]]])
        stream, events = replayed(to_url(str(path), pace="max"))
        assert outline(events) == outline(told), f"cut at byte {cut}"
        assert stream.reconnects == was.reconnects == 1
        assert stream.counters == was.counters, f"cut at byte {cut}"
        states = [event.state for event in events if isinstance(event, State)]
        assert states == ["streaming", "disconnected", "waiting", "streaming"]


def test_connections_that_brought_nothing_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "often.mcap"
    was, _ = live(path, [[STOCK[0]], [], [], [STOCK[1]]])
    stream, events = replayed(to_url(str(path), pace="max"))
    assert stream.reconnects == was.reconnects == 3
    assert [event.index for event in events if isinstance(event, Frame)] == [0, 1]


def test_a_reconnection_is_recorded_again_and_diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    first, second = tmp_path / "first.mcap", tmp_path / "second.mcap"
    live(first, [[STOCK[0], STOCK[1][:30]], [STOCK[2]]])
    assert main(["stream", "--port", to_url(str(first), pace="max"), "--record", str(second), "--json"]) == 0
    assert len(read(second, "/robot0/connection")) == 1
    stream, _ = replayed(to_url(str(second), pace="max"))
    assert stream.reconnects == 1
    capsys.readouterr()
    assert main(["doctor", "--port", to_url(str(second), pace="max"), "--json"]) == 4
    assert '"cause":"connection_ends"' in capsys.readouterr().out


@pytest.mark.parametrize("frames", [STOCK, NATIVE], ids=["stock", "native"])
def test_the_seam_of_a_loop_is_no_loss(tmp_path: Path, frames: list[bytes]) -> None:
    """Wherever the recording breaks off: in a packet, between two packets of a frame, between two frames."""
    whole = frames[0] + frames[1]
    for cut in range(len(frames[0]), len(whole) + 1):
        path = tmp_path / f"{cut}.mcap"
        record_reads(path, [(S, whole[:100]), (2 * S, whole[100:cut])])
        with host.open(to_url(str(path), pace="max", loop=1)) as stream:
            bodies = [frame.body.tobytes() for _, frame in zip(range(6), stream, strict=False)]
        assert bodies == (BODIES[:2] * 3 if cut == len(whole) else BODIES[:1] * 6), f"cut at byte {cut}"
        assert sum(stream.counters.frames_lost.values()) == 0
        assert stream.counters.garbage_bytes == stream.counters.renumbered == 0
        assert stream.reconnects == 0


@pytest.mark.parametrize("wire", ["tcp", "uart2", "uart1"])
def test_a_packet_that_the_end_cuts_off_is_told_from_damage(tmp_path: Path, wire: str) -> None:
    path = tmp_path / "whole.mcap"
    record(path, f"sim://hover?pace=max&seed=5&camera_width=64&camera_height=48&wire={wire}", frames=1)
    data = recorded(path)
    framing: Framing = {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}[wire]  # type: ignore[assignment]
    for cut in range(len(data) - 200, len(data)):
        session = Session(framing)
        session.receive(data[:cut], 1)
        session.finish()
        assert session.counters.cut_bytes == session.counters.garbage_bytes <= cut
    session = Session(framing)
    session.receive(data + bytes([7]) * 2000, 1)
    session.finish()
    assert session.counters.garbage_bytes - session.counters.cut_bytes > 1900


@pytest.mark.parametrize("scenario", ["hover", "paper", "nanocockpit"])
@pytest.mark.parametrize("cut", [1, 3, 700, 1500])
def test_who_is_not_told_of_seams_gets_whole_packets(tmp_path: Path, scenario: str, cut: int) -> None:
    """Of every firmware, in a loop."""
    path, broken = tmp_path / "whole.mcap", tmp_path / "broken.mcap"
    record(path, f"sim://{scenario}?pace=max&seed=5", frames=2)
    data = recorded(path)
    end = len(data) - cut
    record_reads(broken, [(S + at, data[at : min(at + 1000, end)]) for at in range(0, end, 1000)])
    session = Session("tcp")
    with contextlib.closing(Serial(to_url(str(broken), pace="max", loop=1))) as replay:
        while session.counters.frames < 4:
            session.receive(replay.read(1 << 16), replay.clock_ns())
    assert session.counters.garbage_bytes == 0


@pytest.mark.parametrize("wire", ["uart2", "uart1"])
def test_the_seam_of_a_loop_on_other_wires(tmp_path: Path, wire: str) -> None:
    path = tmp_path / "loop.mcap"
    record(path, f"sim://hover?pace=max&seed=5&camera_width=64&camera_height=48&wire={wire}", frames=3)
    with host.open(to_url(str(path), pace="max", loop=1)) as stream, contextlib.closing(stream.events()) as events:
        for event in events:
            assert not isinstance(event, LostFrame)
            if stream.counters.frames + stream.counters.stamps // 20 >= 12:
                break
    assert stream.counters.garbage_bytes == 0


def test_a_loop_of_nothing_but_half_a_packet_is_silence(tmp_path: Path) -> None:
    record_reads(tmp_path / "half.mcap", [(1, packet(100)[:50])])
    with pytest.raises(PeerSilentError), host.open(to_url(str(tmp_path / "half.mcap"), pace="max", loop=1)) as stream:
        list(stream)


@pytest.mark.parametrize(("wanted", "code"), [(["--count", "3"], 5), (["--duration", "5"], 5), (["--count", "2"], 0),
                                              (["--duration", "1"], 0), ([], 0)])  # fmt: skip
def test_a_recording_that_ends_too_soon(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], wanted: list[str], code: int
) -> None:
    path = tmp_path / "short.mcap"
    record_reads(path, [(S, STOCK[0]), (2 * S, STOCK[1])])
    assert main(["stream", "--port", to_url(str(path), pace="max"), "--json", *wanted]) == code
    err = capsys.readouterr().err
    assert ("the recording has ended before" in err) == (code == 5)
    assert err.count("\n") == (code == 5)


# Programs that know nothing of seams.


def play(url: str, most: int | None = None) -> list[tuple[int, bytes]]:
    """Its reads, until the end or so many bytes."""
    found: list[tuple[int, bytes]] = []
    with contextlib.closing(Serial(url)) as port, contextlib.suppress(Exception):
        while most is None or sum(len(data) for _, data in found) < most:
            data = port.read(1 << 20)
            assert data
            found.append((port.clock_ns(), data))
    return found


def packet(size: int) -> bytes:
    return size.to_bytes(2, "little") + bytes([size % 251]) * size


def test_a_loop_begins_anew_at_a_packet(tmp_path: Path) -> None:
    """The half packet at the end is left out; times go on."""
    stream = packet(10) + packet(1022) + packet(2)
    cut = stream + packet(500)[:300]
    reads = [(10**9 + at * 10**6, cut[at : at + 7]) for at in range(0, len(cut), 7)]
    record_reads(tmp_path / "loop.mcap", reads)
    played = play(to_url(str(tmp_path / "loop.mcap"), pace="max", loop=1), most=3 * len(stream))
    assert b"".join(data for _, data in played)[: 3 * len(stream)] == 3 * stream
    times = [at for at, _ in played]
    assert times == sorted(times)
    assert times[-1] > 3 * (reads[-1][0] - reads[0][0])


@pytest.mark.parametrize("joint", ["connection", "missing"])
def test_halves_of_two_packets_are_not_joined(tmp_path: Path, joint: str) -> None:
    recorder = recording.Recorder(str(tmp_path / "again.mcap"))
    track = recorder.track(0, FakePort(), "auto")
    first, second = packet(10) + packet(20), packet(30)
    track.received(first + packet(500)[:100], 1000)
    if joint == "connection":
        track.connected_again(2000)
    else:
        with recorder._changed:
            track.left_out("received", 500, 2000)
    track.received(second, 3000)
    recorder.close()
    played = play(to_url(str(tmp_path / "again.mcap"), pace="max"))
    assert played == [(1000, first), (3000, second)]
    assert [message.publish_time for _, message, _ in read(tmp_path / "again.mcap", f"/robot0/{joint}")] == [2000]


def test_a_loop_of_nothing_but_half_a_packet_ends(tmp_path: Path) -> None:
    record_reads(tmp_path / "half.mcap", [(1, packet(100)[:50])])
    assert play(to_url(str(tmp_path / "half.mcap"), pace="max", loop=1)) == []


def test_a_loop_over_damage_passes_everything(tmp_path: Path) -> None:
    data = packet(5) + b"\xff\xff\xff" + packet(6)
    record_reads(tmp_path / "bad.mcap", [(1, data)])
    played = play(to_url(str(tmp_path / "bad.mcap"), pace="max", loop=1), most=3 * len(data))
    assert b"".join(each for _, each in played) == 3 * data
