"""`host stream` when the connection comes and goes, and when it is stopped in the middle of frames."""

import contextlib
import errno
import json
import os
import pty
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from host.cli import main

ROOT = Path(__file__).resolve().parents[2]
WIDTH, HEIGHT = 64, 48
SIZE = WIDTH * HEIGHT
WAIT_S = 60.0
"""Longer than a loaded machine takes; only a failing test waits for so long."""


def packet(data: bytes) -> bytes:
    return struct.pack("<H", len(data) + 2) + b"\x63\x05" + data


def frame(number: int) -> bytes:
    """A stock frame, all of its pixels its number."""
    body = bytes([number % 256]) * SIZE
    pieces = b"".join(packet(body[at : at + 1020]) for at in range(0, SIZE, 1020))
    return packet(struct.pack("<BHHBBI", 0xBC, WIDTH, HEIGHT, 1, 0, SIZE)) + pieces


class Server:
    """A robot's TCP server: `clients` says what each connection in turn gets; the socket is closed in between."""

    def __init__(self, clients: list[Callable[[socket.socket], None]], port: int = 0) -> None:
        self.clients = clients
        self.listening = socket.create_server(("127.0.0.1", port))
        self.port = self.listening.getsockname()[1]
        self.url = f"socket://127.0.0.1:{self.port}"
        self.thread = threading.Thread(target=self.run, daemon=True)
        self.thread.start()

    def run(self) -> None:
        for client in self.clients:
            connection, _ = self.listening.accept()
            self.listening.close()
            with connection:
                client(connection)
            time.sleep(0.3)
            self.listening = socket.create_server(("127.0.0.1", self.port))
        self.listening.close()


@contextlib.contextmanager
def stream(*words: str) -> Iterator[subprocess.Popen[str]]:
    """`host stream`, which is killed if it has not ended in time: then reading its output ends, too."""
    with subprocess.Popen(
        [sys.executable, "-m", "host", "stream", "--json", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    ) as process:
        guard = threading.Timer(WAIT_S, process.kill)
        guard.start()
        try:
            yield process
        finally:
            guard.cancel()
            process.kill()


def wait_for(process: subprocess.Popen[str], text: str) -> None:
    """Reads its lines up to one with this text."""
    assert process.stdout is not None
    assert any(text in line for line in process.stdout), f"it ended, or was killed, before it said {text}"


def lines(stdout: str) -> list[dict[str, object]]:
    return [json.loads(line) for line in stdout.splitlines()]


def rest(process: subprocess.Popen[str]) -> tuple[str, str]:
    """As communicate(), which loses what readline() has read ahead."""
    assert process.stdout is not None
    assert process.stderr is not None
    return process.stdout.read(), process.stderr.read()


def test_frames_go_on_after_the_connection_was_lost(tmp_path: Path) -> None:
    def first(to: socket.socket) -> None:
        to.sendall(frame(0) + frame(1) + frame(2)[:-10])

    def second(to: socket.socket) -> None:
        to.sendall(frame(3) + frame(4) + frame(5))

    served = Server([first, second])
    folder = tmp_path / "kept"
    recording = tmp_path / "kept.mcap"
    words = ["--images", str(folder), "--record", str(recording)]
    with stream("--port", served.url, "--reconnect", "--count", "5", *words) as process:
        stdout, stderr = process.communicate()
    assert process.returncode == 0, stderr
    events = lines(stdout)
    summary = events[-1]
    assert summary["frames"] == 5
    assert summary["reconnects"] == 1
    assert summary["frames_lost"] == {"disconnected": 1}
    assert [event["index"] for event in events if event["event"] == "frame"] == [0, 1, 2, 3, 4]
    states = [(event["state"], event["reason"]) for event in events if event["event"] == "state"]
    assert states[0] == ("streaming", "")
    assert states[1] == ("disconnected", "closed by the robot")
    assert states[-1] == ("streaming", "")
    assert ("waiting", "") in states[2:-1]
    pixels = [(folder / f"{index:06d}.pgm").read_bytes()[-SIZE:] for index in range(5)]
    assert pixels == [bytes([number]) * SIZE for number in (0, 1, 3, 4, 5)]
    assert summary["recorded"]["frames"] == 5  # type: ignore[index]


def test_a_serial_adapter_that_is_pulled_and_plugged_in(tmp_path: Path) -> None:
    device = tmp_path / "ttyUSB0"
    pairs = [pty.openpty(), pty.openpty()]
    device.symlink_to(os.ttyname(pairs[0][1]))
    with stream("--port", str(device), "--framing", "tcp", "--reconnect", "--count", "3") as process:
        wait_for(process, '"no_bytes"')  # it reads: what comes before pyserial has set it up is thrown away
        os.write(pairs[0][0], frame(0))
        wait_for(process, '"event":"frame"')
        device.unlink()
        for each in pairs[0]:
            os.close(each)
        wait_for(process, "no such device")
        device.symlink_to(os.ttyname(pairs[1][1]))
        wait_for(process, '"waiting"')
        os.write(pairs[1][0], frame(1) + frame(2))
        stdout, stderr = rest(process)
    for each in pairs[1]:
        os.close(each)
    assert process.returncode == 0, stderr
    assert lines(stdout)[-1]["reconnects"] == 1
    assert lines(stdout)[-1]["frames"] == 3


def test_a_silent_connection_is_made_again() -> None:
    """A robot that has lost its power says no goodbye."""
    served = Server([lambda to: time.sleep(2.0), lambda to: to.sendall(frame(0) * 2)])
    with stream("--port", served.url, "--reconnect", "--timeout", "0.5", "--count", "2") as process:
        stdout, stderr = process.communicate()
    assert process.returncode == 0, stderr
    reasons = [str(event["reason"]) for event in lines(stdout) if event["event"] == "state"]
    assert any("not a byte" in reason for reason in reasons)
    assert lines(stdout)[-1]["reconnects"] == 1


def test_without_reconnect_a_lost_connection_is_an_error_of_its_own() -> None:
    served = Server([lambda to: to.sendall(frame(0) * 3)])
    with stream("--port", served.url) as process:
        stdout, stderr = process.communicate()
    assert process.returncode == 5
    assert "closed by the robot, after 3 frames" in stderr
    assert stderr.count("\n") == 1
    assert lines(stdout)[-1]["frames"] == 3


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as unused:
        return int(unused.getsockname()[1])


def test_a_robot_that_is_not_on_yet_is_waited_for(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The first connection is no reconnection: not in the summary, and not in the recording."""
    port, recording = free_port(), tmp_path / "late.mcap"
    words = ["--port", f"socket://127.0.0.1:{port}", "--reconnect", "--count", "2", "--record", str(recording)]
    with stream(*words) as process:
        assert process.stdout is not None
        first = process.stdout.readline()
        assert json.loads(first)["state"] == "disconnected"
        assert "connection refused" in json.loads(first)["reason"]
        served = Server([lambda to: to.sendall(frame(0) + frame(1))], port)
        stdout, stderr = rest(process)
    served.thread.join(10)
    assert process.returncode == 0, stderr
    events = lines(stdout)
    assert [event["index"] for event in events if event["event"] == "frame"] == [0, 1]
    assert [event["state"] for event in events if event["event"] == "state"][-2:] == ["waiting", "streaming"]
    assert events[-1]["reconnects"] == 0
    assert main(["stream", "--port", f"replay://{recording}?pace=max", "--json"]) == 0
    again = lines(capsys.readouterr().out)[-1]
    assert (again["frames"], again["reconnects"], again["bytes"]) == (2, 0, events[-1]["bytes"])


def test_an_adapter_that_is_not_plugged_in_yet_is_waited_for(tmp_path: Path) -> None:
    device, pair = tmp_path / "ttyUSB0", pty.openpty()
    with stream("--port", str(device), "--framing", "tcp", "--reconnect", "--count", "1") as process:
        assert process.stdout is not None
        assert "no such device" in process.stdout.readline()
        device.symlink_to(os.ttyname(pair[1]))
        wait_for(process, '"waiting"')
        os.write(pair[0], frame(0))
        stdout, stderr = rest(process)
    for each in pair:
        os.close(each)
    assert process.returncode == 0, stderr
    assert lines(stdout)[-1]["reconnects"] == 0


@pytest.mark.parametrize(
    ("port", "says"),
    [
        ("socket://nowhere.invalid:5000", "no such address"),
        ("socket://127.0.0.1:99999", "write socket://"),
        (f"socket://{'a' * 64}.example:5000", "no such address"),
        ("socket://", "write socket://"),
        ("pigeon://1", "not known"),
        ("socket://127.0.0.1:0", "write socket://"),
        ("192.168.4.1:5000", "Write socket://"),
        ("hover", "sim://SCENARIO"),
        ("flight.mcap", "replay://flight.mcap"),
        ("rfc2217://127.0.0.1", "write rfc2217://ADDRESS:PORT"),
        (str(ROOT / "README.md"), "no serial device"),
        ("", "no port is named"),
    ],
)
def test_what_waiting_does_not_mend_is_told_at_once(port: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stream", "--port", port, "--reconnect", "--json"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1


def test_no_permission_is_not_waited_for(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    import serial

    def refuse(*args: object, **kwargs: object) -> None:
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    assert main(["stream", "--port", "/dev/ttyUSB0", "--reconnect", "--json"]) == 2
    assert "no permission" in capsys.readouterr().err


def test_a_second_client_is_told_that_there_may_be_another() -> None:
    """The robot says nothing: it closes (the simulator), or lets it wait unheard (the real ESP32)."""
    for client in (lambda to: None, lambda to: time.sleep(2)):
        served = Server([client])
        with stream("--port", served.url, "--timeout", "0.5") as process:
            _, stderr = process.communicate()
        assert process.returncode in (3, 5)
        assert "An AI-deck serves one client at a time: is another program connected to it?" in stderr


def test_a_simulated_robot_cannot_be_connected_again() -> None:
    with stream("--port", "sim://hover", "--reconnect") as process:
        _, stderr = process.communicate()
    assert process.returncode == 2
    assert "host sim serve" in stderr


@pytest.mark.parametrize("which", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("count", [[], ["--count", "1000000"]])
def test_stopped_in_the_middle_of_frames(which: signal.Signals, count: list[str], tmp_path: Path) -> None:
    """Whatever was begun is whole: each picture, each line, the recording; and the exit code tells who wanted more."""

    def forever(to: socket.socket) -> None:
        number = 0
        while True:
            try:
                to.sendall(frame(number))
            except OSError:
                return
            number += 1

    served = Server([forever])
    folder, recording = tmp_path / "kept", tmp_path / "kept.mcap"
    words = ["--port", served.url, "--images", str(folder), "--record", str(recording), *count]
    with stream(*words) as process:
        assert process.stdout is not None
        for _ in range(50):
            assert process.stdout.readline()
        process.send_signal(which)
        stdout, stderr = rest(process)
    assert process.returncode == (130 if count else 0), stderr
    assert stderr == ""
    kept = lines((folder / "frames.jsonl").read_text())
    assert (folder / "frames.jsonl").read_text().endswith("\n")
    assert [line["image"] for line in kept] == [f"{index:06d}.pgm" for index in range(len(kept))]
    assert sorted(path.name for path in folder.iterdir()) == sorted([*(line["image"] for line in kept), "frames.jsonl"])
    head = f"P5\n{WIDTH} {HEIGHT}\n255\n".encode()
    for index, line in enumerate(kept):
        assert (folder / str(line["image"])).read_bytes() == head + bytes([index % 256]) * SIZE
    summary = lines(stdout)[-1]
    assert summary["event"] == "summary"
    assert summary["frames"] == len(kept) >= 49
    # The recording may hold a frame that was read and not handed over any more, and never fewer.
    assert summary["recorded"]["frames"] >= len(kept)  # type: ignore[index]
    assert recording.read_bytes().endswith(b"\x89MCAP0\r\n")


def test_stopped_while_waiting_for_a_connection() -> None:
    served = Server([lambda to: to.sendall(frame(0))])
    with stream("--port", served.url, "--reconnect") as process:
        wait_for(process, '"disconnected"')
        served.listening.close()
        process.send_signal(signal.SIGINT)
        stdout, stderr = rest(process)
    assert process.returncode == 0, stderr
    assert lines(stdout)[-1]["frames"] == 1
