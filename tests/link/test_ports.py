"""Real sockets and ptys behind host.open, how silence and closed ports are told, and what cannot be opened."""

from __future__ import annotations

import contextlib
import os
import pty
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from made_streams import ANNOUNCING, GAP8_TO_HOST_CONSOLE, native, packet, pixels, stock, uart, uart_pieces

import host
from host.protocol.errors import LocalError, PeerError

BODY = pixels(60, 50, 1)
FRAME = b"".join(stock(BODY, 60, 50))
ROOT = Path(__file__).resolve().parents[2]


@contextlib.contextmanager
def server(serve: Callable[[socket.socket], None]) -> Iterator[str]:
    """A robot's TCP server for one client: its URL."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def run() -> None:
            connection, _ = listening.accept()
            with connection:
                serve(connection)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listening.getsockname()[1]}"
        thread.join(timeout=10)


def test_frames_until_the_robot_closes() -> None:
    with server(lambda to: to.sendall(FRAME * 30)) as url, host.open(url) as stream:
        frames = list(stream)
        assert [frame.index for frame in frames] == list(range(30))
        assert all(frame.body.tobytes() == BODY for frame in frames)
        arrivals = [frame.arrival_host_ns for frame in frames]
        assert arrivals == sorted(arrivals)
        assert 0 <= time.monotonic_ns() - arrivals[-1] < 60e9
        assert stream.port.ended == "closed by the robot"
        assert list(stream) == []
        assert stream.counters.frames == 30


def test_what_had_come_when_the_connection_ended_is_counted() -> None:
    with server(lambda to: to.sendall(FRAME + FRAME[:100])) as url, host.open(url) as stream:
        events = list(stream.events())
        assert [type(event).__name__ for event in events if not isinstance(event, host.Garbage)] == [
            "Frame",
            "LostFrame",
        ]
        assert stream.counters.frames_lost["disconnected"] == 1


def test_a_connection_that_breaks_ends_the_iteration() -> None:
    def serve(to: socket.socket) -> None:
        to.sendall(FRAME)
        time.sleep(0.2)
        to.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\0\0\0\0\0\0\0")  # close with a reset

    with server(serve) as url, host.open(url) as stream:
        assert len(list(stream)) == 1
        assert "broke" in stream.port.ended


def test_auto_asks_after_the_announcement() -> None:
    asked = bytearray()

    def serve(to: socket.socket) -> None:
        to.sendall(FRAME)
        time.sleep(0.2)
        to.sendall(b"".join(stock(BODY, 60, 50, route=ANNOUNCING)))
        asked.extend(to.recv(100))
        to.sendall(b"".join(native(0, BODY, 60, 50)))

    with server(serve) as url, host.open(url) as stream:
        frames = list(stream)
    assert [frame.native is not None for frame in frames] == [False, False, True]
    assert asked.startswith(bytes.fromhex("08005c054e10"))


def test_stock_sends_nothing_at_all() -> None:
    heard: list[bytes] = []

    def serve(to: socket.socket) -> None:
        to.sendall(b"".join(stock(BODY, 60, 50, route=ANNOUNCING)) * 3)
        to.shutdown(socket.SHUT_WR)
        heard.append(to.recv(100))

    with server(serve) as url, host.open(url, dialect="stock") as stream:
        assert len(list(stream)) == 3
    assert heard == [b""]


def test_camera_settings_are_sent_while_reading() -> None:
    heard = bytearray()

    def serve(to: socket.socket) -> None:
        while len(heard) < 18:
            heard.extend(to.recv(18))
        to.sendall(packet(bytes([0x4E, 5, 17, 0])))

    with server(serve) as url, host.open(url) as stream:
        stream.send_camera(host.CameraSettings(burst=2))
        (reply,) = stream.events()
        assert isinstance(reply, host.Reply)
    assert heard[:6] == bytes.fromhex("10005c054e11")


def test_close_from_another_thread_ends_an_iteration_that_waits() -> None:
    done = threading.Event()

    def serve(to: socket.socket) -> None:
        to.sendall(FRAME)
        done.wait(10)

    with server(serve) as url:
        stream = host.open(url)
        frames: list[host.Frame] = []
        reader = threading.Thread(target=lambda: frames.extend(stream))
        reader.start()
        while not stream.counters.frames:
            time.sleep(0.01)
        stream.close()
        stream.close()
        reader.join(timeout=10)
        done.set()
        assert not reader.is_alive()
        assert len(frames) == 1


def test_leaving_a_loop_and_going_on() -> None:
    with server(lambda to: to.sendall(FRAME * 3)) as url, host.open(url) as stream:
        for frame in stream:
            assert frame.index == 0
            break
        assert stream.counters.frames >= 1


@pytest.mark.parametrize(
    ("sent", "says"),
    [
        (b"", "not a byte"),
        (b"\xaa" * 50, "wrong framing, or no robot's port"),
        (packet(b"hi\0", GAP8_TO_HOST_CONSOLE) * 3, "gone silent"),
        (FRAME, "gone silent"),
    ],
)
def test_silence_says_who(sent: bytes, says: str) -> None:
    done = threading.Event()

    def serve(to: socket.socket) -> None:
        to.sendall(sent)
        done.wait(10)

    with server(serve) as url, host.open(url, timeout=0.5) as stream:
        with pytest.raises(PeerError, match=says):
            list(stream)
        done.set()


def test_packets_without_images_are_a_silent_camera() -> None:
    done = threading.Event()

    def serve(to: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while not done.wait(0.05):
                to.sendall(packet(b"alive\0", GAP8_TO_HOST_CONSOLE))

    with server(serve) as url, host.open(url, timeout=0.5) as stream:
        with pytest.raises(PeerError, match=r"no image.*\d+ console.*camera"):
            list(stream)
        done.set()


def test_a_serial_line() -> None:
    """A pty: what comes before the port is open is thrown away by pyserial, so send when it is."""
    master, slave = pty.openpty()
    try:
        with host.open(os.ttyname(slave), timeout=5) as stream:
            assert stream.port.framing == "cpx-uart"
            pieces = b"".join(piece for each in stock(BODY, 60, 50) for piece in uart_pieces(each))
            os.write(master, uart(b"hello\0", GAP8_TO_HOST_CONSOLE) + pieces)
            events = stream.events()
            console, frame = next(events), next(events)
            assert isinstance(console, host.Console)
            assert isinstance(frame, host.Frame)
            assert frame.body.tobytes() == BODY
            assert os.read(master, 4)[:2] == b"\xff\x00"
            os.close(master)
            assert list(events) == []
            assert stream.port.ended
    finally:
        os.close(slave)


def test_a_line_with_credits_only() -> None:
    master, slave = pty.openpty()
    try:
        with host.open(os.ttyname(slave), timeout=0.5) as stream:
            os.write(master, b"\xff\x00" * 3)
            with pytest.raises(PeerError, match="3 credits"):
                list(stream)
    finally:
        os.close(slave)
        os.close(master)


def test_two_programs_do_not_share_a_serial_line() -> None:
    master, slave = pty.openpty()
    try:
        with host.open(os.ttyname(slave)), pytest.raises(LocalError, match="busy"):
            host.open(os.ttyname(slave))
    finally:
        os.close(slave)
        os.close(master)


def test_pyserials_own_urls_work() -> None:
    with host.open("loop://", framing="cpx-uart", timeout=5) as stream:
        stream.port.write(uart(b"round\0", GAP8_TO_HOST_CONSOLE))
        console = next(stream.events())
        assert isinstance(console, host.Console)
        assert console.text == "round"


def refused_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


@pytest.mark.parametrize(
    ("url", "options", "says"),
    [
        ("socket://127.0.0.1:{refused}", {}, "refused"),
        ("socket://", {}, "socket://ADDRESS:PORT"),
        ("socket://127.0.0.1:99999", {}, "socket://ADDRESS:PORT"),
        ("socket://127.0.0.1:5000/path", {}, "socket://ADDRESS:PORT"),
        ("socket://no-such-host.invalid:5000", {}, "no such address"),
        ("/dev/no-such-port", {}, "no such device"),
        ("COM97", {}, "no such device"),
        ("nonsense://x", {}, "nonsense:// is not known"),
        ("sim://no-such-scenario", {}, "hover"),
        ("sim://hover", {"framing": "stamps"}, "carries tcp"),
        ("sim://hover", {"framing": "udp"}, "choose"),
        ("sim://hover", {"dialect": "morse"}, "choose"),
        ("sim://hover", {"timeout": 0}, "timeout"),
        ("sim://hover", {"camera": "/no/such/folder"}, "/no/such/folder"),
        ("/dev/ttyUSB0", {"camera": "x"}, "simulated"),
    ],
)
def test_what_cannot_be_opened_is_told(url: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(LocalError, match=says):
        host.open(url.format(refused=refused_port()), **options)


def test_no_permission(monkeypatch: pytest.MonkeyPatch) -> None:
    import serial

    def refuse(*_: Any, **__: Any) -> None:
        raise serial.SerialException(13, "could not open port /dev/ttyUSB0: [Errno 13] Permission denied")

    monkeypatch.setattr(serial, "serial_for_url", refuse)
    with pytest.raises(LocalError, match="dialout"):
        host.open("/dev/ttyUSB0")


def test_unreachable(monkeypatch: pytest.MonkeyPatch) -> None:
    def silent(*_: Any, **__: Any) -> None:
        raise TimeoutError("timed out")

    monkeypatch.setattr(socket, "create_connection", silent)
    with pytest.raises(LocalError, match="Wi-Fi network"):
        host.open("socket://192.168.4.1")


@pytest.mark.parametrize("wire", ["tcp", "uart2", "uart1"])
def test_simulated_robots(wire: str) -> None:
    with host.open(f"sim://hover?pace=max&seed=7&wire={wire}&camera_width=64&camera_height=48") as stream:
        assert stream.port.framing == {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}[wire]
        assert stream.port.world is not None
        wanted = host.Stamp if wire == "uart1" else host.Frame
        events = [
            event for event, _ in zip((e for e in stream.events() if isinstance(e, wanted)), range(5), strict=False)
        ]
        assert len(events) == 5
        times = [event.arrival_host_ns for event in events]
        assert times == sorted(times)
        assert times[-1] < 20e9, "true time of the world, not of this machine"


def test_import_of_host_is_cheap() -> None:
    code = "import sys, host; print(sorted({'numpy', 'serial', 'cffi', 'host.native'} & set(sys.modules)))"
    ran = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert ran.stdout.strip() == "[]"


def test_every_public_name_is_there() -> None:
    for name in host.__all__:
        assert getattr(host, name) is not None
    with pytest.raises(AttributeError, match="no attribute"):
        _ = host.nothing
