"""From the sender to the table: pyusb, a dongle that does what a Crazyradio's firmware does, the simulator's antenna,
the STM32's app, the logs on the cards, `host sync robots`."""

import json
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("usb.core", reason="pyusb is not installed: pip install 'spindeck[radio]'")
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "sim"))

import usb.backend.libusb1
from fake_dongle import FakeDongle, FakeUsb
from radio_flights import ROWS, SHUTDOWN, Store

from host.cli import main
from host.cli.sync_beacons import against, quick
from host.cli.usd import load
from host.clock.beacons import Beacons, against_host, collect, recent
from host.radio.broadcast import beacons
from host.radio.dongle import Dongle
from host.usd.decode import decode
from host.usd.host_log import HostLog
from sim.radio import HOST_START_US
from sim.serial.air import SimulatedAir
from sim.world import World

PPM = [250.0, -250.0]


class InWorld(Dongle):
    """By the world's clock instead of this computer's."""

    def __init__(self, world: World, watch: Callable[[int], None]) -> None:
        self.world, self.watch = world, watch
        super().__init__("radio://0/80/2M")

    def now_us(self) -> int:
        return HOST_START_US + self.world.now_ns // 1000

    def wait_until(self, at_us: int, stop: Callable[[], bool]) -> None:
        self.world.run_until(max((at_us - HOST_START_US) * 1000, self.world.now_ns))
        self.watch(self.now_us())


class Flight:
    """Two robots that hear a dongle, and what their clocks really showed at each beacon."""

    def __init__(
        self, folder: Path, monkeypatch: pytest.MonkeyPatch, seconds: float, hz: float, runs: int = 1, **keys: Any
    ) -> None:
        """`runs`: times that the sender is started, half a minute after the run before."""
        config = {"robots": 2, "stm32_ppm": PPM, "camera_fps": 0, "radio_loss": 0.1, "seed": 3, **keys}
        self.world = World("swarm", **config)
        stores = [Store(ROWS + b"on:beacon\n") for _ in self.world.robots]
        for robot, store in zip(self.world.robots, stores, strict=True):
            robot.set_storage(store)
        random = np.random.default_rng(8)

        def on_air(packet: bytes) -> None:
            # The way over USB, and the way back of the word that it is done: now and then a scheduler's slice.
            self.world.run(passing_us(80) * 1e-6)
            self.world.broadcast(packet)
            self.world.run(passing_us(30) * 1e-6)

        def passing_us(least: float) -> float:
            return least + float(random.exponential(30)) + (4000 if random.random() < 0.01 else 0)

        self.dongle = FakeDongle(on_air=on_air)
        monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda: FakeUsb(self.dongle))
        self.watched: list[tuple[int, ...]] = []
        """The host's clock and each robot's."""
        self.world.run(1.0)
        air = InWorld(self.world, self._watch)
        log = HostLog(folder / "host00")
        self.sent = []
        for run in range(runs):
            self.world.run(30.0 * bool(run))
            for each in beacons(air, hz, seconds, lambda: False):
                log.add(each.sequence, each.host_us, each.done_us)
                self.sent.append(each)
        log.end()
        for robot in self.world.robots:
            robot.inject("uart2_to_stm32", SHUTDOWN)
        self.world.run(1.0)
        self.paths = [str(folder / "host00")]
        for number, store in enumerate(stores):
            (folder / f"cf{number}").write_bytes(bytes(store.files["log00"]))
            self.paths.append(str(folder / f"cf{number}"))

    def _watch(self, host_us: int) -> None:
        self.watched.append((host_us, *(robot.stamp_us("stm32") for robot in self.world.robots)))


def noted(path: str) -> Beacons:
    rows = decode(Path(path).read_bytes()).rows["beacon"]
    host_us = rows.data["hostUs"].astype(np.int64) + (rows.data["hostUsHigh"].astype(np.int64) << 32)
    return collect(rows.data["sequence"], host_us, rows.stamp_us)


def between_us(fits: list[Any], host_us: Any) -> Any:
    return fits[1].at(host_us)[0] - fits[0].at(host_us)[0]


def test_within_the_bar(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Two robots against each other: 20 us (p95) afterwards, 100 us from what had come by then."""
    flight = Flight(tmp_path, monkeypatch, 120.0, 10)
    assert len(flight.sent) == len(flight.dongle.sent) == 1200
    notes = [noted(path) for path in flight.paths[1:]]
    assert all(len(each) == heard for each, heard in zip(notes, flight.world.radio.heard_others, strict=True))
    assert all(1000 < len(each) < 1180 for each in notes)
    fits = [against_host(each) for each in notes]
    watched = np.array(flight.watched)
    host_us, truth = watched[:, 0].astype(float), watched[:, 2] - watched[:, 1]
    off = np.abs(between_us(fits, host_us) - truth)
    assert np.quantile(off, 0.95) < 20
    logs = [load(path, examined=False)[0] for path in flight.paths]
    sharp = [against("", heard, quick(logs)) for heard in notes]
    assert np.quantile(np.abs(between_us(sharp, host_us) - truth), 0.95) < 10, "the host's log says which were late"
    online = []
    for at_us, true_us in list(zip(host_us, truth, strict=True))[::50][2:]:
        known = [recent(Beacons(*(each[n.host_us < at_us] for each in (n.sequence, n.host_us, n.local_us)), 0, 0))
                 for n in notes]  # fmt: skip
        online.append(abs(float(between_us([against_host(each) for each in known], np.array([at_us]))[0]) - true_us))
    assert len(online) == 23
    assert np.quantile(online, 0.95) < 100

    assert main(["sync", "robots", *flight.paths, "--json"]) == 0
    records = [json.loads(each) for each in capsys.readouterr().out.splitlines()]
    robots = [each for each in records if each["event"] == "robot"]
    assert [each["log"] for each in robots] == ["host00", "cf0", "cf1"]
    assert [each["beacons"] for each in robots] == [1200, *flight.world.radio.heard_others]
    assert all(0.2 < each["left_out_as_slow"] / each["beacons"] < 0.3 for each in robots)
    assert [each["lost"] for each in robots] == [0, *(1200 - each for each in flight.world.radio.heard_others)]
    assert abs(robots[0]["drift_ppm"]) < 1
    # The least way to the dongle: in the host's own log, and in the robots' times, whose radio adds 250 us.
    least_us = min(each.transfer_us for each in flight.sent)
    assert abs(robots[0]["host_offset_us"] - least_us) < 20
    for pair in (each for each in records if each["event"] == "pair" and each["first"] == "host00"):
        robot = int(pair["second"][2:])
        middle = int(np.argmin(np.abs(host_us - pair["at_us"])))
        real = watched[middle, 1 + robot] - watched[middle, 0]
        drifted = pair["slope_ppm"] * 1e-6 * (host_us[middle] - pair["at_us"])
        assert abs(pair["offset_us"] + drifted - real - 250) < 40, "what is left is the way through the air alone"


def test_a_sender_that_was_started_again_is_one_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    flight = Flight(tmp_path, monkeypatch, 10.0, 10, runs=3, radio_loss=0)
    for path in flight.paths[1:]:
        notes = noted(path)
        assert len(notes) == len(flight.sent) == 300
        assert notes.other_runs == 0


def test_a_log_that_was_not_ended_can_be_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The sender was killed: what it had sent is there."""
    flight = Flight(tmp_path, monkeypatch, 12.0, 10)
    whole = Path(flight.paths[0]).read_bytes()
    for size in range(len(whole) - 4, len(whole) - 64, -7):
        Path(flight.paths[0]).write_bytes(whole[:size])
        rows = decode(whole[:size]).rows["beaconSent"]
        assert len(rows) == 120 - -(-(len(whole) - 4 - size) // 20)
        assert main(["sync", "robots", *flight.paths, "--json"]) == 0
        assert json.loads(capsys.readouterr().out.splitlines()[0])["beacons"] == len(rows)


def test_the_host_has_no_part_in_a_reset(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flight = Flight(tmp_path, monkeypatch, 40.0, 4, reset_s=4, radio_loss=0)
    assert main(["sync", "robots", *flight.paths]) == 0
    table = capsys.readouterr().out
    assert "all were set to 0 by a broadcast" in table
    after = table.split("all were set to 0")[1]
    assert "cf1" in after
    assert "host00" not in after


def test_a_broadcast_is_in_the_worlds_log() -> None:
    with World("swarm", robots=2, trace="hash", beacon_hz=5, radio_loss=0.3, seed=4) as world:
        for number in range(20):
            world.broadcast(bytes.fromhex("d2 62") + bytes([number]) * 12)
            world.run(0.05)
        heard = list(world.radio.heard_others)
        assert all(5 < each < 20 for each in heard)
        with World.replay(json.loads(json.dumps(world.log))) as again:
            assert again.trace_hash() == world.trace_hash()
            assert list(again.radio.heard_others) == heard


def test_a_broadcast_changes_nothing_for_what_the_scenario_sends() -> None:
    def resets(more: int) -> list[list[int]]:
        with World("swarm", robots=2, reset_s=0.1, reset_repeats=20, radio_loss=0.5) as world:
            for _ in range(more):
                world.broadcast(b"\xd2\x62" + bytes(12))
            world.run(0.2)
            return world.radio.heard_resets

    assert resets(0) == resets(3)


def test_a_simulated_air_keeps_to_the_wall_clock_and_can_be_stopped() -> None:
    with closing(SimulatedAir("sim://swarm?robots=1&camera_fps=0")) as air:
        begin_us, begin_s = air.now_us(), time.monotonic()
        air.wait_until(begin_us + 50_000, lambda: False)
        assert air.now_us() == begin_us + 50_000
        assert time.monotonic() - begin_s >= 0.04, "not ahead of it"
        air.wait_until(begin_us + 10**12, lambda: True)
        assert air.now_us() == begin_us + 50_000


def test_simulated_robots_without_a_dongle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log = str(tmp_path / "host00")
    port = "sim://swarm?robots=2&pace=max&camera_fps=0&radio_loss=0,1"
    assert main(["sync", "beacons", "--port", port, "--duration", "5", "--hz", "10", "--log", log]) == 0
    said = capsys.readouterr().out.splitlines()
    assert [each.split()[0] for each in said[:4]] == ["1", "2", "3", "4"]
    assert said[4:] == [
        "50 beacons sent, 0 that the dongle did not take, 0 left out",
        "  late against the schedule: p50 0 us, p95 0 us, max 0 us",
        "  from the clock's reading to the dongle: p50 0 us, p95 0 us, max 0 us",
        "  robot 0 has heard 50",
        "  robot 1 has heard 0",
    ]
    assert len(decode(Path(log).read_bytes()).rows["beaconSent"]) == 50
    assert main(["sync", "beacons", "--port", port, "--duration", "1", "--reset", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["heard"] == [4, 0]
