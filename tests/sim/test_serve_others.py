"""Clients that know nothing of this project: an unmodified Bitcraze CPX client, and the loop of the official viewer."""

import hashlib
import importlib.util
import json
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from serving import connected, replayed, served

from host.link.frame import Frame
from host.link.session import Session

CLIENT = Path(__file__).with_name("cflib_client.py")
NAMES = {4: "GAP8", 1: "STM32"}


def bodies_sent(server, encoding="raw"):
    """What the camera saw, in order: each completed capture's picture."""
    (pictures,) = server.world.pictures.values()
    return [getattr(pictures, encoding)[row["image"]] for row in server.world.truth]


def exactly(connection, size):
    data = bytearray()
    while len(data) < size:
        data += connection.recv(size - len(data)) or pytest.fail("the connection ended")
    return bytes(data)


def as_the_viewer(connection, count):
    """The official viewer's loop: four bytes, a header of eleven whatever came, then payloads without a look at their
    route until there are enough. Anything unexpected breaks it."""
    frames = []
    for _ in range(count):
        length, _, _ = struct.unpack("<HBB", exactly(connection, 4))
        header = struct.unpack("<BHHBBI", exactly(connection, length - 2))
        assert header[0] == 0xBC
        body = bytearray()
        while len(body) < header[5]:
            length, _, _ = struct.unpack("<HBB", exactly(connection, 4))
            body += exactly(connection, length - 2)
        frames.append((header, bytes(body)))
    return frames


@pytest.mark.parametrize("firmware", ["stock", "native"])
@pytest.mark.parametrize("encoding", ["raw", "jpeg"])
def test_the_official_viewers_loop_gets_every_frame(firmware, encoding):
    """The native firmware too, as long as nobody asks it: its announcement disturbs no viewer."""
    with (
        served("stock", firmware=firmware, camera_encoding=encoding, seed=11) as server,
        connected(server) as connection,
    ):
        frames = as_the_viewer(connection, 20)
    sent = bodies_sent(server, encoding)
    kind = {"raw": 0, "jpeg": 1}[encoding]
    assert [header for header, _ in frames] == [(0xBC, 324, 244, 1, kind, len(body)) for body in sent[:20]]
    assert [body for _, body in frames] == sent[:20]


def test_stock_sends_what_the_stock_firmware_sends_whatever_it_is_asked():
    requests = [
        *(bytes.fromhex(route) + bytes([0xA5, kind]) + bytes(30) for route in ("1c05", "1a05") for kind in range(8)),
        bytes.fromhex("19012101"),
    ]
    with served("stock", seed=2, crtp_hz=20) as server, connected(server) as connection:
        for request in requests:
            connection.sendall(struct.pack("<H", len(request)) + request)
        routes = set()
        frames = left = 0
        while frames < 6:
            length, low, high = struct.unpack("<HBB", exactly(connection, 4))
            data = exactly(connection, length - 2)
            routes.add((NAMES[low >> 3 & 7], low & 7, low >> 7, high))
            if high != 5:
                continue
            if left == 0:
                magic, _, _, _, _, left = struct.unpack("<BHHBBI", data)
                assert magic == 0xBC
                frames += 1
            else:
                left -= len(data)
                assert left >= 0
    host, app, crtp = 3, 5, 3
    assert routes == {("GAP8", host, 0, app), ("STM32", host, 0, crtp)}


@pytest.mark.skipif(
    importlib.util.find_spec("cflib") is None, reason="cflib is not installed: pip install --no-deps cflib==0.1.34"
)
@pytest.mark.parametrize("bridge", [False, True])
def test_an_unmodified_bitcraze_client_gets_every_frame(bridge, monkeypatch):
    """Every one that the robot sends: by the wall clock, as with pace=max they come before cflib has its queues."""
    count = 8
    with served("stock", pace="real", seed=4, crtp_hz=10, wifi_up_ms=1000) as server:
        port = server.stations[0].door.port
        result = subprocess.run(
            [sys.executable, str(CLIENT), str(port), str(count), str(int(bridge))],
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert result.returncode == 0, result.stderr
        assert result.stderr == ""
    lines = [json.loads(line) for line in result.stdout.splitlines() if line.startswith("{")]
    _, read = replayed(server, monkeypatch)
    events = Session("tcp", "stock").receive(bytes(read[0]), 0)
    sent = [bytes(event.body) for event in events if isinstance(event, Frame)]
    assert set(sent) <= set(bodies_sent(server))
    assert lines[:count] == [
        {"header": [0xBC, 324, 244, 1, 0, len(body)], "sha256": hashlib.sha256(body).hexdigest()}
        for body in sent[:count]
    ]
    assert [line["source"] for line in lines[count:]] == ["STM32"] * bridge
