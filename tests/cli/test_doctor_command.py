"""`host doctor` as a user meets it. What it finds is tests/sim/test_doctor.py's."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from host.cli import doctor, main

ROOT = Path(__file__).resolve().parents[2]
SMALL = "pace=max&camera_width=64&camera_height=48"


def diagnosis(capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    (line,) = capsys.readouterr().out.splitlines()
    found: dict[str, object] = json.loads(line)
    return found


def test_a_clean_robot(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--port", f"sim://hover?{SMALL}", "--duration", "10", "--json"]) == 0
    found = diagnosis(capsys)
    assert found["healthy"] is True
    assert found["findings"] == []
    assert found["bottleneck"] == "camera"
    assert found["seconds"] == pytest.approx(10, abs=0.2)
    assert isinstance(found["frames"], int)
    assert found["frames"] > 80


def test_a_fault_in_words(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert main(["doctor", "--port", f"sim://hover?{SMALL}&uart1_loss=0.1", "--duration", "10"]) == doctor.EXIT_ILL == 4
    out, err = capsys.readouterr()
    assert "problem     UART1: time messages are lost" in out
    assert "Reseat the decks" in out
    assert "the limit is the camera" in out
    assert "healthy" not in out
    assert "listening to" in err


def test_silence(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--port", f"sim://hover?{SMALL}&camera_fps=0", "--duration", "3", "--json"]) == 3
    out, err = capsys.readouterr()
    assert json.loads(out)["findings"][0]["cause"] == "no_frames"
    assert "not a byte in 3.0 s" in err


def test_a_port_that_cannot_be_opened(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["doctor", "--port", "sim://nowhere"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("host: ")
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("wrong", [["--duration", "0"], ["--duration", "x"], ["--dialect", "klingon"], []])
def test_wrong_arguments(wrong: list[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["doctor", *(["--port", "sim://hover"] if wrong else []), *wrong])
    assert stopped.value.code == 2


def test_ctrl_c_ends_the_listening_and_not_the_diagnosis(tmp_path: Path) -> None:
    program = subprocess.Popen(
        [sys.executable, "-c", "import sys; sys.argv[0] = 'host'; from host.cli import main; sys.exit(main())",
         "doctor", "--port", "sim://hover?camera_width=64&camera_height=48", "--duration", "3600"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )  # fmt: skip
    time.sleep(4)
    program.send_signal(signal.SIGINT)
    out, err = program.communicate(timeout=30)
    assert program.returncode == 130, err
    assert err == ""
    found = json.loads(out)
    assert found["stopped"] is True
    assert found["healthy"] is None
    assert 0 < found["seconds"] < 10


@pytest.mark.parametrize(
    ("seconds", "stopped", "settings", "code", "says"),
    [
        (3, True, "", 130, "no verdict  nothing wrong was seen, and 3.1 s is too short"),
        (3, False, "", 2, "no verdict  nothing wrong was seen, and 3.1 s is too short"),
        (12, True, "", 0, "healthy"),
        (3, True, "&uart1_loss=0.9", 4, "problem     UART1"),
        (3, True, "&camera_fps=0", 3, "problem     camera"),
        (1, True, "&camera_fps=0", 130, "no verdict"),
    ],
)
def test_too_short_for_a_verdict(
    seconds: float, stopped: bool, settings: str, code: int, says: str,
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    listen = doctor.listen
    monkeypatch.setattr(doctor, "listen", lambda arguments: (listen(arguments)[0], stopped))
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True, raising=False)
    assert main(["doctor", "--port", f"sim://hover?{SMALL}{settings}", "--duration", str(seconds)]) == code
    out, err = capsys.readouterr()
    assert says in out
    assert ("too short" in err) == (code == 2)
    assert ("healthy" in out) == (says == "healthy")


def test_a_connection_that_ends_is_made_again(capsys: pytest.CaptureFixture[str]) -> None:
    """What it cuts off in the middle of a packet is no damage."""
    header = bytes.fromhex("0d006305bc0400030001000c000000")
    frame = header + b"\x0e\x00\x63\x05" + bytes(12)
    server = socket.create_server(("127.0.0.1", 0))

    def robot() -> None:
        for _ in range(3):
            connection, _ = server.accept()
            with connection:
                connection.sendall(frame * 3 + frame[:10])
        server.close()

    thread = threading.Thread(target=robot)
    thread.start()
    port = f"socket://127.0.0.1:{server.getsockname()[1]}"
    assert main(["doctor", "--port", port, "--duration", "2", "--dialect", "stock", "--json"]) == 4
    thread.join()
    found = diagnosis(capsys)
    assert found["frames"] == 9
    findings = found["findings"]
    assert isinstance(findings, list)
    assert [(each["stage"], each["cause"]) for each in findings if each["severity"] != "note"] == [
        ("Wi-Fi", "connection_ends")
    ]


def test_a_robot_that_has_another_client_is_not_flooded(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "RETRY_S", 0.5)
    server = socket.create_server(("127.0.0.1", 0))
    came = []

    def robot() -> None:
        while True:
            connection, _ = server.accept()
            connection.close()
            came.append(None)

    threading.Thread(target=robot, daemon=True).start()
    port = f"socket://127.0.0.1:{server.getsockname()[1]}"
    assert main(["doctor", "--port", port, "--duration", "2", "--json"]) == 3
    assert 1 < len(came) < 7
    findings = diagnosis(capsys)["findings"]
    assert isinstance(findings, list)
    assert [each["cause"] for each in findings] == ["another_client"]
