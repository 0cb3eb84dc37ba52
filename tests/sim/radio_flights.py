"""Robots that hear a host's radio, and their logs."""

import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "firmware"))

from memory_card import Store

from sim.world import World

SHUTDOWN = bytes.fromhex("ff 03 59 01 30 94")
ROWS = b"1\n8192\nlog\n1\non:fixedFrequency\n100\n1\npm.vbatMV\n"
PPM = [120.0, -80.0, 33.0]


class Flight:
    """So many seconds of three robots; then their clocks are read, they are told to close their logs, and these are in
    `folder`."""

    def __init__(self, folder: Path, seconds: float, rows: bytes = b"", **keys: Any) -> None:
        self.world = World("swarm", **{"robots": 3, "stm32_ppm": PPM, "camera_fps": 0, **keys})
        self.heard = self.world.radio.heard_resets
        text = ROWS + rows + (b"on:beacon\n" if keys.get("beacon_hz") else b"")
        stores = [Store(text) for _ in self.world.robots]
        for robot, store in zip(self.world.robots, stores, strict=True):
            robot.set_storage(store)
        self.world.run(seconds)
        self.stamps = [robot.stamp_us("stm32") for robot in self.world.robots]
        for robot in self.world.robots:
            robot.inject("uart2_to_stm32", SHUTDOWN)
        self.world.run(1.0)
        self.paths = []
        for number, store in enumerate(stores):
            (folder / f"cf{number}").write_bytes(bytes(store.files["log00"]))
            self.paths.append(str(folder / f"cf{number}"))
