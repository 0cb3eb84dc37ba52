"""Two ends of CPX over UART with a line between them that loses, changes and invents bytes.

The claim: whatever happens to the line for a while, afterwards every packet gets through again, in both directions.
"""

import random
from collections.abc import Callable
from typing import Any

import pytest
from c_memory import Bytes, seen

from host.native import ffi, lib

BYTE_US = 17
NEVER_US = 2**64 - 1
# What the line makes of one byte: as it is, nothing, another one, several. (The XOR check lets one damage in 256
# pass; the packets below are such that none of these tests meets it.)
Fault = Callable[[int, int, int], bytes]  # direction, number of the byte in that direction, the byte


class Line:
    """Two ends driven as a board does it: a byte leaves when the one before it has, else at the deadline."""

    def __init__(self, fault: Fault, accept_after_us: int = 0) -> None:
        self.now_us = 0
        self.fault = fault
        self.accept_after_us = accept_after_us
        self.ends = [ffi.new("cpx_uart_t *") for _ in range(2)]
        for end in self.ends:
            lib.cpx_uart_init(end, 0)
        self.free_us = [0, 0]  # when the direction's transmitter has sent its last byte
        self.sent = [0, 0]
        self.queues: list[list[bytes]] = [[], []]
        self.received: list[list[bytes]] = [[], []]
        self.in_flight: list[tuple[int, int, bytes]] = []
        self.accepts: list[tuple[int, int]] = []
        self.held = [0, 0]
        self.most_held = 0
        self.steps = 0

    def run_until(self, end_us: int) -> None:
        while True:
            self._transmit()
            next_us = min(self._wake_times(), default=end_us)
            if next_us > end_us:
                self.now_us = end_us
                return
            assert next_us > self.now_us, "a deadline in the past: the caller would never come forward"
            self.steps += 1
            self.now_us = next_us
            self._deliver()

    def _wake_times(self) -> list[int]:
        times = [due for due, _, _ in self.in_flight] + [due for due, _ in self.accepts]
        for side in (0, 1):
            deadline_us = int(lib.cpx_uart_deadline(self.ends[side]))
            times += [max(deadline_us, self.free_us[side])] if deadline_us != NEVER_US else []
        return times

    def _transmit(self) -> None:
        out = ffi.new("uint8_t *")
        for side in (0, 1):
            end = self.ends[side]
            while self.queues[side] and self._send(side, self.queues[side][0]):
                self.queues[side].pop(0)
            if self.free_us[side] <= self.now_us and lib.cpx_uart_transmit(end, out, self.now_us):
                self.free_us[side] = self.now_us + BYTE_US
                arriving = self.fault(side, self.sent[side], out[0])
                self.sent[side] += 1
                self.in_flight.append((self.free_us[side], 1 - side, arriving))

    def _send(self, side: int, data: bytes) -> bool:
        source: Any = Bytes(data)
        route = {"destination": 2 - side, "source": 1 + side, "function": 5}
        return bool(lib.cpx_uart_send(self.ends[side], ffi.new("cpx_packet_t *", (route, source.view))))

    def _deliver(self) -> None:
        packet = ffi.new("cpx_packet_t *")
        for due, side, data in [event for event in self.in_flight if event[0] <= self.now_us]:
            self.in_flight.remove((due, side, data))
            for byte in data:
                if lib.cpx_uart_receive(self.ends[side], byte, self.now_us, packet):
                    self.received[side].append(seen(packet.data))
                    self.held[side] += 1
                    self.most_held = max(self.most_held, self.held[side])
                    self.accepts.append((self.now_us + self.accept_after_us, side))
        for due, side in [accept for accept in self.accepts if accept[0] <= self.now_us]:
            self.accepts.remove((due, side))
            self.held[side] -= 1
            lib.cpx_uart_accept(self.ends[side])


def clean(direction: int, number: int, byte: int) -> bytes:
    return bytes([byte])


def packets(name: str, count: int) -> list[bytes]:
    return [f"{name} {n}".encode() for n in range(count)]


def is_part_of(some: list[bytes], all_: list[bytes]) -> bool:
    """In the same order, with gaps."""
    rest = iter(all_)
    return all(item in rest for item in some)


@pytest.mark.parametrize("accept_after_us", [0, 5, 5000])
def test_a_clean_line_carries_everything_both_ways(accept_after_us: int) -> None:
    line = Line(clean, accept_after_us)
    line.queues = [packets("to the ESP32", 50), packets("to the STM32", 50)]
    line.run_until(2_000_000)
    assert line.received == [packets("to the STM32", 50), packets("to the ESP32", 50)]
    assert line.most_held == 1
    for end in line.ends:
        assert (end.bad_check, end.bad_length, end.garbage_bytes, end.gaps) == (0, 0, 0, 0)


def test_an_idle_line_is_nearly_silent() -> None:
    line = Line(clean)
    line.run_until(10_000_000)
    assert line.sent == [200, 200]
    assert line.steps < 1000


FRAME_BYTES = 5 + len(b"first 0")
# Bytes of one direction that two packets and their credits take, with some to spare.
PLACES = 2 * FRAME_BYTES + 14


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize(
    "damage",
    [b"", b"\x00", b"\xff", b"\xff\x00", b"\xff\x64", b"\xff\x01"],
    ids=["lost", "00", "ff", "credit", "false start", "bad length"],
)
def test_one_damaged_byte_anywhere_costs_at_most_the_packet_it_hits(direction: int, damage: bytes) -> None:
    for place in range(PLACES):

        def fault(side: int, number: int, byte: int, place: int = place) -> bytes:
            return damage if (side, number) == (direction, place) else bytes([byte])

        line = Line(fault)
        before, after = packets("first", 3), packets("later", 3)
        line.queues = [list(before), list(before)]
        line.run_until(1_000_000)
        line.queues = [list(after), list(after)]
        line.run_until(2_000_000)
        for side in (0, 1):
            lost = [data for data in before + after if data not in line.received[side]]
            assert len(lost) <= (1 if side != direction else 0), (place, line.received[side])
            assert not set(after) & set(lost), (place, lost)
            assert is_part_of(line.received[side], before + after), (place, line.received[side])


@pytest.mark.parametrize("seed", range(40))
def test_after_any_storm_the_line_recovers(seed: int) -> None:
    rng = random.Random(seed)
    loss, flip, invent = (rng.choice([0, 0.01, 0.1, 0.5]) for _ in range(3))
    storm = True

    def fault(side: int, number: int, byte: int) -> bytes:
        if not storm:
            return bytes([byte])
        out = b"" if rng.random() < loss else bytes([byte ^ (1 << rng.randrange(8)) if rng.random() < flip else byte])
        return out + (
            rng.choice([b"\xff", b"\xff\x00", b"\xff\x64", rng.randbytes(2)]) if rng.random() < invent else b""
        )

    line = Line(fault, accept_after_us=rng.choice([0, 500]))
    line.queues = [packets("storm", 200), packets("storm", 200)]
    line.run_until(3_000_000)
    storm = False
    line.queues = [[], []]
    line.run_until(3_500_000)
    line.received = [[], []]
    calm = packets("calm", 20)
    line.queues = [list(calm), list(calm)]
    line.run_until(6_000_000)
    assert line.received == [calm, calm]


def test_a_side_that_restarts_is_heard_again() -> None:
    line = Line(clean)
    line.queues = [packets("a", 5), packets("a", 5)]
    line.run_until(2000)
    lib.cpx_uart_init(line.ends[1], line.now_us)
    line.queues[1] = packets("b", 5)
    line.run_until(3_000_000)
    assert line.received[0][-5:] == packets("b", 5)
    assert line.received[1][-1] == packets("a", 5)[-1]
