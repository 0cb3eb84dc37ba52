"""The sender without a clock and without a dongle: when beacons go, what they say, what is left out."""

import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import pytest

from host.cli import main
from host.cli.sync_send import Tally
from host.protocol.errors import ConnectionLostError, PeerSilentError
from host.protocol.packets import RESET_CLOCKS
from host.radio.broadcast import SILENT_MAX, WRAP, Sent, beacons
from host.radio.crazyradio import BROADCAST, settings
from host.radio.url import parse

START_US = 1 << 33
FIRST = START_US // 50_000


@dataclass
class ScriptedAir:
    """Wakes up so late, and takes so long for each packet; None: it does not take it."""

    wake_us: list[int] = field(default_factory=list)
    take_us: list[int | None] = field(default_factory=list)
    clock_us: int = START_US
    sent: list[tuple[int, bytes]] = field(default_factory=list)
    gone_after: int = 1 << 30
    heard = None

    def now_us(self) -> int:
        return self.clock_us

    def wait_until(self, at_us: int, stop: Callable[[], bool]) -> None:
        late_us = self.wake_us.pop(0) if self.wake_us else 0
        self.clock_us = max(self.clock_us, at_us + late_us)

    def send(self, packet: bytes) -> None:
        if len(self.sent) == self.gone_after:
            raise ConnectionLostError("gone")
        takes_us = self.take_us.pop(0) if self.take_us else 0
        if takes_us is None:
            self.clock_us += 100_000
            raise PeerSilentError("not taken")
        self.sent.append((self.clock_us, packet))
        self.clock_us += takes_us

    def close(self) -> None:
        pass


def ran(air: ScriptedAir, hz: float = 4, duration_s: float | None = 2, **more: Any) -> list[Sent]:
    return list(beacons(air, hz, duration_s, lambda: False, **more))


def test_the_bytes_and_the_times() -> None:
    air = ScriptedAir(wake_us=[0, 70, 0], take_us=[120, 90, 400])
    sent = ran(air, hz=4, duration_s=0.75)
    assert [(at - START_US, packet.hex(" ")) for at, packet in air.sent] == [
        (125_000, "d2 62 17 9f 02 00 48 e8 01 00 02 00 00 00"),
        (375_070, "d2 62 18 9f 02 00 1e b9 05 00 02 00 00 00"),
        (625_000, "d2 62 19 9f 02 00 68 89 09 00 02 00 00 00"),
    ]
    assert [(each.sequence - FIRST, each.late_us, each.transfer_us, each.failed, each.skipped) for each in sent] == [
        (1, 0, 120, "", 0),
        (2, 70, 90, "", 0),
        (3, 0, 400, "", 0),
    ]
    assert air.clock_us - START_US == 750_000, "the last one has its period too"


@pytest.mark.parametrize("hz", [1, 2.5, 3, 10])
def test_the_pace_does_not_drift(hz: float) -> None:
    sent = ran(ScriptedAir(wake_us=[80] * 1000, take_us=[300] * 1000), hz, 60)
    assert len(sent) == round(60 * hz)
    for number, each in enumerate(sent):
        assert abs(each.due_us - START_US - (number + 0.5) * 1e6 / hz) <= 0.5
        assert each.host_us == each.due_us + 80


def test_reset_goes_first_and_once() -> None:
    air = ScriptedAir()
    ran(air, reset=True)
    assert air.sent[0] == (START_US, RESET_CLOCKS)
    assert [packet[:2] for _, packet in air.sent[1:]] == [b"\xd2\x62"] * 8


@pytest.mark.parametrize("asleep_us", [100_000, 250_000, 260_000, 1_000_000, 5_000_000])
def test_those_whose_time_has_passed_are_left_out(asleep_us: int) -> None:
    """After a computer has slept: no burst, and the pace is the one from before."""
    sent = ran(ScriptedAir(wake_us=[0, 0, asleep_us]), duration_s=10)
    late = sent[2]
    assert late.late_us == asleep_us
    skipped = late.skipped
    assert skipped == max(-(-asleep_us // 250_000) - 1, 0)
    assert all(not each.skipped and not each.late_us for each in sent[:2] + sent[3:])
    assert [each.sequence - FIRST for each in sent] == list(range(1, 41 - skipped))
    assert all(b.due_us >= a.done_us for a, b in pairwise(sent))


def test_the_number_wraps() -> None:
    air = ScriptedAir(clock_us=50_000 * (WRAP - 3))
    assert [each.sequence for each in ran(air)][:5] == [WRAP - 2, WRAP - 1, 0, 1, 2]
    assert air.sent[1][1][2:6] == b"\xff\xff\xff\xff"


@pytest.mark.parametrize("hz", [1, 4, 10])
def test_a_sender_that_is_started_again_goes_on(hz: float) -> None:
    """Without a pause even: no number comes twice, or goes back."""
    air = ScriptedAir(wake_us=[700] * 1000)
    first = ran(air, hz, 10)
    second = ran(air, hz, 10)
    numbers = [each.sequence for each in first + second]
    assert all(a < b for a, b in pairwise(numbers))


def test_what_is_not_taken_is_counted_and_its_number_is_used_up() -> None:
    air = ScriptedAir(take_us=[0, None, None, 0])
    sent = ran(air)
    assert [bool(each.failed) for each in sent] == [False, True, True, False, False, False, False, False]
    numbers = [struct.unpack_from("<I", packet, 2)[0] for _, packet in air.sent]
    assert [each - FIRST for each in numbers] == [1, 4, 5, 6, 7, 8], (
        "whether it was sent is not known, so it is never sent again"
    )
    tally = Tally()
    for each in sent:
        tally.add(each)
    record = tally.record()
    assert [record[key] for key in ("sequence", "sent", "failed", "skipped")] == [FIRST + 8, 6, 2, 0]
    assert {value for key, value in record.items() if "_us_" in key} == {0}


def test_the_end_of_a_dongle() -> None:
    sender = beacons(ScriptedAir(gone_after=3), 4, None, lambda: False)
    assert [next(sender).sequence - FIRST for _ in range(3)] == [1, 2, 3]
    with pytest.raises(ConnectionLostError):
        next(sender)
    air = ScriptedAir(take_us=[0, *[None] * (SILENT_MAX - 1), 0, *[None] * SILENT_MAX])
    sender = beacons(air, 4, None, lambda: False)
    assert [bool(next(sender).failed) for _ in range(11)] == [False, *[True] * 4, False, *[True] * 5]
    with pytest.raises(PeerSilentError, match="5 packets in a row"):
        next(sender)


def test_percentiles() -> None:
    tally = Tally()
    for late in range(101):
        tally.add(Sent(late, 1000, 1000 + late, 1000 + 3 * late, "", 0))
    record = tally.record()
    assert [record[f"late_us_{name}"] for name in ("p50", "p95", "max")] == [50, 95, 100]
    assert [record[f"transfer_us_{name}"] for name in ("p50", "p95", "max")] == [100, 190, 200]


def test_what_the_dongle_is_told_is_bytes_alone() -> None:
    told = {each.request: (each.value, each.data) for each in settings(parse("radio://0/42/1M"))}
    assert told == {3: (1, b""), 1: (42, b""), 0x20: (0, b""), 2: (0, BROADCAST), 4: (3, b""), 0x10: (0, b"")}


@pytest.mark.parametrize(
    ("more", "why"),
    [
        (["--port", "sim://swarm", "--hz", "0.5"], "--hz 0.5: allowed is 1 to 10"),
        (["--port", "sim://swarm", "--hz", "nan"], "--hz nan: allowed is 1 to 10"),
        (["--port", "sim://swarm", "--duration", "0"], "allowed is more than 0"),
        (["--port", "sim://swarm", "--duration", "0.1"], "too short for a beacon"),
        (["--port", "sim://swarm", "--log", ""], "--log: its name is empty"),
        (["--port", "sim://swarm?beacon_hz=1"], "beacon_hz is another host"),
        (["--port", "sim://nowhere"], "nowhere"),
        (["--port", "/dev/ttyUSB0"], "nothing that broadcasts: give radio://"),
        (["--port", "radio://0"], "write radio://DONGLE/CHANNEL/RATE, such as radio://0/80/2M"),
    ],
)
def test_what_is_refused(more: list[str], why: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sync", "beacons", *more]) == 2
    assert why in capsys.readouterr().err


def test_a_radio_is_no_port_for_images(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stream", "--port", "radio://0/80/2M"]) == 2
    assert "it is for 'host sync beacons'" in capsys.readouterr().err
