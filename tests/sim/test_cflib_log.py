"""The log's counters over CRTP, read by cflib's own client of the Crazyflie's log service."""

import sys
import types
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import pytest

pytest.importorskip("fatfs", reason="fatfs-ng is not installed: pip install 'spindeck[card]'")

from host.link.records import Packet
from host.link.session import Session
from host.native import lib
from sim.world import World

PORT = 5


@pytest.fixture
def cflib(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Its modules for the log, without what it needs for USB radios."""
    pytest.importorskip("cflib", reason="cflib is not installed")
    for name in ("libusb_package", "usb", "usb.core", "usb.util"):
        if name not in sys.modules:
            monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    before = set(sys.modules)
    try:
        from cflib.crazyflie import log
        from cflib.crtp.crtpstack import CRTPPacket
    except ImportError as error:
        pytest.skip(f"cflib cannot be imported: {error}")
    yield types.SimpleNamespace(Log=log.Log, LogConfig=log.LogConfig, CRTPPacket=CRTPPacket)
    for name in set(sys.modules) - before:
        if name.startswith("cflib"):
            del sys.modules[name]


class Crazyflie:
    """What cflib's log client wants of one: packets to send, and who hears those that come."""

    def __init__(self, world: World, packet: type[Any]) -> None:
        self.world, self.packet, self.session = world, packet, Session()
        self.link = self.platform = self
        self.log: Any = None
        self.heard: list[Callable[[Any], None]] = []
        world.robots[0].connect()

    def get_protocol_version(self) -> int:
        return 10

    def fetch(self, crc: int) -> None:
        """The client's cache has nothing."""

    def insert(self, crc: int, table: Any) -> None:
        """Nor does it keep anything."""

    def add_port_callback(self, port: int, callback: Callable[[Any], None]) -> None:
        assert port == PORT
        self.heard.append(callback)

    def remove_port_callback(self, port: int, callback: Callable[[Any], None]) -> None:
        self.heard.remove(callback)

    def send_packet(self, packet: Any, expected_reply: tuple[int, ...] = ()) -> None:
        self.session.send(lib.CPX_STM32, lib.CPX_CRTP, bytes([packet.header]) + bytes(packet.data))

    def run(self, seconds: float) -> None:
        robot, end_ns = self.world.robots[0], self.world.now_ns + round(seconds * 1e9)
        while self.world.now_ns < end_ns:
            self.world.run_until(self.world.now_ns + 1_000_000)
            for event in self.session.receive(robot.read(1 << 16), self.world.now_ns):
                if isinstance(event, Packet) and event.function == lib.CPX_CRTP and event.data[0] >> 4 == PORT:
                    for callback in list(self.heard):
                        callback(self.packet(event.data[0], event.data[1:]))
            robot.write(self.session.data_to_send())


def test_cflib_subscribes_to_the_logs_counters(cflib: Any) -> None:
    keys = {
        "camera_width": 64,
        "camera_height": 48,
        "usd_size_mb": 64,
        "usd_stall_p99_ms": 800,
        "usd_stall_max_ms": 3000,
    }
    with World("hover", seed=3, usd_config="full", **keys) as world:
        robot = Crazyflie(world, cflib.CRTPPacket)
        robot.run(1.0)
        client, fetched = cflib.Log(robot), []
        robot.log = client
        client.refresh_toc(lambda: fetched.append(True), robot)
        robot.run(1.0)
        assert fetched == [True]
        assert set(client.toc.toc["usd"]) >= {"eventsRequested", "eventsDropped", "syncs", "session", "state"}
        block = cflib.LogConfig("card", period_in_ms=100)
        for name in ("eventsRequested", "eventsAccepted", "eventsDropped", "stallUs", "cardErrors", "syncs"):
            block.add_variable(f"usd.{name}")
        got: list[tuple[int, dict[str, int]]] = []
        block.data_received_cb.add_callback(lambda stamp, values, _: got.append((stamp, values)))
        client.add_config(block)
        block.start()
        robot.run(20.0)
        counts = world.robots[0].log
    assert len(got) in (199, 200, 201)
    assert {later[0] - before[0] for before, later in pairwise(got)} == {100}
    for _, values in got:
        assert values["usd.eventsRequested"] == values["usd.eventsAccepted"] + values["usd.eventsDropped"]
    last = got[-1][1]
    assert last["usd.eventsDropped"] > 100
    assert last["usd.stallUs"] == counts["stall_us"]
    assert counts["syncs"] - 1 <= last["usd.syncs"] <= counts["syncs"]
