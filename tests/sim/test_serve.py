"""Robots served on TCP: the same bytes as in-process, clients that come, go, hang and vanish."""

import contextlib
import socket
import threading
import time

import pytest
from serving import Listener, connected, replayed, served, whats

from host.protocol.errors import LocalError
from sim.serial import doors, serve
from sim.world import World


def until(condition, seconds=30.0):
    """Waits for another thread."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.mark.parametrize("pace", ["real", "max"])
def test_a_client_gets_what_the_same_run_gives_in_process(pace, monkeypatch):
    with served("hover", pace=pace, seed=7) as server:
        with connected(server) as connection:
            client = Listener(connection)
            client.listen(8)
        assert any(frame.native for frame in client.frames), "it was asked for, so the host's bytes came through"
        until(lambda: "went" in whats(server))
    again, read = replayed(server, monkeypatch)
    assert again.trace_hash() == server.world.trace_hash()
    assert len(client.came) > 600_000
    assert read[0][: len(client.came)] == client.came


def test_time_begins_with_the_first_client():
    with served("hover", pace="real") as server:
        time.sleep(0.1)
        assert server.world.now_ns == 0
        with connected(server):
            until(lambda: server.world.now_ns > 0)
    assert server.world.log[1]["do"] == "connect"
    assert server.world.log[1]["t"] == 0


def test_a_client_comes_back_without_a_power_cycle_and_gets_nothing_old(monkeypatch):
    with served("hover", seed=3) as server:
        for round_ in range(3):
            with connected(server) as connection:
                client = Listener(connection, "stock")
                client.listen(2 + round_)
                counters = client.session.counters
            assert sum(counters.frames_lost.values()) == counters.garbage_bytes == 0
            assert client.session.counters.packets.get("other", 0) == 0
            until(lambda n=round_: whats(server).count("went") == n + 1)
    assert server.world.robots[0].stm32["stamps_sent"] > 50, "never booted again"
    again, _ = replayed(server, monkeypatch)
    assert again.trace_hash() == server.world.trace_hash()


def test_a_second_client_is_told_at_once_and_the_first_does_not_notice():
    with served("hover", seed=3, firmware="stock") as server, connected(server) as connection:
        client = Listener(connection, "stock")
        client.listen(2)
        with connected(server) as second:
            assert second.recv(100) == b""
        client.listen(5)
        assert len(client.frames) == 5
        assert client.session.counters.garbage_bytes == 0
    assert server.stations[0].refused == 1
    assert whats(server)[:2] == ["came", "refused"]


def test_four_robots_and_a_client_that_stops_reading(monkeypatch):
    """The others' frames keep coming, all of them; the one that nobody reads drops whole frames and comes back."""
    with served("swarm", pace="real", camera_fps=10, tcp_bytes_per_s=2_000_000) as server:
        clients = [Listener(connected(server, robot), "stock") for robot in range(4)]
        threads = [threading.Thread(target=client.listen, args=(20,)) for client in clients[1:]]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(timeout=60)
        assert [len(client.frames) for client in clients[1:]] == [20, 20, 20]
        counters = [robot.esp32 for robot in server.world.robots[1:]]
        lost = [client.session.counters.frames_lost for client in clients[1:]]
        until(lambda: server.world.robots[0].esp32["frames_dropped"] > 3)
        clients[0].listen(12)
        assert len(clients[0].frames) == 12, "it goes on as soon as somebody reads"
        assert sum(clients[0].session.counters.frames_lost.values()) == 0, "whole frames or none"
        for client in clients:
            client.connection.close()
    for each in counters:
        assert each["frames_dropped"] <= 0.2 * each["frames_forwarded"]
    assert all(sum(each.values()) == 0 for each in lost)
    again, read = replayed(server, monkeypatch)
    assert again.trace_hash() == server.world.trace_hash(), "slow readers are repeated too"
    for robot, client in enumerate(clients):
        assert read[robot][: len(client.came)] == client.came


def test_a_client_that_hangs_makes_room_for_another(monkeypatch):
    monkeypatch.setattr(serve, "STUCK_S", 0.05)
    with served("hover", tcp_window=20_000, camera_fps=15) as server, connected(server) as hanging:
        until(lambda: server.stations[0].to_client and time.monotonic() - server.stations[0].moved_s > 0.05)
        with connected(server) as connection:
            client = Listener(connection, "stock")
            client.listen(2)
            assert len(client.frames) == 2
        hanging.settimeout(10)
        while hanging.recv(1 << 16):
            pass  # its end comes
    assert whats(server)[:3] == ["came", "replaced", "came"]


def test_a_client_that_resets_its_connection_ends_nothing_else():
    with served("hover", robots=2) as server:
        rude = connected(server, 0)
        rude.recv(1000)
        rude.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
        rude.close()
        until(lambda: "went" in whats(server))
        with connected(server, 1) as connection:
            client = Listener(connection)
            client.listen(3)
            assert len(client.frames) == 3


def test_a_robot_that_ends_the_connection_ends_the_clients_and_takes_the_next():
    with served("hover", pace="real") as server:
        with connected(server) as connection:
            Listener(connection, "stock").listen(2)
            # As the STM32 may: new settings for the Wi-Fi, so that the network goes and comes.
            connection.sendall(bytes.fromhex("0c 00 1a 04 10") + b"spindeck2" + bytes.fromhex("04 00 1a 04 20 01"))
            while connection.recv(1 << 16):
                pass
        with connected(server) as connection:
            client = Listener(connection, "stock")
            client.listen(2)
            assert len(client.frames) == 2
    assert whats(server)[:3] == ["came", "ended", "came"]


def test_garbage_from_a_client_is_the_robots_to_count():
    with served("hover", seed=5) as server, connected(server) as connection:
        connection.sendall(bytes(range(256)) * 40)
        client = Listener(connection, "stock")
        client.listen(3)
        assert len(client.frames) == 3
    assert server.world.robots[0].esp32["tcp_rx_skipped_bytes"] > 0


def test_a_computer_that_was_asleep_does_not_catch_up():
    with served("hover", pace="real") as server, connected(server) as connection:
        client = Listener(connection, "stock")
        client.listen(1)
        before_ns = server.world.now_ns
        server._started_ns -= 3600 * 10**9
        client.listen(3)
        assert server.times_late >= 1
        assert server.world.now_ns - before_ns < 60 * 10**9


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("127.0.0.1:5000", ("127.0.0.1", 5000)),
        ("127.0.0.1", ("127.0.0.1", 5000)),
        ("localhost:0", ("localhost", 0)),
        ("[::1]:6000", ("::1", 6000)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),
    ],
)
def test_addresses(text, means):
    assert doors.address(text) == means


@pytest.mark.parametrize("text", ["", "5000", ":5000", "::1:5000", "a:b", "127.0.0.1:65536", "127.0.0.1:-1", "x y:z"])
def test_bad_addresses(text):
    with pytest.raises(LocalError, match="write ADDRESS:PORT"):
        doors.address(text)


def test_places_where_nobody_can_listen():
    with contextlib.closing(doors.TcpDoor("127.0.0.1", 0)) as taken, pytest.raises(LocalError, match="in use"):
        doors.TcpDoor("127.0.0.1", taken.port)
    with pytest.raises(LocalError, match="no address of this computer"):
        doors.TcpDoor("192.0.2.1", 5000)
    with pytest.raises(LocalError, match="no such address"):
        doors.TcpDoor("no-such-host.invalid", 5000)
    with pytest.raises(LocalError, match="none after 65535"):
        doors.TcpDoor("127.0.0.1", 65536)


def test_a_world_without_a_log_says_so():
    with World("hover", keep_log=False) as world:
        world.robots[0].connect()
        world.run(1)
        assert world.robots[0].read()
        with pytest.raises(LocalError, match="keep_log"):
            _ = world.log
