"""SPI loses the message that a client has gone, and another one comes: it must get stock frames, and nothing else.

The clients here decode by hand, and as strictly as viewers do: any byte that stock firmware does not send breaks them.
"""

import random
import struct

import pytest

from host.link.frame import Frame
from host.link.session import Session
from host.native import lib
from sim.world import World

MS = 1_000_000
SETTINGS = {"camera_width": 102, "camera_height": 40, "camera_fps": 15}
HEADER = struct.pack("<BHHBBI", 0xBC, 102, 40, 1, 0, 4080)
PACKETS_BY_SIZE = [11, 1020, 1020, 1020, 1020]
FRAME_S = 1 / 15


def streams_native(world, seconds=1.5):
    """A client that asks at once, and gets what it asks for."""
    robot = world.robots[0]
    robot.connect()
    session = Session("tcp", "native")
    frames = []
    end_ns = world.now_ns + int(seconds * 1e9)
    while world.now_ns < end_ns:
        robot.write(session.data_to_send())
        world.run_until(world.now_ns + 5 * MS)
        frames += session.receive(robot.read(), world.now_ns)
    assert [event for event in frames if isinstance(event, Frame)][-1].native
    assert lib.kernel_gap8(world.kernel, 0).stream.dialect == 1


def frames_of_a_stock_stream(data, pictures):
    """How many whole frames: it must be nothing but frames, the last one perhaps not complete."""
    count = 0
    while data:
        body = b""
        for size in PACKETS_BY_SIZE:
            packet, data = data[: 4 + size], data[4 + size :]
            if len(packet) < 4 + size:
                return count
            length, low, function = struct.unpack("<HBB", packet[:4])
            # Only the header's route announces that native could be had.
            assert (length, low, function) == (size + 2, 0xE3 if size == 11 else 0x63, 5), packet[:16].hex()
            assert size != 11 or packet[4:] == HEADER, packet.hex()
            body += packet[4:]
        assert body[11:] in pictures
        count += 1
    return count


def pictures_of(world):
    return {bytes(raw) for raw in world.pictures[0].raw}


def spi_is_idle(world):
    """Lets pass what the ESP32 has to say to the GAP8."""
    esp32 = lib.kernel_esp32(world.kernel, 0)
    for _ in range(1000):
        world.run_until(world.now_ns + MS // 10)
        if esp32.to_spi.fill == 0 and lib.kernel_gap8(world.kernel, 0).sending < 0:
            world.run_until(world.now_ns + 3 * MS)  # the window under way
            return
    pytest.fail("SPI is never idle")


@pytest.mark.parametrize("lost", ["gone", "gone and here", "all for half a second"])
@pytest.mark.parametrize("seed", range(6))
def test_a_new_client_gets_stock_though_the_gap8_has_not_heard_of_it(lost, seed):
    with World("hover", seed=seed, **SETTINGS) as world:
        robot, pictures = world.robots[0], pictures_of(world)
        streams_native(world, 1.5 + random.Random(seed).uniform(0, FRAME_S))
        robot.set_faults("spi_to_gap8", loss=1)
        robot.disconnect()
        if lost == "gone":
            spi_is_idle(world)
            robot.set_faults("spi_to_gap8", loss=0)
        robot.connect()
        if lost == "gone and here":
            spi_is_idle(world)
            robot.set_faults("spi_to_gap8", loss=0)
        gap8 = lib.kernel_gap8(world.kernel, 0)
        assert gap8.client, "it has heard"
        assert gap8.stream.dialect == 1, "it has heard"
        data = b""
        if lost == "all for half a second":
            for _ in range(50):
                world.run_until(world.now_ns + 10 * MS)
                data += robot.read()
            assert data == b""
            assert robot.esp32["frames_unasked"] >= 5
            robot.set_faults("spi_to_gap8", loss=0)
        # One frame is held back, and the next capture comes whole.
        world.run(3 * FRAME_S)
        data += robot.read()
        assert frames_of_a_stock_stream(data, pictures) >= 1
        assert gap8.stream.dialect == 0
        held = robot.esp32["frames_unasked"]
        assert held >= 1
        for _ in range(100):
            world.run_until(world.now_ns + 10 * MS)
            data += robot.read()
        assert frames_of_a_stock_stream(data, pictures) >= 15
        assert robot.esp32["frames_unasked"] == held, "told once, it has heard"


@pytest.mark.parametrize("seed", range(20))
def test_no_stock_client_ever_sees_a_native_byte(seed):
    """Clients of both kinds come and go quickly, and much is lost on the way to the GAP8."""
    draw = random.Random(seed)
    with World("hover", seed=seed, **SETTINGS) as world:
        robot, pictures = world.robots[0], pictures_of(world)
        streams_native(world)
        for _ in range(12):
            robot.set_faults("spi_to_gap8", loss=draw.choice([0.3, 0.7, 0.95]))
            robot.disconnect()
            world.run_until(world.now_ns + draw.choice([0, 1, 20]) * MS)
            robot.connect()
            if draw.random() < 0.5:
                session = Session("tcp", "native")
                for _ in range(40):
                    robot.write(session.data_to_send())
                    world.run_until(world.now_ns + 5 * MS)
                    session.receive(robot.read(), world.now_ns)
                continue
            data = b""
            for _ in range(draw.randint(1, 80)):
                world.run_until(world.now_ns + 5 * MS)
                data += robot.read()
            frames_of_a_stock_stream(data, pictures)
        robot.disconnect()
        robot.set_faults("spi_to_gap8", loss=0)
        robot.connect()
        data = b""
        for _ in range(200):
            world.run_until(world.now_ns + 5 * MS)
            data += robot.read()
        assert frames_of_a_stock_stream(data, pictures) >= 11
