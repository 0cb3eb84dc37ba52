"""A dialect that was chosen and is not what the robot speaks: told at its first whole frame, however reads cut it."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator

import pytest
from made_streams import (
    ANNOUNCING,
    GAP8_TO_HOST_CONSOLE,
    nanocockpit,
    nanocockpit_packet,
    native,
    packet,
    paper,
    paper_stamp,
    pixels,
    received,
    state_message,
    stock,
)

import host
from host.cli import main
from host.link.dialects import Dialect
from host.link.frame import Frame
from host.link.session import Session
from host.protocol.errors import PeerError, PeerSilentError

BODY = pixels(12, 7, 1)
HELLO = packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE)
STREAMS: dict[Dialect, bytes] = {
    "stock": b"".join(stock(BODY, 12, 7, piece=17)),
    "paper": b"".join(paper(BODY, 12, 7, 5, piece=17)),
    "nanocockpit": b"".join(nanocockpit(BODY, 12, 7, 5, piece=180)),
    "native": b"".join(native(5, BODY, 12, 7, piece=17)),
}
ANNOUNCED = b"".join(stock(BODY, 12, 7, piece=17, route=ANNOUNCING)[:1])
CHOICES: list[Dialect] = ["paper", "nanocockpit", "native"]


@pytest.mark.parametrize("spoken", STREAMS)
@pytest.mark.parametrize("chosen", ["auto", "stock", *CHOICES])
def test_every_choice_with_every_firmware(chosen: Dialect, spoken: Dialect) -> None:
    _, session = received(STREAMS[spoken], dialect=chosen)
    wrong = chosen in CHOICES and chosen != spoken
    assert session.expected.other == (spoken if wrong else None)
    told = session.expected.contradiction()
    assert bool(told) == wrong
    if wrong:
        assert f"dialect {chosen} was chosen" in told
        assert f"use --dialect {spoken} or auto" in told


@pytest.mark.parametrize(
    ("chosen", "spoken"), [("nanocockpit", "stock"), ("paper", "nanocockpit"), ("native", "stock")]
)
def test_it_does_not_depend_on_how_reads_cut_the_bytes(chosen: Dialect, spoken: Dialect) -> None:
    stream = b"\x01\x02\x03" + STREAMS[spoken] * 2
    for size in (1, 7, 100):
        _, session = received(stream, range(size, len(stream), size), dialect=chosen)
        assert session.expected.other == spoken


@pytest.mark.parametrize(("chosen", "other"), [("native", None), ("paper", "native"), ("nanocockpit", "native")])
def test_stock_frames_that_announce_native_are_native_firmware(chosen: Dialect, other: Dialect | None) -> None:
    stream = ANNOUNCED + STREAMS["stock"][len(ANNOUNCED) :] + STREAMS["stock"]
    _, session = received(stream, dialect=chosen)
    assert session.expected.other == other


@pytest.mark.parametrize("chosen", CHOICES)
def test_what_was_right_once_is_not_doubted_again(chosen: Dialect) -> None:
    for other in STREAMS.values():
        _, session = received(STREAMS[chosen] + other, dialect=chosen)
        assert session.expected.other is None


def test_half_a_frame_and_text_do_not_tell() -> None:
    for stream in (HELLO * 5, STREAMS["stock"][:-1], b"\x55" * 500):
        for chosen in CHOICES:
            session = Session("tcp", chosen)
            session.receive(stream, 1)
            assert session.expected.other is None


def test_time_messages_tell_too() -> None:
    stamp = b"\xd5\x2a" + struct.pack("<IQB", 1, 2, 3)
    crc = 0xFFFF
    for byte in stamp[2:]:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ (0x1021 if crc & 0x8000 else 0)) & 0xFFFF
    messages: dict[Dialect, bytes] = {
        "native": stamp + struct.pack("<H", crc),
        "paper": paper_stamp(7),
        "nanocockpit": state_message(),
    }
    for chosen in CHOICES:
        for spoken, message in messages.items():
            _, session = received(message, framing="stamps", dialect=chosen)
            assert session.expected.other == (None if chosen == spoken else spoken)


@contextlib.contextmanager
def robot(data: bytes) -> Iterator[str]:
    """Sends that, and then nothing."""
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def run() -> None:
            connection, _ = listening.accept()
            with connection, contextlib.suppress(OSError):
                connection.sendall(data)
                while connection.recv(4096):
                    pass

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"socket://127.0.0.1:{listening.getsockname()[1]}"
        thread.join(timeout=10)


def test_the_stream_ends_with_an_error_of_the_peer() -> None:
    with robot(STREAMS["stock"]) as url, host.open(url, dialect="nanocockpit") as stream:
        with pytest.raises(PeerError, match="stock CPX") as raised:
            next(iter(stream))
        assert not isinstance(raised.value, PeerSilentError)


@pytest.mark.parametrize(
    ("chosen", "data", "looks"),
    [
        ("nanocockpit", HELLO * 3, "CPX"),
        (
            "native",
            nanocockpit_packet(b"hello\n\0", GAP8_TO_HOST_CONSOLE) + STREAMS["nanocockpit"][:-30],
            "NanoCockpit's",
        ),
    ],
)
def test_packets_without_an_image_are_told_apart_when_it_falls_silent(chosen: Dialect, data: bytes, looks: str) -> None:
    with robot(data) as url, host.open(url, dialect=chosen, timeout=0.3) as stream:
        with pytest.raises(PeerError, match=f"look like {looks}") as raised:
            next(iter(stream))
        assert not isinstance(raised.value, PeerSilentError)


@pytest.mark.parametrize("data", [b"", b"\x55" * 500, STREAMS["nanocockpit"][:-30]])
def test_silence_stays_silence(data: bytes) -> None:
    with (
        robot(data) as url,
        host.open(url, dialect="nanocockpit", timeout=0.3) as stream,
        pytest.raises(PeerSilentError),
    ):
        next(iter(stream))


@pytest.mark.parametrize(
    ("port", "dialect", "says"),
    [
        ("sim://stock", "nanocockpit", "these bytes are stock CPX"),
        ("sim://stock", "native", "use --dialect stock or auto"),
        ("sim://hover", "paper", "of firmware that speaks native"),
        ("sim://nanocockpit", "native", "NanoCockpit's"),
        ("sim://hover?wire=uart2", "paper", "use --dialect native or auto"),
        ("sim://paper?wire=uart1", "nanocockpit", "of the paper's firmware"),
    ],
)
def test_the_command(port: str, dialect: str, says: str, capsys: pytest.CaptureFixture[str]) -> None:
    port += f"{'&' if '?' in port else '?'}pace=max"
    assert main(["stream", "--port", port, "--dialect", dialect, "--count", "1", "--json"]) == 4
    out, err = capsys.readouterr()
    assert says in err
    assert err.count("\n") == 1
    assert says in out.splitlines()[-1]  # the summary
    assert '"event":"frame"' not in out


@pytest.mark.parametrize(("port", "dialect"), [("hover", "native"), ("paper", "paper"), ("nanocockpit", "stock")])
def test_the_right_choice_and_the_one_that_reads_everything(port: str, dialect: Dialect) -> None:
    with host.open(f"sim://{port}?pace=max", dialect=dialect) as stream:
        assert isinstance(next(iter(stream)), Frame)
