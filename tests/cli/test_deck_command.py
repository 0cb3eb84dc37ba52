"""`host deck` against simulated robots, and against servers that leave out one part each."""

import contextlib
import json
import os
import pty
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
ECHO = b"\x01spindeck"
ESP32_TEST, GAP8_CONSOLE, GAP8_APP = b"\x13\x0e", b"\x23\x02", b"\x23\x05"


def packet(data: bytes, route: bytes) -> bytes:
    return struct.pack("<H", len(data) + 2) + route + data


def deck(*words: str, stdin: str = "") -> tuple[int, Any, str]:
    """Exit code, what it printed as JSON, stderr."""
    result = subprocess.run(
        [sys.executable, "-m", "host", "deck", *words],
        input=stdin,
        capture_output=True,
        text=True,
        timeout=120,
        cwd=ROOT,
    )
    assert "Traceback" not in result.stderr
    return result.returncode, json.loads(result.stdout) if result.stdout else None, result.stderr


@contextlib.contextmanager
def server(answer: Callable[[bytes], bytes], greeting: bytes = b"", close: bool = False) -> Iterator[str]:
    """A deck for one client: `answer` makes bytes of the bytes of each read."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def run() -> None:
            connection, _ = listening.accept()
            with connection, contextlib.suppress(OSError):
                connection.sendall(greeting)
                while data := connection.recv(4096):
                    connection.sendall(answer(data))
                    if close:
                        return

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listening.getsockname()[1]}"
        thread.join(timeout=10)


def echoing(data: bytes) -> bytes:
    """An ESP32 that is alive, and nothing else."""
    return packet(ECHO, ESP32_TEST) if ECHO in data else b""


def test_camera_settings_are_taken_and_hold() -> None:
    """A served robot keeps them for the next client."""
    serving = subprocess.Popen(
        [sys.executable, "-m", "host", "sim", "serve", "--listen", "127.0.0.1:0", "--pace", "max"],
        stdout=subprocess.PIPE, text=True, cwd=ROOT,
    )  # fmt: skip
    with serving:
        assert serving.stdout is not None
        try:
            port = serving.stdout.readline().split()[0]
            code, told, err = deck(
                "camera", "--port", port, "--exposure-lines", "300", "--analog-gain", "4", "--digital-gain", "80",
                "--burst", "2", "--fps", "20",
            )  # fmt: skip
            assert code == 0, err
            assert told["settings"] == {
                "auto_exposure": False, "analog_gain": 4, "digital_gain": 80, "burst": 2, "encoding": "raw",
                "exposure_lines": 300, "frame_period_us": 100_000,
            }  # fmt: skip
            words = ["stream", "--port", port, "--dialect", "native", "--count", "8", "--json"]
            result = subprocess.run(
                [sys.executable, "-m", "host", *words], capture_output=True, text=True, timeout=120, cwd=ROOT
            )
        finally:
            serving.terminate()
    frames = [json.loads(line) for line in result.stdout.splitlines() if '"event":"frame"' in line]
    last = frames[-1]
    assert [last[name] for name in ("exposure_lines", "analog_gain", "digital_gain", "burst")] == [300, 4, 80, 2]


@pytest.mark.parametrize("wire", ["tcp", "uart2"])
def test_camera_on_either_wire(wire: str) -> None:
    code, told, err = deck("camera", "--port", f"sim://hover?pace=max&wire={wire}", "--encoding", "jpeg")
    assert code == 0, err
    assert told["settings"]["encoding"] == "jpeg"
    assert told["settings"]["auto_exposure"] is True


STOCK_IMAGE = packet(struct.pack("<BHHBBI", 0xBC, 8, 6, 1, 0, 48), GAP8_APP) + packet(bytes(48), GAP8_APP)
METADATA = bytes([10]) + struct.pack("<HHBBB", 8, 6, 1, 0, 7) + bytes(140)
BUFFER = struct.pack("<BBII2x", 0x10, 1, 196, 0) + METADATA + bytes(48)
NANOCOCKPIT_IMAGE = struct.pack("<H", len(BUFFER)) + b"\x63\x06" + BUFFER
WIFI = ["wifi", "--mode", "ap", "--ssid", "lab", "--open"]


def listener() -> tuple[bytearray, Callable[[bytes], bytes]]:
    """What a deck that answers nothing has been sent."""
    heard = bytearray()

    def answer(data: bytes) -> bytes:
        heard.extend(data)
        return b""

    return heard, answer


def test_stock_firmware_is_asked_nothing() -> None:
    """A packet that nobody reads would stop its reception for good."""
    heard, answer = listener()
    with server(answer, STOCK_IMAGE) as port:
        code, _, err = deck("camera", "--port", port, "--fps", "5")
    assert code == 4
    assert "the firmware is stock" in err
    assert heard == b""


@pytest.mark.parametrize(
    ("words", "says"), [(["camera", "--fps", "5"], "camera settings are compiled"), (WIFI, "network is compiled")]
)
@pytest.mark.parametrize("greeting", [NANOCOCKPIT_IMAGE, b"\x01\x02\x03" + NANOCOCKPIT_IMAGE * 2])
def test_nanocockpit_is_listened_to_and_sent_nothing(words: list[str], says: str, greeting: bytes) -> None:
    """Its bridge would take a packet of CPX for a longer one and wait for the rest."""
    heard, answer = listener()
    with server(answer, greeting) as port:
        code, told, err = deck(*words, "--port", port)
    assert (code, told) == (4, None)
    assert says in err
    assert err.endswith("Nothing was sent\n")
    assert heard == b""


@pytest.mark.parametrize("words", [["camera", "--fps", "5"], WIFI])
def test_bytes_of_nobody_known_are_answered_with_nothing(words: list[str]) -> None:
    heard, answer = listener()
    with server(answer, b"HTTP/1.1 400 Bad Request\r\n" * 20) as port:
        code, _, err = deck(*words, "--port", port, "--timeout", "1")
    assert code == 4
    assert "520 bytes, 0 packets and no image in them: neither CPX nor" in err
    assert heard == b""


def test_a_deck_without_a_camera_is_asked_after_a_while() -> None:
    """Its ESP32 says nothing by itself."""
    heard, answer = listener()
    with server(answer) as port:
        code, _, err = deck(*WIFI, "--port", port, "--timeout", "1")
    assert code == 3
    assert "not a byte" in err
    assert heard[:13] == packet(ECHO, b"\x5a\x0e")


def test_nanocockpit_that_wakes_up_late_is_sent_no_more() -> None:
    heard = bytearray()

    def answer(data: bytes) -> bytes:
        heard.extend(data)
        return NANOCOCKPIT_IMAGE

    with server(answer) as port:
        code, _, err = deck(*WIFI, "--port", port, "--timeout", "2")
    assert code == 4
    assert err.endswith("An echo request was sent\n")
    assert heard == packet(ECHO, b"\x5a\x0e")


def test_the_papers_firmware_gets_its_own_message() -> None:
    """Eight bytes, once; nothing answers."""
    heard, answer = listener()
    header = struct.pack("<BHHBBII7f", 0xBC, 8, 6, 1, 0, 48, 5, 0, 0, 0, 0, 0, 0, 1)
    image = packet(header, GAP8_APP) + packet(bytes(48), GAP8_APP)
    with server(answer, image) as port:
        code, told, err = deck("camera", "--port", port, "--exposure", "50", "--analog-gain", "8", "--burst", "3")
        assert (code, told["status"], told["settings"]["exposure_lines"]) == (0, None, 50), err
    with server(answer, image) as port:
        code, _, err = deck("camera", "--port", port, "--exposure", "50", "--fps", "5")
        assert code == 2
        assert "no frame rate" in err
    assert heard == packet(struct.pack("<BBBBHBB", 0, 0, 8, 64, 50, 3, 0), b"\x5c\x05")


def test_camera_of_simulated_robots_with_other_firmware() -> None:
    code, _, err = deck("camera", "--port", "sim://paper?pace=max", "--encoding", "jpeg", "--exposure", "100")
    assert code == 0, err
    code, _, err = deck("camera", "--port", "sim://nanocockpit?pace=max", "--encoding", "jpeg")
    assert code == 4
    assert "compiled into it" in err


@pytest.mark.parametrize(
    ("answer", "greeting", "says"),
    [
        (lambda data: b"", b"", "not a byte"),
        (echoing, b"", "the ESP32 answers the echo, and the GAP8 has been silent"),
        (lambda data: b"", packet(b"hello\0", GAP8_CONSOLE), "the ESP32 has not answered the echo"),
        (lambda data: b"", packet(b"hello\0", b"\x13\x02"), "no echo of the ESP32 and nothing of the GAP8"),
        (echoing, packet(b"hello\0", GAP8_CONSOLE), "no whole image came"),
        (echoing, packet(struct.pack("<BHHBBI", 0xBC, 8, 6, 1, 0, 48), b"\xa3\x05"), "and did not reply"),
    ],
)
def test_camera_who_is_silent(answer: Callable[[bytes], bytes], greeting: bytes, says: str) -> None:
    with server(answer, greeting) as port:
        code, told, err = deck("camera", "--port", port, "--fps", "5", "--timeout", "1.5")
    assert code == 3
    assert told is None
    assert says in err
    assert err.count("\n") == 1


def test_camera_values_at_the_limits() -> None:
    """They reach the port."""
    for words in (["--fps", "218"], ["--fps", "0.1"], ["--exposure-lines", "930", "--fps", "30"]):
        code, _, err = deck("camera", "--port", "/no/such/port", *words)
        assert code == 2
        assert "/no/such/port" in err


def test_camera_refused() -> None:
    """By firmware with other limits than ours."""

    def answer(data: bytes) -> bytes:
        return packet(b"\x4e\x05\x11\x06", GAP8_APP) if b"\x4e\x11" in data else b""

    announcing = packet(struct.pack("<BHHBBI", 0xBC, 8, 6, 1, 0, 48), b"\xa3\x05")
    with server(answer, announcing) as port:
        code, _, err = deck("camera", "--port", port, "--exposure-lines", "300")
    assert code == 4
    assert "refuses exposure_lines 300" in err


def test_a_connection_that_ends() -> None:
    with server(echoing, close=True) as port:
        code, _, err = deck("camera", "--port", port, "--fps", "5")
    assert code == 5
    assert "closed by the robot" in err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ([], "nothing to set"),
        (["--analog-gain", "3"], "1, 2, 4 or 8"),
        (["--exposure-lines", "1"], "2..65535"),
        (["--digital-gain", "256"], "1..255"),
        (["--burst", "4"], "1..3"),
        (["--fps", "0"], "--fps"),
        (["--fps", "0.01"], "at least 0.1"),
        (["--fps", "0.1", "--burst", "2"], "at least 0.2"),
        (["--fps", "100000"], "at most 218"),
        (["--fps", "218.5"], "at most 218"),
        (["--fps", "nan"], "--fps"),
        (["--exposure-lines", "65534"], "2..65533"),
        (["--exposure-lines", "931", "--fps", "30"], "at most 930 lines"),
        (["--exposure-lines", "65533", "--fps", "30"], "35.8 us"),
        (["--exposure-lines", "9", "--auto-exposure"], "not allowed with"),
    ],
)
def test_camera_values_are_judged_before_anything_is_opened(words: list[str], says: str) -> None:
    code, _, err = deck("camera", "--port", "/no/such/port", *words)
    assert code == 2
    assert says in err


@pytest.mark.parametrize("port", ["replay://flight.mcap", "sim://hover?wire=uart1&pace=max"])
def test_ports_that_cannot_be_asked(port: str) -> None:
    code, _, err = deck("camera", "--port", port, "--fps", "5")
    assert code == 2
    assert err.startswith("host: ")


@pytest.mark.parametrize(("mode", "word"), [("station", "station"), ("ap", "access point")])
def test_wifi_over_tcp_ends_the_connection(mode: str, word: str) -> None:
    """The simulated ESP32 starts its network anew."""
    words = ["--mode", mode, "--ssid", "lab", "--key-file", "-"]
    code, told, err = deck("wifi", "--port", "sim://hover?pace=max", *words, stdin="12345678\n")
    assert code == 0, err
    assert told["sent"] == ["SET_SSID lab", "SET_KEY, 8 bytes", f"CONNECT as {word}"]
    assert "closed the connection" in told["ended"]
    assert told["still_answers"] is False
    assert "12345678" not in json.dumps(told) + err


def test_wifi_what_is_sent_and_what_is_heard() -> None:
    heard = b""

    def answer(data: bytes) -> bytes:
        nonlocal heard
        heard += data
        if b"\x20\x00" in data:
            return echoing(data) + packet(b"\x31\x0a\x00\x00\x07", b"\x11\x04")
        return echoing(data)

    with server(answer) as port:
        code, told, err = deck("wifi", "--port", port, "--mode", "station", "--ssid", "läb", "--open")
    assert code == 0, err
    assert told["address"] == "10.0.0.7"
    assert told["heard"] == ["WIFI_CONNECTED, address 10.0.0.7"]
    to_esp32 = b"\x5a\x04"
    sent = [packet(b"\x10" + "läb".encode(), to_esp32), packet(b"\x11", to_esp32), packet(b"\x20\x00", to_esp32)]
    assert b"".join(sent) in heard


def test_wifi_nothing_is_heard() -> None:
    with server(echoing) as port:
        code, told, err = deck("wifi", "--port", port, "--mode", "ap", "--ssid", "lab", "--open", "--timeout", "1.5")
    assert code == 0, err
    assert told["heard"] == []
    assert told["ended"] == ""
    assert told["still_answers"] is True


def test_wifi_a_silent_esp32_is_sent_nothing() -> None:
    heard = b""

    def answer(data: bytes) -> bytes:
        nonlocal heard
        heard += data
        return b""

    with server(answer) as port:
        code, _, err = deck("wifi", "--port", port, "--mode", "ap", "--ssid", "lab", "--open", "--timeout", "1")
    assert code == 3
    assert "No setting was sent" in err
    assert b"lab" not in heard


@pytest.mark.parametrize(
    ("words", "stdin", "says"),
    [
        (["--ssid", "", "--open"], "", "--ssid has 0 bytes"),
        (["--ssid", "x" * 33, "--open"], "", "33 bytes"),
        (["--ssid", "lab"], "", "--key-file FILE, or --open"),
        (["--ssid", "lab", "--key", "short"], "", "5 bytes"),
        (["--ssid", "lab", "--key", ""], "", "empty"),
        (["--ssid", "lab", "--key-file", "-"], "\n", "empty"),
        (["--ssid", "lab", "--key-file", "/no/such/file"], "", "/no/such/file"),
        (["--ssid", "lab", "--key", "12345678", "--open"], "", "not allowed with"),
    ],
)
def test_wifi_wrong_settings(words: list[str], stdin: str, says: str) -> None:
    code, _, err = deck("wifi", "--port", "/no/such/port", "--mode", "ap", *words, stdin=stdin)
    assert code == 2
    assert says in err


def test_wifi_asks_for_the_key_on_a_terminal() -> None:
    """And does not show it."""
    master, slave = pty.openpty()
    words = ["wifi", "--port", "/no/such/port", "--mode", "ap", "--ssid", "lab"]
    with subprocess.Popen(
        [sys.executable, "-m", "host", "deck", *words],
        stdin=slave, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT,
        start_new_session=True, preexec_fn=lambda: os.close(os.open(os.ttyname(slave), os.O_RDWR)),
    ) as process:  # fmt: skip
        prompt = os.read(master, 100)
        assert b"key of lab" in prompt
        os.write(master, b"12345\n")
        _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert "5 bytes" in err
    assert "12345" not in err.replace("5 bytes", "")
    os.close(master)
    os.close(slave)
