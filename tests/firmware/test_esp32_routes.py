"""The ESP32 as a router: who gets what, and what a broken neighbour on UART2, SPI or TCP costs."""

import random

import pytest
from board import (
    APP,
    BOOTLOADER,
    CONSOLE,
    CREDIT,
    CRTP,
    ESP32,
    GAP8,
    HOST,
    STM32,
    SYSTEM,
    TEST,
    WIFI_CTRL,
    App,
    cpx,
    link,
    uart,
)
from c_memory import POISONS
from esp32_rig import (
    CLIENT,
    NO_MESSAGE,
    PORT_OF,
    esp32,
    from_spi,
    from_tcp,
    give,
    out,
)

ROUTES = [
    (source, destination, function)
    for source in PORT_OF
    for destination in PORT_OF
    for function in (SYSTEM, CONSOLE, CRTP, WIFI_CTRL, APP, TEST, BOOTLOADER, 0, 63)
    if (source, destination, function) != (GAP8, HOST, APP)  # the image stream
]


@pytest.mark.parametrize("poison", POISONS)
@pytest.mark.parametrize(("source", "destination", "function"), ROUTES)
def test_every_packet_goes_where_its_route_says(source: int, destination: int, function: int, poison: int) -> None:
    app = esp32(poison=poison)
    packet = cpx(source, destination, function, b"data", last=0, reserved=1)
    give(app, PORT_OF[source], packet)
    received = {port: out(app, port) for port in ("UART2", "SPI", "TCP")}
    wanted = [packet] if source != destination else []
    assert received == {port: wanted if port == PORT_OF[destination] else [] for port in received}
    assert app.packets_unroutable == (source == destination)


@pytest.mark.parametrize("destination", [0, 5, 6, 7])
@pytest.mark.parametrize("port", ["UART2", "SPI"])
def test_a_packet_for_nobody_is_counted(port: str, destination: int) -> None:
    app = esp32()
    give(app, port, cpx(STM32, destination, TEST, b"\x01"))
    assert app.packets_unroutable == 1
    assert [out(app, link_) for link_ in ("UART2", "SPI", "TCP")] == [[], [], []]


@pytest.mark.parametrize("port", ["UART2", "SPI", "TCP"])
def test_a_wrong_version_is_dropped_and_the_next_packet_goes_its_own_way(port: str) -> None:
    app = esp32()
    give(app, port, cpx(HOST, ESP32, TEST, b"\x00"))
    give(app, port, cpx(STM32, ESP32, TEST, b"\x01", version=1))
    if port == "UART2":
        assert app.uart2.bad_version == 1
    elif port == "SPI":
        assert app.packets_unroutable == 1
    else:
        assert app.tcp_rx.skipped_bytes > 0
    assert [out(app, link_) for link_ in ("UART2", "SPI", "TCP")] == [[], [], []]


@pytest.mark.parametrize("port", ["UART2", "SPI", "TCP"])
def test_a_packet_without_data_is_dropped_and_counted(port: str) -> None:
    app = esp32()
    give(app, port, cpx(HOST, GAP8 if port != "SPI" else STM32, TEST, b""))
    assert app.packets_empty == 1
    assert [out(app, link_) for link_ in ("UART2", "SPI", "TCP")] == [[], [], []]


@pytest.mark.parametrize("size", [1, 97, 98, 99, 196, 197, 1019, 1020])
@pytest.mark.parametrize("last", [0, 1])
def test_a_long_packet_is_cut_for_uart2(size: int, last: int) -> None:
    app = esp32()
    data = random.Random(size).randbytes(size)
    give(app, "TCP", cpx(HOST, STM32, APP, data, last=last))
    pieces = [data[at : at + 98] for at in range(0, size, 98)]
    expected = [cpx(HOST, STM32, APP, piece, last=0) for piece in pieces[:-1]]
    assert app.uart_packets(0) == [*expected, cpx(HOST, STM32, APP, pieces[-1], last=last)]


def test_packets_for_a_host_that_is_not_there_are_not_kept() -> None:
    app = esp32(client=False)
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"\0"))
    give(app, "SPI", cpx(GAP8, HOST, APP, b"?"))
    assert app.packets_unsent == 2
    app.receive("NETWORK", CLIENT, 0)
    assert from_tcp(app) == []


def test_the_credit_waits_for_room_and_never_for_ever() -> None:
    app = esp32()
    for n in range(16):
        give(app, "UART2", cpx(STM32, HOST, CRTP, bytes([n])))
        assert app.uart_bytes("UART2", 0) == CREDIT
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"held"), 1000)
    assert app.uart_bytes("UART2", 50_999) == b""
    assert app.deadline() == 51_000
    assert app.uart_bytes("UART2", 51_000) == CREDIT
    assert app.packets_dropped == 1
    assert [packet[2:] for packet in from_tcp(app)] == [bytes([n]) for n in range(16)]


def test_a_held_packet_goes_as_soon_as_there_is_room() -> None:
    app = esp32()
    for n in range(17):
        give(app, "UART2", cpx(STM32, HOST, CRTP, bytes([n])))
    app.transmit("TCP", 10, size=5)
    assert app.uart_bytes("UART2", 10) == CREDIT
    assert [packet[2:] for packet in from_tcp(app)][-1] == bytes([16])
    assert app.packets_dropped == 0


def test_a_packet_that_comes_without_a_credit_is_dropped_if_one_is_held() -> None:
    app = esp32()
    for n in range(18):
        give(app, "UART2", cpx(STM32, HOST, CRTP, bytes([n])))
    assert app.packets_dropped == 1
    from_tcp(app)
    assert app.uart_bytes("UART2", 0) == CREDIT
    assert from_tcp(app) == [cpx(STM32, HOST, CRTP, bytes([16]))]


def test_a_lost_credit_is_given_again() -> None:
    app = esp32()
    assert app.uart_bytes("UART2", 99_999) == b""
    assert app.deadline() == 100_000
    assert app.uart_bytes("UART2", 100_000) == CREDIT


@pytest.mark.parametrize(
    ("noise", "counter"),
    [
        (uart(cpx(STM32, HOST, CRTP, b"abc"))[:-1] + b"\0", "bad_check"),
        (b"\xff\x01", "bad_length"),
        (b"\xff\x65", "bad_length"),
        (b"\xff\xfe", "bad_length"),
        (b"garbage", "garbage_bytes"),
        (uart(cpx(STM32, HOST, CRTP, b"abc", version=2)), "bad_version"),
    ],
)
def test_a_damaged_frame_on_uart2_is_counted_and_the_next_one_comes_through(noise: bytes, counter: str) -> None:
    app = esp32()
    app.receive("UART2", noise, 0)
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"next"), 30_000)
    assert getattr(app.uart2, counter) > 0
    assert from_tcp(app) == [cpx(STM32, HOST, CRTP, b"next")]


def test_a_frame_that_stops_half_way_costs_nothing_else() -> None:
    app = esp32()
    app.receive("UART2", uart(cpx(STM32, HOST, CRTP, b"first"))[:6], 0)
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"next"), 20_000)
    assert app.uart2.gaps == 1
    assert from_tcp(app) == [cpx(STM32, HOST, CRTP, b"next")]


def test_the_gap8_is_told_at_boot_to_start_its_app() -> None:
    app = App("esp32")
    assert app.transmit("SPI", 0) == bytes.fromhex("0300 540f 06")
    assert app.transmit("SPI", 0) == NO_MESSAGE


@pytest.mark.parametrize(
    "window", [b"\x01\x00\x00\x00", b"\xff\x03" + bytes(1022), b"\xff\xff" + bytes(6), b"\x09\x00"]
)
def test_a_window_that_makes_no_sense_is_an_error(window: bytes) -> None:
    app = esp32()
    app.receive("SPI", window, 0)
    assert app.spi_errors == 1


def test_the_padding_of_a_window_is_ignored() -> None:
    app = esp32()
    app.receive("SPI", link(cpx(GAP8, STM32, TEST, b"abc")) + b"\xa5" * 7, 0)
    app.receive("SPI", bytes(8), 0)
    assert app.uart_packets(0) == [cpx(GAP8, STM32, TEST, b"abc")]
    assert app.spi_errors == 0


def test_what_the_gap8_sends_too_fast_for_uart2_is_dropped_and_counted() -> None:
    app = esp32()
    for n in range(20):
        give(app, "SPI", cpx(GAP8, STM32, TEST, bytes([n])))
    assert [packet[2:] for packet in app.uart_packets(0)] == [bytes([n]) for n in range(8)]
    assert app.packets_dropped == 12


def test_packets_come_whole_from_any_split_of_the_stream() -> None:
    stream = bytes.fromhex("040019012101") + link(cpx(HOST, GAP8, TEST, b"x" * 30))
    for cut in range(len(stream) + 1):
        app = esp32()
        assert app.receive("TCP", stream[:cut], 0) == cut
        assert app.receive("TCP", stream[cut:], 0) == len(stream) - cut
        assert app.uart_packets(0) == [bytes.fromhex("19012101")]
        assert from_spi(app) == [cpx(HOST, GAP8, TEST, b"x" * 30)]


def test_packets_come_whole_byte_by_byte() -> None:
    app = esp32()
    for byte in link(cpx(HOST, STM32, SYSTEM, b"\x21\x01")):
        app.receive("TCP", bytes([byte]), 0)
    assert app.uart_packets(0) == [cpx(HOST, STM32, SYSTEM, b"\x21\x01")]


@pytest.mark.parametrize(
    "garbage", [b"\xff\x03\x19\x01", b"\x01\x00", b"\x00\x00\x00", b"\xff" * 9, b"GET / HTTP/1.1\r\n"]
)
def test_the_stream_is_found_again_after_garbage(garbage: bytes) -> None:
    app = esp32()
    packets = [cpx(HOST, STM32, TEST, bytes([1, n])) for n in range(4)]
    app.receive("TCP", garbage + b"".join(map(link, packets)), 0)
    assert app.tcp_rx.skipped_bytes >= len(garbage)
    assert app.uart_packets(0) == packets


def test_reading_stops_behind_a_packet_without_room() -> None:
    app = esp32()
    packets = [cpx(HOST, STM32, TEST, bytes([0, n])) for n in range(12)]
    stream = b"".join(map(link, packets))
    taken = app.receive("TCP", stream, 0)
    assert taken == 9 * 6  # eight are queued, one is held
    assert app.receive("TCP", stream[taken:], 10) == 0
    received = app.uart_packets(20)
    assert app.receive("TCP", stream[taken:], 30) == len(stream) - taken
    assert received + app.uart_packets(40) == packets
    assert app.packets_dropped == 0


def test_a_dead_stm32_does_not_cut_the_host_off_for_ever() -> None:
    app = esp32()
    for n in range(2):
        give(app, "TCP", cpx(HOST, STM32, TEST, bytes([0, n])))
        app.uart_bytes("UART2", 0)  # the first takes the last credit, the second waits for one
    stream = b"".join(link(cpx(HOST, STM32, TEST, bytes([0, n]))) for n in range(9))
    assert app.receive("TCP", stream, 0) == len(stream)
    app.uart_bytes("UART2", 999_999)
    assert app.receive("TCP", link(cpx(HOST, GAP8, TEST, b"\x01")), 999_999) == 0
    assert app.deadline() == 1_000_000
    assert app.receive("TCP", link(cpx(HOST, GAP8, TEST, b"\x01")), 1_000_000) == 5
    assert app.packets_dropped == 1
    assert from_spi(app, 1_000_000) == [cpx(HOST, GAP8, TEST, b"\x01")]


@pytest.mark.parametrize("size", [1, 2, 3, 5, 7, 1440])
def test_packets_go_to_tcp_in_pieces_of_any_size(size: int) -> None:
    app = esp32()
    packets = [cpx(STM32, HOST, CRTP, bytes([n]) * (n + 1)) for n in range(16)]
    for packet in packets:
        give(app, "UART2", packet)
    assert from_tcp(app, size=size) == packets
