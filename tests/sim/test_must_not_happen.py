"""What users of the existing firmware and viewers know too well: each fault injected, seen in a counter, and nothing
else lost. A second client is test_serve.py's.
"""

import random
import socket
import struct
import threading

import pytest

import host
from host.link.frame import Frame, LostFrame
from host.link.records import Console, Garbage, Packet
from host.native import lib

BRIDGE_ON = bytes.fromhex("04 00 19 01 21 01")
STM32, ESP32, HOST, GAP8 = 1, 2, 3, 4


def spi(source, destination, function, data, version=0):
    """A packet as SPI and TCP carry it."""
    route = bytes([0x40 | source << 3 | destination, version << 6 | function])
    return struct.pack("<H", len(data) + 2) + route + data


def uart(source, destination, function, data, version=0):
    """A packet as UART2 carries it."""
    frame = b"\xff" + bytes([len(data) + 2]) + spi(source, destination, function, data, version)[2:]
    check = 0
    for byte in frame:
        check ^= byte
    return frame + bytes([check])


def lost(robot):
    return sum(robot.counters.frames_lost.values())


def steady(spindeck_robot, **settings):
    """A robot whose stream runs, the STM32's console too."""
    robot = spindeck_robot("hover", crtp_hz=50, **settings)
    robot.run(1.5)
    robot.write(BRIDGE_ON)
    robot.run(0.5)
    assert len(robot.frames) > 5
    return robot


def crtp(robot):
    return [event for event in robot.events if isinstance(event, Packet) and event.function == lib.CPX_CRTP]


def pictures_are_whole(robot):
    """Every native frame is one that the camera took; the check of each body was right."""
    taken = {(int(row["frame"]), int(row["gap8_stamp_us"])) for row in robot.truth}
    return all((f.native.frame, f.native.frame_gap8_us) in taken for f in robot.frames if f.native)


@pytest.mark.parametrize("direction", ["uart2_to_esp32", "uart2_to_stm32"])
def test_a_lost_credit_does_not_stop_the_uart(spindeck_robot, direction):
    robot = steady(spindeck_robot)
    for _ in range(10):
        robot.set_faults(direction, loss=1)
        robot.run(0.15)
        robot.set_faults(direction, loss=0)
        before = len(crtp(robot))
        robot.run(0.5)
        assert len(crtp(robot)) - before >= 20
    assert robot.wires[direction]["lost"] > 10
    assert robot.stm32["uart2_credits_repeated"] + robot.esp32["uart2_credits_repeated"] > 10
    assert lost(robot) == 0


def test_a_bad_check_byte_restarts_nobody(spindeck_robot):
    robot = steady(spindeck_robot)
    good = uart(STM32, HOST, lib.CPX_CRTP, b"\0hello")
    before = {"esp32": robot.esp32, "stm32": robot.stm32, "gap8": robot.gap8}
    for wire in ("uart2_to_esp32", "uart2_to_stm32"):
        robot.inject(wire, good[:-1] + bytes([good[-1] ^ 1]))
        robot.run(0.3)
    robot.inject("uart1", b"\xd5\x2a" + bytes(15))
    robot.run(0.3)
    assert robot.esp32["uart2_bad_check"] - before["esp32"]["uart2_bad_check"] == 1
    assert robot.stm32["uart2_bad_check"] - before["stm32"]["uart2_bad_check"] == 1
    assert robot.gap8["stamp_rx_bad_check"] - before["gap8"]["stamp_rx_bad_check"] == 1
    for mcu, counter in (("esp32", "frames_forwarded"), ("stm32", "stamps_sent"), ("gap8", "frame")):
        assert getattr(robot, mcu)[counter] > before[mcu][counter], f"the {mcu} has started anew"
    assert not any(b"hello" in event.data for event in crtp(robot))
    assert lost(robot) == 0


def test_a_wrong_version_takes_nobodys_route(spindeck_robot):
    robot = steady(spindeck_robot)
    before, unknown = robot.esp32, (robot.stm32["packets_unknown"], robot.gap8["packets_unknown"])
    for version in (1, 2, 3):
        robot.inject("uart2_to_esp32", uart(STM32, HOST, lib.CPX_CRTP, b"\0old", version))
        robot.inject("spi_to_esp32", spi(GAP8, HOST, lib.CPX_CONSOLE, b"old\0", version))
        robot.inject("tcp_to_esp32", spi(HOST, STM32, lib.CPX_CRTP, b"\0old", version))
        robot.run(0.3)
    assert robot.esp32["uart2_bad_version"] - before["uart2_bad_version"] == 3
    assert robot.esp32["packets_unroutable"] - before["packets_unroutable"] == 3
    assert robot.esp32["tcp_rx_skipped_bytes"] > before["tcp_rx_skipped_bytes"]
    assert not any(isinstance(event, Console) for event in robot.events)
    assert not any(b"old" in event.data for event in crtp(robot))
    assert (robot.stm32["packets_unknown"], robot.gap8["packets_unknown"]) == unknown
    assert lost(robot) == 0


@pytest.mark.parametrize("dialect", ["stock", "native"])
def test_a_console_packet_neither_breaks_nor_enters_an_image(spindeck_robot, dialect):
    robot = spindeck_robot("hover", dialect=dialect)
    robot.run(1.5)
    rng = random.Random(4)
    for number in range(40):
        robot.run(rng.uniform(0.01, 0.05))
        robot.inject("spi_to_esp32", spi(GAP8, HOST, lib.CPX_CONSOLE, f"line {number}\n\0".encode()))
        robot.inject("uart2_to_esp32", uart(STM32, HOST, lib.CPX_CONSOLE, f"line {number}\n\0".encode()))
    robot.run(0.5)
    said = [(event.source, event.text) for event in robot.events if isinstance(event, Console)]
    assert [text for source, text in said if source == "GAP8"] == [f"line {number}\n" for number in range(40)]
    assert [text for source, text in said if source == "STM32"] == [f"line {number}\n" for number in range(40)]
    assert len(robot.frames) > 15
    assert lost(robot) == 0
    assert pictures_are_whole(robot)
    size = robot.settings.camera.width * robot.settings.camera.height
    assert all(frame.body.size == size for frame in robot.frames)
    assert len({frame.body.tobytes() for frame in robot.frames}) <= len(set(robot.truth["image"])), "not a camera's"


@pytest.mark.parametrize("dialect", ["stock", "native"])
@pytest.mark.parametrize("garbage", [b"\x00\x00\x00", b"\xff\xff\xff", b"\x0d\x00\x63", b"\xbc\x44\x01", b"abc"])
def test_three_garbage_bytes_do_not_lose_the_rest(spindeck_robot, dialect, garbage):
    robot = spindeck_robot("hover", dialect=dialect)
    robot.run(1.5)
    for _ in range(5):
        before = len(robot.frames)
        robot.inject("tcp_to_host", garbage)
        robot.run(0.5)
        assert len(robot.frames) - before >= 3
    found = sum(event.size for event in robot.events if isinstance(event, Garbage))
    assert found == robot.counters.garbage_bytes >= 15
    assert lost(robot) == sum(isinstance(event, LostFrame) for event in robot.events) <= 5


@pytest.mark.parametrize("wire", ["uart1", "uart2_to_esp32", "uart2_to_stm32", "spi_to_esp32", "spi_to_gap8"])
def test_garbage_on_any_wire_of_the_robot_costs_nothing_behind_it(spindeck_robot, wire):
    robot = steady(spindeck_robot)
    packets = len(crtp(robot))
    for garbage in (b"\0\0\0", b"\xff\xff\xff", b"\xd5\x2a\xd5", b"\xff\x64\x19"):
        robot.inject(wire, garbage)
        robot.run(0.3)
    counted = {
        "uart1": lambda: robot.gap8["stamp_rx_garbage_bytes"],
        "uart2_to_esp32": lambda: robot.esp32["uart2_garbage_bytes"],
        "uart2_to_stm32": lambda: robot.stm32["uart2_garbage_bytes"],
        "spi_to_esp32": lambda: robot.esp32["spi_errors"],
        "spi_to_gap8": lambda: robot.gap8["spi_errors"],
    }[wire]()
    assert counted > 0
    assert len(crtp(robot)) - packets >= 50
    assert lost(robot) == 0
    assert robot.gap8["stamps_missed"] <= 4


def test_garbage_from_the_host_costs_no_request(spindeck_robot):
    """Even what looks like the header of a packet that never comes."""
    robot = spindeck_robot("hover", dialect="auto")
    robot.run(0.4)
    robot.inject("tcp_to_esp32", b"\xfe\x03\x19")
    robot.run(0.4)
    robot.write(b"\xfe\x03\x19\x01")
    robot.run(2)
    assert robot.esp32["tcp_rx_skipped_bytes"] > 0
    assert robot.frames[-1].native is not None


class CountingSocket(socket.socket):
    reads = 0

    def recv_into(self, *arguments):
        type(self).reads += 1
        return super().recv_into(*arguments)


def test_the_end_of_a_stream_ends_the_reading(monkeypatch):
    """A viewer that reads on at the end of a stream gets nothing, at once, for ever."""
    monkeypatch.setattr(socket, "socket", CountingSocket)
    CountingSocket.reads = 0
    server = socket.create_server(("127.0.0.1", 0))

    def robot():
        connection, _ = server.accept()
        connection.sendall(spi(GAP8, HOST, lib.CPX_APP, struct.pack("<BHHBBI", 0xBC, 64, 48, 1, 0, 3072)) + b"\xfe")
        connection.close()

    thread = threading.Thread(target=robot)
    thread.start()
    with host.open(f"socket://127.0.0.1:{server.getsockname()[1]}", dialect="stock") as stream:
        events = list(stream.events())
        thread.join()
        assert [event.cause for event in events if isinstance(event, LostFrame)] == ["disconnected"]
        assert stream.port.ended == "closed by the robot"
        assert list(stream.events()) == []
    server.close()
    assert CountingSocket.reads <= 5


def test_a_robot_that_goes_ends_the_stream():
    with host.open("sim://hover?pace=max&camera_width=64&camera_height=48") as stream:
        seen = 0
        for event in stream.events():
            seen += isinstance(event, Frame)
            if seen == 5:
                stream.port.world.robots[0].reboot("esp32")
                seen += 1
        assert seen == 6
        assert "closed the connection" in stream.port.ended


def test_a_slow_consumer_eats_no_memory(spindeck_robot):
    robot = steady(spindeck_robot)
    world, kernel = robot.world, robot.world.kernel
    frames, memory = len(robot.frames), lib.kernel_robot_bytes(kernel, 0)
    for _ in range(300):  # 30 s at a tenth of what the camera makes
        world.run_until(world.now_ns + 100_000_000)
        data = robot.read(8000)
        robot.events += robot._session.receive(data, world.now_ns)
        esp32 = lib.kernel_esp32(kernel, 0)
        assert esp32.image_fill <= lib.ESP32_IMAGE_BYTES
        assert esp32.to_tcp.fill <= lib.ESP32_TO_TCP
        assert robot.available <= 2 * robot.settings.tcp.window + (32 << 10)
    robot.run(3)
    robot.frames = [event for event in robot.events if isinstance(event, Frame)]
    assert lib.kernel_robot_bytes(kernel, 0) == memory
    assert robot.esp32["frames_dropped"] > 200
    assert robot.esp32["frames_cut"] == 0
    assert len(robot.frames) - frames > 30
    causes = {cause for cause, count in robot.counters.frames_lost.items() if count}
    assert causes == {"esp32_dropped"}, "frames come whole or not at all, and the ESP32 says how many do not"
    assert pictures_are_whole(robot)


def test_a_vanished_client_does_not_block_the_stm32(spindeck_robot):
    """It neither reads nor closes: to TCP it is just slow."""
    robot = steady(spindeck_robot)
    world = robot.world
    world.run_until(world.now_ns + 3_000_000_000)
    sent, stamps = robot.stm32["uart2_packets_out"], robot.stm32["stamps_sent"]
    received = robot.stm32["uart2_packets_in"]
    for _ in range(20):
        robot.inject("spi_to_esp32", spi(GAP8, STM32, lib.CPX_TEST, b"\0for the STM32"))
        world.run_until(world.now_ns + 100_000_000)
    assert robot.stm32["uart2_packets_in"] - received >= 20
    assert robot.stm32["uart2_packets_out"] - sent >= 30
    assert robot.stm32["stamps_sent"] - stamps == pytest.approx(200, abs=2)
    assert robot.gap8["stamps_missed"] == 0
    assert robot.esp32["packets_dropped"] > 0, "what had no room is counted"
    before = len(crtp(robot))
    robot.run(1.5)
    assert len(crtp(robot)) - before > 50


@pytest.mark.parametrize("cut", range(20))
def test_nothing_of_an_old_frame_reaches_a_new_client(spindeck_robot, cut):
    robot = spindeck_robot("hover", dialect="stock", tcp_bytes_per_s=400_000)
    robot.run(1.5 + cut * 0.013)
    robot.disconnect()
    robot.world.run_until(robot.world.now_ns + (cut % 3) * 5_000_000)
    robot.frames.clear()
    robot.events.clear()
    robot.connect()
    robot.run(1.5)
    assert len(robot.frames) >= 3
    assert lost(robot) == 0
    assert robot.counters.stray_packets == robot.counters.garbage_bytes == 0
    assert all(isinstance(event, Frame) or type(event).__name__ == "Announced" for event in robot.events)


@pytest.mark.parametrize(("fail", "hang"), [(0.0, 1.0), (1.0, 0.0)])
def test_a_camera_that_never_completes_a_capture_is_given_up_and_comes_back(spindeck_robot, fail, hang):
    robot = steady(spindeck_robot)
    robot.set_camera_faults(fail=fail, hang=hang)
    robot.run(3)
    during = len(robot.frames)
    failed = robot.gap8["captures_failed"]
    assert failed >= 5
    robot.set_camera_faults()
    robot.run(2)
    assert len(robot.frames) - during >= 13
    assert robot.frames[-1].native.counters["captures_failed"] >= failed, "and every frame says so"
    assert lost(robot) == 0
    assert robot.esp32["gap8_resets"] == 0


def test_a_long_exposure_is_no_failure(spindeck_robot):
    robot = spindeck_robot("hover", camera_exposure_lines=20_000, camera_fps=0.3)
    robot.run(15)
    assert len(robot.frames) >= 4
    assert robot.gap8["captures_failed"] == 0


def test_a_function_that_nobody_reads_stalls_nothing(spindeck_robot):
    robot = steady(spindeck_robot)
    functions = [lib.CPX_TEST, lib.CPX_BOOTLOADER, lib.CPX_WIFI_CTRL, lib.CPX_SYSTEM, 6, 9, 63]
    frames, packets = len(robot.frames), len(crtp(robot))
    for number in range(400):
        function = functions[number % len(functions)]
        robot.inject("spi_to_esp32", spi(GAP8, HOST, function, bytes(200)))
        robot.inject("spi_to_gap8", spi(ESP32, GAP8, function, b"\x7f"))
        robot.inject("uart2_to_stm32", uart(ESP32, STM32, function, b"\x7f"))
        robot.run(0.005)
    assert len(robot.frames) - frames >= 18
    assert len(crtp(robot)) - packets >= 90
    assert lost(robot) == 0
    assert robot.counters.unknown_function > 100
    assert robot.counters.packets["test"] > 50
    assert robot.gap8["packets_unknown"] > 100
    assert robot.stm32["packets_unknown"] > 100


@pytest.mark.parametrize("reason", ["client", "esp32", "gap8", "stm32"])
def test_a_reconnect_needs_no_power_cycle(spindeck_robot, reason):
    robot = steady(spindeck_robot)
    for _ in range(4):
        if reason == "client":
            robot.disconnect()
        else:
            robot.reboot(reason, 0.2)
        robot.run(0.2)
        if reason in ("client", "esp32"):
            robot.connect()
        before = len(robot.frames)
        robot.run(2)
        came = robot.frames[before:]
        assert came
        assert came[-1].native is not None
    assert robot.esp32["gap8_resets"] == 0
    assert pictures_are_whole(robot)
