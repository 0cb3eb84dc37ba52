"""CPX over UART: frames, and one end of the line byte by byte. Two ends together are in test_core_uart_line.py."""

import random
from collections.abc import Iterator
from functools import reduce
from operator import xor
from typing import Any

import pytest
from c_memory import POISONS, Bytes, Room, poisoned, seen, untouched

from host.native import ffi, lib

# Bytes of real links, and what they mean: destination, source, function, last packet, data.
CONNECT = bytes.fromhex("ff 04 0a 04 20 01 d4")
CLIENT = bytes.fromhex("ff 04 51 04 32 01 9d")
VECTORS = [(CONNECT, (2, 1, 4, False), "20 01"), (CLIENT, (1, 2, 4, True), "32 01")]
CREDIT = b"\xff\x00"
NEVER_US = 2**64 - 1

Fields = tuple[int, int, int, bool]


def new_packet(fields: Fields, data: Bytes) -> Any:
    destination, source, function, last_packet = fields
    route = {"destination": destination, "source": source, "function": function, "last_packet": last_packet}
    return ffi.new("cpx_packet_t *", (route, data.view))


def frame(data: bytes, route: bytes = b"\x0a\x04") -> bytes:
    """A frame made without the C."""
    unchecked = bytes([0xFF, 2 + len(data)]) + route + data
    return unchecked + bytes([reduce(xor, unchecked)])


@pytest.mark.parametrize(("wire", "fields", "data"), VECTORS)
@pytest.mark.parametrize("poison", POISONS)
def test_encode(wire: bytes, fields: Fields, data: str, poison: int) -> None:
    source = Bytes(bytes.fromhex(data))
    room = Room(len(wire) + 3, poison)
    assert lib.cpx_uart_encode(new_packet(fields, source), room.view) == len(wire)
    assert bytes(room) == wire + bytes([poison]) * 3
    for size in range(len(wire)):
        room = Room(size, poison)
        assert lib.cpx_uart_encode(new_packet(fields, source), room.view) == 0
        assert bytes(room) == bytes([poison]) * size


def test_encode_longest_and_one_more() -> None:
    data = random.Random(1).randbytes(99)
    room = Room(200)
    longest = Bytes(data[:98])
    assert lib.cpx_uart_encode(new_packet((2, 1, 4, False), longest), room.view) == 103
    assert bytes(room)[:103] == frame(data[:98])
    too_long = Bytes(data)
    assert lib.cpx_uart_encode(new_packet((2, 1, 4, False), too_long), room.view) == 0


@pytest.mark.parametrize(("wire", "fields", "data"), VECTORS)
@pytest.mark.parametrize("tail", [b"", b"\xff", bytes(200)])
def test_decode(wire: bytes, fields: Fields, data: str, tail: bytes) -> None:
    packet, memory = ffi.new("cpx_packet_t *"), Bytes(wire + tail)
    assert lib.cpx_uart_decode(memory.view, packet) == len(wire)
    route = packet.route
    assert (route.destination, route.source, route.function, route.last_packet) == fields
    assert seen(packet.data) == bytes.fromhex(data)


@pytest.mark.parametrize(
    ("wire", "result"),
    [
        *((CONNECT[:size], lib.ERR_SHORT) for size in range(len(CONNECT))),
        *((CONNECT[:i] + bytes([CONNECT[i] ^ 1]) + CONNECT[i + 1 :], lib.ERR_CHECK) for i in range(2, len(CONNECT))),
        (b"\xfe", lib.ERR_START),
        (b"\xff\x01", lib.ERR_LENGTH),
        (b"\xff\x65" + bytes(200), lib.ERR_LENGTH),
        (b"\xff\xff" + bytes(300), lib.ERR_LENGTH),
        (CREDIT, 2),
        (CREDIT + CONNECT, 2),
    ],
)
@pytest.mark.parametrize("poison", POISONS)
def test_decode_without_a_packet_leaves_it_alone(wire: bytes, result: int, poison: int) -> None:
    packet = poisoned("cpx_packet_t", poison)
    assert lib.cpx_uart_decode(Bytes(wire).view, packet) == result
    assert untouched(packet, poison)


class End:
    """One end of the line, with a clock of its own and the packets that came out of it."""

    def __init__(self, now_us: int = 0, auto_accept: bool = True) -> None:
        self.state = ffi.new("cpx_uart_t *")
        lib.cpx_uart_init(self.state, now_us)
        self.now_us = now_us
        self.auto_accept = auto_accept
        self.packets: list[bytes] = []

    def receive(self, data: bytes, byte_us: int = 17) -> None:
        packet = ffi.new("cpx_packet_t *")
        for byte in data:
            self.now_us += byte_us
            if lib.cpx_uart_receive(self.state, byte, self.now_us, packet):
                self.packets.append(seen(packet.data))
                if self.auto_accept:
                    lib.cpx_uart_accept(self.state)

    def send(self, data: bytes) -> bool:
        source = Bytes(data)
        return bool(lib.cpx_uart_send(self.state, new_packet((2, 1, 4, False), source)))

    def bytes_to_send(self) -> Iterator[int]:
        """All that goes out now, checked against the deadline at each byte."""
        out = ffi.new("uint8_t *")
        while lib.cpx_uart_transmit(self.state, out, self.now_us):
            yield out[0]
            self.now_us += 17
        assert lib.cpx_uart_deadline(self.state) > self.now_us

    def transmit(self) -> bytes:
        return bytes(self.bytes_to_send())

    @property
    def deadline_us(self) -> int:
        return int(lib.cpx_uart_deadline(self.state))


def ready_end(auto_accept: bool = True) -> End:
    """An end after the handshake."""
    end = End(auto_accept=auto_accept)
    assert end.transmit() == CREDIT
    end.receive(CREDIT)
    return end


def test_handshake_is_repeated_until_there_is_a_packet() -> None:
    end = End(now_us=5_000_000)
    assert end.deadline_us == 0
    assert end.transmit() == CREDIT
    for repeats in range(1, 20):
        last_byte_us = end.now_us - 17
        assert end.deadline_us == last_byte_us + lib.CPX_UART_CREDIT_US
        end.now_us = end.deadline_us - 1
        assert end.transmit() == b""
        end.now_us += 1
        assert end.transmit() == CREDIT
        assert end.state.credits_repeated == repeats


def test_no_packet_without_a_credit_and_one_for_each() -> None:
    end = End()
    assert end.send(b"one")
    assert not end.send(b"two")
    assert end.transmit() == CREDIT
    end.receive(CREDIT + CREDIT)  # two collapse to one
    assert end.transmit() == frame(b"one")
    assert end.send(b"two")
    assert end.transmit() == b""
    end.receive(CREDIT)
    assert end.transmit() == frame(b"two")
    assert end.state.packets_out == 2
    assert end.state.credits_in == 3


def test_send_refuses_too_long_a_packet_and_stays_free() -> None:
    end = ready_end()
    assert not end.send(bytes(99))
    assert end.send(bytes(98))
    assert end.transmit() == frame(bytes(98))


def test_send_takes_a_copy() -> None:
    end = ready_end()
    source = Bytes(b"before")
    assert lib.cpx_uart_send(end.state, new_packet((2, 1, 4, False), source))
    ffi.buffer(source.memory)[:] = b"after!"
    assert end.transmit() == frame(b"before")


def test_a_credit_never_goes_inside_a_frame_nor_a_frame_inside_a_credit() -> None:
    end = ready_end()
    assert end.send(b"data")
    out = ffi.new("uint8_t *")
    line = bytearray()
    for _ in range(3):
        assert lib.cpx_uart_transmit(end.state, out, end.now_us)
        line += bytes([out[0]])
    end.receive(CONNECT)  # comes in, is accepted: a credit is owed in the middle of the frame
    line += end.transmit()
    assert line == frame(b"data") + CREDIT

    end.receive(CONNECT)
    assert lib.cpx_uart_transmit(end.state, out, end.now_us)
    assert out[0] == 0xFF
    assert end.send(b"more")
    end.receive(CREDIT)
    assert end.transmit() == b"\x00" + frame(b"more")


def test_no_credit_until_the_packet_is_accepted() -> None:
    end = ready_end(auto_accept=False)
    end.receive(CONNECT)
    assert end.packets == [b"\x20\x01"]
    assert end.deadline_us == NEVER_US
    end.now_us += 10_000_000
    assert end.transmit() == b""
    lib.cpx_uart_accept(end.state)
    assert end.deadline_us == 0
    assert end.transmit() == CREDIT


def test_a_bad_frame_while_one_is_held_gives_no_credit() -> None:
    end = ready_end(auto_accept=False)
    end.receive(CONNECT)
    end.receive(CONNECT[:-1] + b"\x00")
    end.receive(frame(b"x", route=b"\x0a\x44"))
    assert end.state.bad_check == 1
    assert end.state.bad_version == 1
    assert end.transmit() == b""


def test_while_a_packet_is_coming_in_the_credit_is_not_repeated() -> None:
    end = ready_end()
    end.now_us = end.deadline_us - 30
    end.receive(CONNECT[:4])
    assert end.transmit() == b""
    end.receive(CONNECT[4:])
    assert end.packets == [b"\x20\x01"]
    assert end.transmit() == CREDIT
    assert end.state.credits_repeated == 0


def test_noise_that_looks_like_a_start_holds_the_credit_back_for_a_gap_only() -> None:
    end = ready_end()
    end.now_us = end.deadline_us - 30
    end.receive(b"\xff")
    assert end.deadline_us == end.now_us + lib.CPX_UART_GAP_US
    end.now_us = end.deadline_us
    assert end.transmit() == CREDIT


@pytest.mark.parametrize(
    ("wire", "counter", "count"),
    [
        (CONNECT[:-1] + b"\x00", "bad_check", 1),
        (frame(b"hello", route=b"\x0a\x44"), "bad_version", 1),
        (b"\xff\x01", "bad_length", 1),
        (b"\xff\x65", "bad_length", 1),
        (b"\xff\xff\xff\xff", "bad_length", 4),  # the last of them with the start of the good frame
        (b"noise", "garbage_bytes", 5),
    ],
)
def test_each_fault_has_its_counter_and_costs_nothing_else(wire: bytes, counter: str, count: int) -> None:
    end = ready_end()
    end.receive(wire + CLIENT + CONNECT)
    assert end.packets == [b"\x32\x01", b"\x20\x01"]
    assert getattr(end.state, counter) == count


@pytest.mark.parametrize("wire", [CONNECT[:-1] + b"\x00", frame(b"hello", route=b"\x0a\x44")])
def test_a_bad_frame_is_credited(wire: bytes) -> None:
    end = ready_end()
    end.receive(wire)
    assert end.packets == []
    assert end.transmit() == CREDIT
    assert end.state.credits_repeated == 0


@pytest.mark.parametrize("length", range(2, 101))
def test_a_false_start_costs_no_frame(length: int) -> None:
    """It announces more bytes than it is, and swallows what comes next until they are there, or a gap."""
    sent = [bytes([n] * 5) for n in range(12)]
    end = ready_end()
    end.receive(bytes([0xFF, length]) + b"".join(frame(data) for data in sent))
    end.now_us += lib.CPX_UART_GAP_US
    end.receive(CREDIT * len(sent))  # what was found in the buffer comes out one at a time
    assert end.packets == sent


@pytest.mark.parametrize("size", range(1, len(CONNECT)))
def test_a_frame_that_stops_is_given_up_after_the_gap(size: int) -> None:
    end = ready_end()
    end.receive(CONNECT[:size])
    end.now_us += lib.CPX_UART_GAP_US - 1
    end.receive(CLIENT)
    assert end.state.gaps == 1
    assert end.packets == [b"\x32\x01"]
    assert end.state.garbage_bytes == size


def test_a_pause_shorter_than_the_gap_is_no_gap() -> None:
    end = ready_end()
    for byte in CONNECT:
        end.receive(bytes([byte]), byte_us=lib.CPX_UART_GAP_US - 1)
    assert end.packets == [b"\x20\x01"]
    assert end.state.gaps == 0


def test_the_longest_and_the_shortest_frame_back_to_back() -> None:
    longest = random.Random(2).randbytes(98)
    end = ready_end()
    end.receive((frame(longest) + frame(b"")) * 3)
    assert end.packets == [longest, b""] * 3


@pytest.mark.parametrize("seed", range(30))
def test_every_byte_is_accounted_for_and_deadlines_tell_the_truth(seed: int) -> None:
    rng = random.Random(seed)
    end = End(auto_accept=False)
    out, packet = ffi.new("uint8_t *"), ffi.new("cpx_packet_t *")
    wire = b"".join(
        rng.choice(
            [CREDIT, frame(rng.randbytes(rng.randrange(99))), frame(b"\xff\x00" * 20), rng.randbytes(3), b"\xff"]
        )
        for _ in range(300)
    )
    good_bytes = 0
    for count, byte in enumerate(wire, 1):
        flipped = byte ^ (1 << rng.randrange(8)) if rng.random() < 0.003 else byte
        end.now_us += rng.choice([17, 17, 17, 17, 17, 17, 17, 17, 25_000]) if rng.random() < 0.1 else 17
        if lib.cpx_uart_receive(end.state, flipped, end.now_us, packet):
            good_bytes += packet.data.size + 5
        state = end.state
        if state.bad_version == 0:
            waiting = state.rx_fill - state.rx_taken
            assert count == good_bytes + 2 * state.credits_in + state.garbage_bytes + waiting
        if rng.random() < 0.3:
            lib.cpx_uart_accept(state)
        if rng.random() < 0.1:
            end.send(rng.randbytes(rng.randrange(99)))
        has_a_byte = lib.cpx_uart_deadline(state) <= end.now_us
        assert lib.cpx_uart_transmit(state, out, end.now_us) == has_a_byte
