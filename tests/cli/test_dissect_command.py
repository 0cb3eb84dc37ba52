"""`host dissect` as a user meets it."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
CONNECT = bytes.fromhex("ff 04 0a 04 20 01 d4")


def dissect(*words: str, stdin: bytes = b"") -> tuple[int, str, str]:
    result = subprocess.run(
        [sys.executable, "-m", "host", "dissect", *words], input=stdin, capture_output=True, timeout=120, cwd=ROOT
    )
    return result.returncode, result.stdout.decode(), result.stderr.decode()


def test_a_frame_of_the_protocol_page() -> None:
    code, out, err = dissect("-", stdin=CONNECT)
    assert code == 0, err
    lines = out.splitlines()
    assert lines[0].split() == ["0", "7", "STM32", "to", "ESP32,", "WIFI_CTRL:", "CONNECT"]
    assert lines[1].split()[:3] == ["command", "32", "CONNECT"]
    assert lines[2].split() == ["argument", "1"]
    assert lines[3] == "7 bytes, cpx-uart:"
    assert "cpx-uart, guessed" in err


@pytest.mark.parametrize(
    "text",
    [
        "ff 04 0a 04 20 01 d4\n",
        "FF040A04\n2001D4",
        "0xff, 0x04, 0x0a, 0x04, 0x20, 0x01, 0xd4  # connect\n",
        "00000000: ff04 0a04 2001 d4                        .... ..\n",
        "00000000  ff 04 0a 04 20 01 d4                              |.|.. ..|\n00000007\n",
    ],
)
def test_hexadecimal_text(text: str, tmp_path: Path) -> None:
    file = tmp_path / "capture.txt"
    file.write_text(text)
    code, out, err = dissect(str(file), "--hex", "--framing", "cpx-uart", "--json")
    assert code == 0, err
    records = [json.loads(line) for line in out.splitlines()]
    assert [record["event"] for record in records] == ["packet", "summary"]
    assert records[0]["route"]["destination"] == 2
    assert records[0]["fields"] == {"command": 32, "argument": 1}
    assert records[1]["of"] == {"WIFI_CTRL": {"pieces": 1, "bytes": 7}}
    assert err == ""


def test_a_recording(tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    words = ["stream", "--port", "sim://hover?pace=max&robots=2&robot=1", "--count", "3", "--record", str(file)]
    subprocess.run([sys.executable, "-m", "host", *words], cwd=ROOT, check=True, capture_output=True, timeout=120)
    code, out, err = dissect(str(file), "--json")
    assert code == 0, err
    *pieces, summary = [json.loads(line) for line in out.splitlines()]
    assert {piece["event"] for piece in pieces[:-1]} == {"packet"}
    assert sum(piece["size"] for piece in pieces) == summary["bytes"]
    abouts = [piece["about"] for piece in pieces]
    assert abouts[0] == "stock image header"
    assert "native frame" in abouts
    assert "native pairs" in abouts
    frame = next(piece for piece in pieces if piece["about"] == "native frame")
    assert frame["fields"]["body_bytes"] == 324 * 244
    assert frame["fields"]["flags"] & 1
    code, _, err = dissect(str(file), "--robot", "7")
    assert code == 2
    assert "no robot 7" in err


@pytest.mark.parametrize(
    ("words", "stdin", "says"),
    [
        (["/no/such/file"], b"", "/no/such/file: No such file"),
        (["-", "--hex"], b"ff 0\n", "line 1"),
        (["-", "--hex"], b"\nhello\n", "line 2"),
        (["-", "--robot", "0"], b"", "--robot"),
        (["README.mcap"], b"", "README.mcap"),
    ],
)
def test_wrong_input_is_told_in_one_line(words: list[str], stdin: bytes, says: str) -> None:
    code, _, err = dissect(*words, stdin=stdin)
    assert code == 2
    assert says in err
    assert "Traceback" not in err
    assert err.count("\n") == 1


def test_garbage_is_printed_and_an_error_of_who_sent_it() -> None:
    code, out, err = dissect("-", stdin=b"hello, world")
    assert code == 4
    assert "garbage: " in out
    assert "nothing looks like it" in err
    last = err.splitlines()[-1]
    assert last.startswith("host: -: 12 of 12 bytes are garbage, from byte 0 on: length 25960")
    assert last.endswith("Tried: tcp, nanocockpit, cpx-uart, stamps, spi, nanocockpit-spi")
    code, out, err = dissect("-", "--framing", "stamps", "--json", stdin=CONNECT * 3)
    assert code == 4
    assert [json.loads(line)["event"] for line in out.splitlines()] == ["garbage", "summary"]
    assert err.endswith("Read as stamps; they look like cpx-uart: --framing cpx-uart\n")


def test_a_frame_with_a_good_check_to_or_from_nobody() -> None:
    for route, ends in (
        ("30 05", "nobody (6) to nobody (0)"),
        ("23 05", "GAP8 to HOST"),
        ("07 05", "nobody (0) to nobody (7)"),
    ):
        frame = bytearray.fromhex(f"ff 04 {route} 4e 02")
        check = 0
        for byte in frame:
            check ^= byte
        code, out, err = dissect("-", "--framing", "cpx-uart", "--brief", stdin=bytes([*frame, check]))
        assert code == 0, err
        assert out.splitlines()[0].split(maxsplit=2)[2].startswith(f"{ends}, APP: ")


@pytest.mark.parametrize("stdin", [CONNECT + b"hello", b"hello" + CONNECT, CONNECT[:4], bytes(40)])
def test_what_makes_some_sense_is_no_error(stdin: bytes) -> None:
    assert dissect("-", stdin=stdin)[0] == 0


@pytest.mark.parametrize(("words", "stdin"), [([], b""), (["--hex"], b"  # nothing\n"), (["--framing", "tcp"], b"")])
def test_an_empty_capture_is_no_guess(words: list[str], stdin: bytes) -> None:
    assert dissect("-", *words, stdin=stdin) == (2, "", "host: -: empty: there is not one byte to dissect\n")


@pytest.mark.parametrize(
    ("scenario", "framing", "about"),
    [
        ("nanocockpit", "nanocockpit", "image, bytes 0..4075 of 25748"),
        ("nanocockpit?wire=uart1", "stamps", "NanoCockpit's state"),
        ("paper", "tcp", "image header of the paper's firmware"),
        ("paper?wire=uart1", "stamps", "time message of the paper's firmware"),
    ],
)
def test_recordings_of_other_firmware(scenario: str, framing: str, about: str, tmp_path: Path) -> None:
    file = tmp_path / "flight.mcap"
    port = f"sim://{scenario}{'&' if '?' in scenario else '?'}pace=max"
    words = ["stream", "--port", port, "--duration", "0.6", "--record", str(file)]
    subprocess.run([sys.executable, "-m", "host", *words], cwd=ROOT, check=True, capture_output=True, timeout=120)
    code, out, err = dissect(str(file), "--json")
    assert code == 0, err
    *pieces, summary = [json.loads(line) for line in out.splitlines()]
    assert summary["framing"] == framing
    assert about in [piece["about"] for piece in pieces]
    assert {piece["event"] for piece in pieces[:-1]} <= {"packet", "stamp"}


def test_without_construct_it_says_what_to_install() -> None:
    code = "import sys; sys.modules['construct'] = None; from host.cli import main; sys.exit(main(['dissect', '-']))"
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, timeout=60)
    assert result.returncode == 2, result.stderr
    assert "pip install 'spindeck[spec]'" in result.stderr


def test_a_reader_that_has_enough() -> None:
    credits_ = f"{sys.executable} -c 'import sys; sys.stdout.buffer.write(bytes([255, 0]) * 100000)'"
    command = f"{credits_} | {sys.executable} -m host dissect - --framing cpx-uart --json | head -1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, cwd=ROOT, timeout=120)
    assert json.loads(result.stdout)["event"] == "credit"
    assert result.stderr == ""
