"""What can go wrong with one robot, drawn at random and done: on its wires, in its MCUs, at its host's."""

from sim import configure

NS = 1_000_000_000
LINKS = ["uart1", "uart2", "spi", "tcp"]


class Faults:
    """Of the robot of `host` (campaign.Host), drawn from `draw`."""

    def __init__(self, draw, world, host):
        self.random = draw
        self.world = world
        self.robot = host.robot
        self.host = host
        self.done = []
        """What was done, for the message of a failure."""
        self._later = []

    def due(self):
        """Does what was put off until now."""
        for item in [item for item in self._later if item[0] <= self.world.now_ns]:
            self._later.remove(item)
            item[1]()

    def _do(self, what, *arguments, **named):
        self.done.append(f"{self.world.seconds:.3f} {what.__name__} {arguments or ''}{named or ''}"[:200])
        what(*arguments, **named)

    def something(self, left_s):
        draw = self.random
        action = draw.choice([self.wire_fault] * 3 + [self._stall, self._inject, self._inject, self._reboot,
                             self._clock, self._camera, self._client, self._write, self._pause])  # fmt: skip
        action(min(left_s, 0.8)) if action not in (self.wire_fault,) else action()

    def wire_fault(self):
        draw = self.random
        link = draw.choice(LINKS)
        wire = draw.choice([name for name in configure.WIRES if name.startswith(link)])
        amount = draw.random() ** 3
        on_tcp = link == "tcp"
        kinds = [
            {"loss": amount * (0.1 if on_tcp else 1)},
            {"drop": amount * 0.02},
            {"flip": amount * 0.02},
            {"burst_per_s": amount * 5, "burst_ms": 20 if on_tcp else 100},
            {"stall_per_s": amount * 5, "stall_ms": 30},
            {"latency_us": amount * 5000, "jitter_us": amount * 3000},
        ]
        if not on_tcp:
            kinds.append({"duplicate": amount})
        if link.startswith("uart"):
            kinds.append({"reorder": amount})
        self._do(self.robot.set_faults, wire, **draw.choice(kinds))

    def _stall(self, left_s):
        self._do(self.robot.stall, self.random.choice(list(configure.WIRES)), self.random.uniform(0, left_s))

    def _inject(self, _left_s):
        draw = self.random
        wire = draw.choice([name for name in configure.WIRES if "_to_" in name])
        size = draw.choice([1, 3, 4, 17, 100, 300])
        route = bytes([draw.randrange(256), draw.randrange(256)])
        data = draw.choice([
            draw.randbytes(size),
            b"\xff" * size,
            bytes(size),
            b"\xff\x00",
            size.to_bytes(2, "little") + route + draw.randbytes(size),
            b"\xff" + bytes([size % 256]) + route + draw.randbytes(size),
            b"\x0d\x00\x63\x05\xbc" + draw.randbytes(10),
            b"\x0f\x00\x63\x02Hello, world\n",
            b"\xd5\x2a" + draw.randbytes(15),
        ])  # fmt: skip
        self._do(self.robot.inject, wire, data)

    def _reboot(self, left_s):
        mcu = self.random.choice(["stm32", "gap8", "esp32"])
        self._do(self.robot.reboot, mcu, self.random.uniform(0, min(left_s, 0.3)))

    def _clock(self, _left_s):
        mcu = self.random.choice(["stm32", "gap8", "esp32"])
        if self.random.random() < 0.5:
            self._do(self.robot.reset_stamp_clock, mcu, self.random.choice([0, 5000, 2**40]))
        else:
            self._do(self.robot.set_rate, mcu, self.random.uniform(-20000, 20000))

    def _camera(self, _left_s):
        fail, hang = self.random.choice([(0.5, 0.0), (0.0, 0.3), (0.2, 0.1), (1.0, 0.0), (0.0, 1.0)])
        self._do(self.robot.set_camera_faults, fail, hang)

    def _client(self, left_s):
        self._do(self.host.disconnect)
        if self.random.random() < 0.7:
            self.host.wanted = False
            again_ns = self.world.now_ns + int(self.random.uniform(0, left_s) * NS)
            self._later.append((again_ns, lambda: setattr(self.host, "wanted", True)))

    def _write(self, _left_s):
        self._do(self.robot.write, self.random.randbytes(self.random.choice([1, 3, 50, 2000])))

    def _pause(self, left_s):
        """A reader that does something else for a while."""
        self.done.append(f"{self.world.seconds:.3f} reads nothing")
        self.host.reading = False
        again_ns = self.world.now_ns + int(self.random.uniform(0, left_s) * NS)
        self._later.append((again_ns, lambda: setattr(self.host, "reading", True)))

    def stop(self):
        for link in LINKS:
            faults = {"loss": 0, "drop": 0, "flip": 0, "burst_per_s": 0, "stall_per_s": 0, "latency_us": 0,
                      "jitter_us": 0}  # fmt: skip
            if link != "tcp":
                faults["duplicate"] = 0
            if link.startswith("uart"):
                faults["reorder"] = 0
            self.robot.set_faults(link, **faults)
        self.robot.set_camera_faults(0, 0)
        for mcu in ("stm32", "gap8", "esp32"):
            self.robot.set_rate(mcu, 0)
        self.host.reading = self.host.wanted = True
        self._later.clear()
        self.done.append(f"{self.world.seconds:.3f} all faults stopped")
