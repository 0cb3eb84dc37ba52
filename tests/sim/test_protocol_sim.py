"""sim:// through pyserial: what a host's code sees of it."""

import gc
import itertools
import threading
import time

import pytest
import serial

import host
from host.link.frame import Frame
from host.link.records import Stamp
from host.link.session import Session
from host.protocol.errors import LocalError
from sim import scenario
from sim.serial import protocol_sim
from sim.world import World

serial.protocol_handler_packages.append("sim.serial")


def opened(url, **arguments):
    return serial.serial_for_url(url, **arguments)


def frames(port, count, dialect="native"):
    """Reads as a host does, until so many frames are there."""
    session = Session(port.framing, dialect)
    found = []
    while len(found) < count:
        port.write(session.data_to_send())
        data = port.read(max(1, port.in_waiting))
        events = session.receive(data, port.clock_ns())
        assert session.counters.garbage_bytes == session.counters.stray_packets == 0
        found += [event for event in events if isinstance(event, Frame) and (event.native or dialect == "stock")]
    return found


def test_frames_come_and_carry_true_time():
    with opened("sim://hover?pace=max&seed=7") as port:
        found = frames(port, 5)
    assert [frame.index - found[0].index for frame in found] == [0, 1, 2, 3, 4]
    assert 0.38e9 < found[4].arrival_host_ns - found[0].arrival_host_ns < 0.42e9
    assert len(port.world.truth) >= 5, "the truth outlives the port"


@pytest.mark.parametrize(("wire", "framing"), [("tcp", "tcp"), ("uart2", "cpx-uart"), ("uart1", "stamps")])
def test_framing_follows_the_wire(wire, framing):
    with opened(f"sim://hover?pace=max&wire={wire}") as port:
        assert port.framing == framing
        assert port.read(20)


def test_the_same_url_gives_the_same_bytes():
    def run():
        with opened("sim://lossy?pace=max&seed=3") as port:
            return port.read(300_000)

    first = run()
    assert len(first) == 300_000
    assert run() == first


def test_one_byte_reads_give_the_same_bytes():
    with opened("sim://hover?pace=max&camera_width=32&camera_height=8") as port:
        whole = port.read(3000)
    with opened("sim://hover?pace=max&camera_width=32&camera_height=8") as port:
        assert b"".join(port.read() for _ in range(3000)) == whole


def read_at_each_arrival(url, dialect, count):
    """What the same host makes of it that reads at the very instant when bytes come."""
    made = scenario.from_url(url)
    session = Session(protocol_sim.FRAMINGS[made.robots[0].wire], dialect)
    events = []
    with World(made) as world:
        robot = world.robots[0]
        robot.connect()
        while sum(isinstance(event, Frame | Stamp) for event in events) < count:
            robot.write(session.data_to_send())
            world.run_until(world.now_ns + 100_000_000, 0, 1)
            data = robot.read()
            if data:
                events += session.receive(data, world.now_ns)
            else:
                session.tick(world.now_ns)
            robot.write(session.data_to_send())
    return events


def times(events, of_frames):
    """Of frames and stamps, or of everything else."""
    return [
        (type(event).__name__, event.arrival_host_ns)
        for event in events
        if isinstance(event, Frame | Stamp) == of_frames
    ]


@pytest.mark.parametrize(
    ("scenario_keys", "dialect"),
    [
        ("hover?seed=7", "native"),
        ("hover?seed=7&camera_encoding=jpeg&crtp_hz=100&tcp_bytes_per_s=300000", "native"),
        ("hover?seed=8", "stock"),
        ("lossy?seed=5", "native"),
        ("paper?seed=2", "paper"),
        ("nanocockpit?seed=2", "nanocockpit"),
        ("hover?seed=7&wire=uart1", "stock"),
    ],
)
def test_a_frame_has_the_time_when_its_last_byte_came(scenario_keys, dialect):
    """Though the port reads a frame in few pieces. Other packets that overtake it may have waited for 5 ms."""
    url = f"sim://{scenario_keys}&pace=max"
    expected = read_at_each_arrival(url, dialect, 20)
    with host.open(url, dialect=dialect) as stream:
        events = list(itertools.islice(stream.events(), len(expected)))
    frames, frames_expected = times(events, True), times(expected, True)
    others, others_expected = times(events, False), times(expected, False)
    assert frames == frames_expected
    assert len(frames) >= 19
    assert [name for name, _ in others] == [name for name, _ in others_expected]
    assert all(0 <= came - then <= 5_000_000 for (_, came), (_, then) in zip(others, others_expected, strict=True))


def test_a_frame_is_read_in_few_pieces():
    """55 segments."""
    with opened("sim://hover?pace=max&spi_hz=20000000") as port:
        session = Session("tcp", "stock")
        reads = found = 0
        while found < 10:
            events = session.receive(port.read_some(session.bytes_wanted), port.clock_ns())
            found += sum(isinstance(event, Frame) for event in events)
            reads += 1
    assert reads < 150


def test_timeout_counts_simulated_seconds():
    with opened("sim://hover?pace=max&camera_fps=0&tcp_loss=1&tcp_rto_ms=60000", timeout=100) as port:
        assert port.read(10) == b""
        assert port.clock_ns() == 100_000_000_000
        port.timeout = 0
        assert port.read(10) == b""
        assert port.clock_ns() == 100_000_000_000


def test_real_pace_is_never_ahead_of_the_wall():
    started_s = time.monotonic()
    with opened("sim://hover?pace=real&wifi_up_ms=10", timeout=5) as port:
        for _ in range(20):
            assert port.read(100)
            assert port.clock_ns() <= (time.monotonic() - started_s) * 1e9
        port.timeout = 0.05
        port.read(1_000_000)
        assert port.clock_ns() <= (time.monotonic() - started_s) * 1e9


def test_who_only_looks_does_not_wait_for_ever():
    with opened("sim://hover?pace=max") as port:
        for _ in range(5000):
            if port.in_waiting:
                break
        assert port.in_waiting
        port.reset_input_buffer()


def test_robots_share_a_world():
    with opened("sim://swarm?pace=max&robot=0") as a, opened("sim://swarm?pace=max&robot=2") as b:
        assert a.world is b.world
        assert frames(a, 3)
        assert frames(b, 3), "in one thread: the other's ring fills and TCP's window closes"
        assert a.clock_ns() == b.clock_ns()
    with opened("sim://swarm?pace=max&robot=0&seed=2") as a, opened("sim://swarm?pace=max&robot=2") as b:
        assert a.world is not b.world, "another seed is another world"


def test_what_one_port_left_unread_is_nothing_for_the_next():
    with opened("sim://swarm?pace=max&robot=1") as other:
        with opened("sim://swarm?pace=max&robot=0") as port:
            assert len(port.read(5)) == 5, "inside a packet"
            other.read(200_000)
            assert port.in_waiting > 10_000
        with opened("sim://swarm?pace=max&robot=0") as port:
            assert port.world is other.world
            (frame,) = frames(port, 1, "stock")
            assert frame.index == 0
            assert not frame.native


def test_a_robot_has_one_port():
    with opened("sim://hover?pace=max") as a, opened("sim://hover?pace=max") as b:
        assert a.world is not b.world
        assert frames(a, 2)[1].arrival_host_ns == frames(b, 2)[1].arrival_host_ns


def test_a_world_ends_with_its_last_port():
    port = opened("sim://hover?pace=max&seed=99")
    first = port.world
    first.run(1)
    port.close()
    with opened("sim://hover?pace=max&seed=99") as again:
        assert again.world is not first
        assert again.clock_ns() == 0
    port = opened("sim://hover?pace=max&seed=98")
    del port
    gc.collect()
    assert not any('"seed": 98' in shared.key for shared in protocol_sim._worlds)


def test_threads_read_their_own_robots_and_none_is_left_behind(monkeypatch):
    monkeypatch.setattr(protocol_sim, "AHEAD_S", 60)  # this machine may be slow, and that is not the question
    ports = [opened(f"sim://swarm?pace=max&robot={index}") for index in range(4)]
    results = {}

    def read(index):
        results[index] = frames(ports[index], 20)

    threads = [threading.Thread(target=read, args=(index,)) for index in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert sorted(results) == [0, 1, 2, 3]
    truth = ports[0].world.truth
    for index in range(4):
        numbers = [frame.native.frame for frame in results[index]]
        assert numbers == list(range(numbers[0], numbers[0] + 20)), f"robot {index} dropped frames for a slow host"
        assert len(truth[truth["robot"] == index]) >= 20
    for port in ports:
        port.close()


def test_a_reader_that_has_stopped_holds_up_nobody_for_long(monkeypatch):
    monkeypatch.setattr(protocol_sim, "AHEAD_S", 0.05)
    a, b = (opened(f"sim://swarm?pace=max&robot={index}") for index in range(2))
    reader = threading.Thread(target=a.read, args=(10,))
    reader.start()
    reader.join(10)
    assert len(frames(b, 30)) == 30
    a.close()
    b.close()


def test_cancel_read_and_close_end_a_read():
    for end in ("cancel_read", "close"):
        port = opened("sim://hover?pace=real&camera_fps=0&wifi_up_ms=600000")
        result = []
        reader = threading.Thread(target=lambda port=port, result=result: result.append(port.read(10)))
        reader.start()
        while port.reader is None:
            time.sleep(0.001)
        getattr(port, end)()
        reader.join(10)
        assert result == [b""], end
        port.close()


def test_a_connection_that_the_robot_loses_is_an_error():
    with opened("sim://hover?pace=max") as port:
        frames(port, 2)
        port.world.robots[0].reboot("esp32", 0.1)
        port.reset_input_buffer()
        with pytest.raises(serial.SerialException, match="closed the connection"):
            port.read(1)
        with pytest.raises(serial.SerialException, match="closed the connection"):
            port.write(b"x")


def test_a_write_longer_than_the_wire_takes_at_once():
    with opened("sim://hover?pace=max&tcp_bytes_per_s=100000000") as port:
        assert port.write(bytes(300_000)) == 300_000
        port.write_timeout = 0.0
        assert 0 < port.write(bytes(1_000_000)) < 1_000_000
        with pytest.raises(serial.SerialTimeoutException):
            port.write(b"x")


def test_closed():
    port = opened("sim://hover", do_not_open=True)
    for act in (lambda: port.read(1), lambda: port.write(b"x"), lambda: port.in_waiting, port.clock_ns):
        with pytest.raises(serial.PortNotOpenError):
            act()
    port.close()
    port.open()
    with pytest.raises(serial.SerialException, match="already open"):
        port.open()
    port.close()


@pytest.mark.parametrize("url", ["sim://hoover", "sim://hover?gap8_pmm=1", "sim://hover?camera=/nowhere"])
def test_bad_urls(url):
    with pytest.raises(LocalError):
        opened(url)
    assert not any(not shared.ports for shared in protocol_sim._worlds)
