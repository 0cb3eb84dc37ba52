"""Robots served as serial ports: what a host sees that opens them with pyserial."""

import contextlib
import os
import time

import serial
from serving import replayed, served, whats

import host
from host.link.frame import Frame
from host.link.records import Stamp
from host.native import lib
from sim.serial.doors import PtyDoor, hung_up


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


def test_frames_over_uart2_and_the_same_bytes_in_process(monkeypatch):
    with served("hover", pty=True, pace="real", camera_encoding="jpeg", seed=6) as server:
        path = server.stations[0].door.url
        with host.open(path, dialect="native") as stream:
            frames = [frame for frame, _ in zip(stream, range(5), strict=False)]
            counters = stream.counters
        assert frames[-1].native, "it was asked for, so the host's bytes came through"
        # Nothing at the start. A busy computer may pause in the middle of a packet, which is then given up.
        assert counters.garbage_bytes <= counters.gaps * lib.CPX_UART_FRAME_MAX
        until(lambda: "went" in whats(server))
        given = server.stations[0].bytes_to_clients
    again, read = replayed(server, monkeypatch)
    assert again.trace_hash() == server.world.trace_hash()
    assert given >= counters.bytes > 10_000
    assert len(read[0]) >= given


def test_stamps_of_uart1_begin_with_the_first():
    with served("hover", pty=True, wire="uart1", pace="real") as server:
        path = server.stations[0].door.url
        time.sleep(0.1)
        assert server.world.now_ns == 0
        with host.open(path, framing="stamps") as stream:
            stamps = []
            for event in stream.events():
                stamps += [event] if isinstance(event, Stamp) else []
                if len(stamps) == 20:
                    break
            assert stream.counters.garbage_bytes == 0
    first = stamps[0].sequence
    assert [stamp.sequence for stamp in stamps] == list(range(first, first + 20))
    assert first == 0


def test_a_reader_that_comes_back():
    with served("hover", pty=True, pace="real", camera_encoding="jpeg") as server:
        path = server.stations[0].door.url
        for rounds in (1, 2, 3):
            with host.open(path) as stream:
                assert any(isinstance(event, Frame) for event in stream.events())
            until(lambda n=rounds: whats(server).count("went") == n)
    assert server.stations[0].clients == 3


def test_nothing_of_one_reader_is_left_for_the_next():
    door = PtyDoor()
    try:
        assert door.accept() is None
        with serial.Serial(door.url):
            until(lambda: (client := door.accept()) is not None and client.send(memoryview(b"old")))
        until(lambda: door.accept() is None and hung_up(door._master))
        slave = os.open(door.url, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        with contextlib.suppress(BlockingIOError):
            assert os.read(slave, 10) == b""
        until(lambda: door.accept() is not None)
        os.write(slave, b"x")
        os.close(slave)
    finally:
        door.close()


def test_bytes_pass_unchanged():
    """No terminal's line discipline in between: not even before pyserial has set the port up."""
    everything = bytes(range(256))
    door = PtyDoor()
    slave = os.open(door.url, os.O_RDWR | os.O_NOCTTY)
    try:
        os.write(slave, everything)
        client = None
        while client is None:
            client = door.accept()
        got = b""
        while len(got) < 256:
            got += client.receive(1000) or b""
        assert got == everything
        assert client.send(memoryview(everything)) == 256
        assert os.read(slave, 1000) == everything
    finally:
        os.close(slave)
        door.close()
