"""One schedule of random faults against one robot, and what must hold during and after it.

`Campaign(seed).run()` raises AssertionError with what did not hold; the same seed gives the same run.
"""

import random
from collections import Counter

from faults import Faults

from host.link.frame import Frame, LostFrame
from host.link.session import Session
from host.native import lib
from sim.world import World

NS = 1_000_000_000
STEP_S = 0.005
"""The host reads this often."""
BACK_S = 2.0
"""After the faults have stopped the stream must be back within this time."""
STEADY_S = 1.0
"""And then nothing may be lost any more."""
FRAMINGS = {"tcp": "tcp", "uart2": "cpx-uart", "uart1": "stamps"}


class Host:
    """A client that connects again whenever it is told to, or the robot has closed the connection."""

    def __init__(self, world, dialect, robot=0):
        self.robot = world.robots[robot]
        self.world = world
        self.dialect = dialect
        self.framing = FRAMINGS[self.robot.settings.wire]
        self.frames = []
        """(arrival_ns, Frame), of all connections."""
        self.reading = True
        self.wanted = True
        self.session = None
        self.lost = Counter()
        """Of connections that have ended."""
        self.renumbered = 0
        self._was_connected = False
        self._numbered = None

    def connect(self):
        self.session = Session(self.framing, self.dialect)
        self.asked = self.framing != "tcp"  # UART2 knows no connections
        self.broken = 0
        self._was_connected = False
        self._numbered = None
        self.robot.connect()

    def disconnect(self):
        if self.session is not None:
            self._take(self.session.finish(self.world.now_ns))
            self.lost += Counter(self.session.counters.frames_lost)
            self.renumbered += self.session.counters.renumbered
            self.session = None
        self.robot.disconnect()
        self.robot.read()  # what a socket that is closed had not been asked for

    def poll(self):
        if self.session is None:
            if self.wanted:
                self.connect()
            return
        if self.framing == "tcp":
            connected = self.robot.connected
            if self._was_connected and not connected:
                self._read()
                self.disconnect()
                return
            self._was_connected |= connected
        if self.reading:
            self._read()

    def _read(self):
        now_ns = self.world.now_ns
        data = self.robot.read()
        if data:
            self._take(self.session.receive(data, now_ns))
        else:
            self.session.tick(now_ns)
        out = self.session.data_to_send()
        if out:
            self.asked = True
            self.robot.write(out)

    def _take(self, events):
        numbered = None
        for event in events:
            if isinstance(event, LostFrame):
                self.broken += 1
            elif isinstance(event, Frame):
                self.frames.append(event)
                if event.native:
                    assert self.asked, f"frame {event.native.frame} is native, and this client has not asked"
                    numbered = (event, self.broken)
        if numbered:
            self._account(*numbered)

    def _account(self, frame, broken):
        """Between two numbered frames each number was delivered, or is in just one counter. `broken`: LostFrames before
        this one; those behind it in the same batch belong to the next account."""
        counters = self.session.counters
        lost = sum(counters.frames_lost.values()) - self.broken + broken
        now = (frame.native.frame, frame.index, lost, counters.renumbered)
        before, self._numbered = self._numbered, now
        if before is None or before[3] != now[3]:
            return
        numbers = (now[0] - before[0]) % 2**32
        delivered, lost = now[1] - before[1], now[2] - before[2]
        assert numbers == delivered + lost, (
            f"frames {before[0]} to {now[0]}: {numbers} numbers, {delivered} delivered, {lost} counted as lost "
            f"({ {cause: count for cause, count in counters.frames_lost.items() if count} })"
        )


class Campaign:
    def __init__(self, seed):
        self.random = random.Random(seed)
        draw = self.random
        self.settings = {
            "wire": draw.choice(["tcp"] * 5 + ["uart2"]),
            "camera_width": 64,
            "camera_height": 48,
            "camera_fps": draw.choice([5, 10, 10, 20, 30]),
            "camera_encoding": draw.choice(["raw", "raw", "jpeg"]),
            "camera_burst": draw.choice([1, 1, 1, 2, 3]),
            "wifi_up_ms": draw.choice([100, 300, 500]),
            "crtp_hz": draw.choice([0, 0, 50]),
        }
        if self.settings["wire"] == "uart2":
            # What it carries when each packet waits for a host that looks every 5 ms.
            self.settings |= {"camera_fps": 5, "camera_width": 40, "camera_height": 30}
        self.dialect = draw.choice(["auto", "native"])
        self.faults_s = draw.uniform(1.5, 3.5)
        self.world = World("hover", seed=seed, **self.settings)
        self.robot = self.world.robots[0]
        self.host = Host(self.world, self.dialect)
        self.faults = Faults(self.random, self.world, self.host)
        self.done = self.faults.done

    def run(self):
        with self.world:
            self._run_for(1.0)
            self._cause_faults()
            self.faults.stop()
            stopped_ns = self.world.now_ns
            self._run_for(BACK_S)
            counters = self.host.session.counters
            lost = sum(counters.frames_lost.values())
            late = self._arrived(stopped_ns + int((BACK_S - 1) * NS), self.world.now_ns)
            self._run_for(STEADY_S)
            steady = self._arrived(stopped_ns + int(BACK_S * NS), self.world.now_ns)
            expected = self.settings["camera_fps"] * STEADY_S
            assert late > 0, "no native frame between 1 s and 2 s after the faults stopped"
            assert steady >= 0.8 * expected - 2, f"{steady} frames in the third second, {expected} were due"
            more = sum(self.host.session.counters.frames_lost.values()) - lost
            assert more <= 0, f"{more} frames lost after the stream was back"
            under_way = lib.kernel_gap8(self.world.kernel, 0).frame - self.host.frames[-1].native.frame - 1
            assert under_way <= lib.GAP8_SLOTS + 1, f"{under_way} frames are neither lost, nor here, nor on their way"
            self._check_truth()

    def _arrived(self, from_ns, to_ns):
        return sum(from_ns < frame.arrival_host_ns <= to_ns for frame in self.host.frames if frame.native)

    def _check_truth(self):
        """Every frame is a picture that the camera took, and came once."""
        taken = Counter((int(row["frame"]), int(row["gap8_stamp_us"])) for row in self.world.truth)
        came = Counter((frame.native.frame, frame.native.frame_gap8_us) for frame in self.host.frames if frame.native)
        assert came <= taken, f"frames that nobody took, or that came twice: {sorted(came - taken)[:3]}"

    def _run_for(self, seconds):
        end_ns = self.world.now_ns + int(seconds * NS)
        while (now_ns := self.world.now_ns) < end_ns:
            self.world.run_until(min(end_ns, now_ns + int(STEP_S * NS)))
            self.host.poll()
            self.faults.due()
            self._check_bounds()

    def _check_bounds(self):
        kernel = self.world.kernel
        gap8, esp32, stm32 = (f(kernel, 0) for f in (lib.kernel_gap8, lib.kernel_esp32, lib.kernel_stm32))
        assert gap8.queue_fill <= lib.GAP8_QUEUE_PACKETS
        assert gap8.pairs_fill <= lib.GAP8_PAIRS_MAX
        assert gap8.order_fill <= lib.GAP8_SLOTS
        held = gap8.order_fill + (gap8.sending >= 0)
        assert gap8.frame == gap8.frames_sent + gap8.frames_unsent + held, "the GAP8 does not know where frames are"
        assert esp32.image_fill <= lib.ESP32_IMAGE_BYTES
        for queue in (esp32.to_uart, esp32.to_spi, esp32.to_tcp):
            assert queue.fill <= queue.capacity
        assert stm32.queue_fill <= lib.STM32_QUEUE_PACKETS

    def _cause_faults(self):
        end_ns = self.world.now_ns + int(self.faults_s * NS)
        for _ in range(self.random.randint(1, 3)):
            self.faults.wire_fault()
        while self.world.now_ns < end_ns:
            left_s = (end_ns - self.world.now_ns) / NS
            self._run_for(min(left_s, self.random.expovariate(4)))
            if self.world.now_ns < end_ns:
                self.faults.something((end_ns - self.world.now_ns) / NS)
