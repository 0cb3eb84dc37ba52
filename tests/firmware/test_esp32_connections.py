"""Clients that come and go, and what the ESP32 itself answers and says."""

import struct

import pytest
from board import (
    APP,
    BOOTLOADER,
    CONSOLE,
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
from esp32_rig import (
    CLIENT,
    CLIENT_GONE,
    NATIVE_REQUEST,
    NETWORK_DOWN,
    PORT_OF,
    ask,
    esp32,
    from_spi,
    from_tcp,
    give,
    give_all,
    out,
    sealed,
    stock_frame,
    told,
)


def test_client_messages_go_to_the_gap8_and_the_stm32() -> None:
    app = esp32(client=False)
    from_spi(app)
    app.receive("NETWORK", CLIENT, 0)
    assert from_spi(app) == told(1, GAP8)
    assert [uart(packet) for packet in app.uart_packets(0)] == [bytes.fromhex("ff 04 51 04 32 01 9d")]
    app.receive("NETWORK", CLIENT_GONE, 0)
    assert from_spi(app) + app.uart_packets(0) == told(0, GAP8, STM32)
    app.receive("NETWORK", CLIENT_GONE, 0)
    assert from_spi(app) + app.uart_packets(0) == []


def test_both_neighbours_are_told_again_every_second() -> None:
    app = esp32(client=False)
    give(app, "UART2", cpx(STM32, ESP32, WIFI_CTRL, b"\x10name"))
    app.uart_packets(100_000)
    from_spi(app)
    for second in (1.1, 2.1):
        assert app.uart_packets(int(second * 1e6) - 1) == []
        assert from_spi(app) == []
        assert app.uart_packets(int(second * 1e6)) == told(0, STM32)
        assert from_spi(app) == told(0, GAP8)
    app.receive("NETWORK", CLIENT, 2_500_000)
    from_spi(app)
    assert app.uart_packets(3_499_999) == told(1, STM32)
    assert from_spi(app) == []
    assert app.uart_packets(3_500_000) == told(1, STM32)
    assert from_spi(app) == told(1, GAP8)


def test_without_wifi_settings_the_neighbours_are_told_ten_times_a_second() -> None:
    """The STM32 may believe that all is well: it was the ESP32 that has restarted."""
    app = esp32(client=False)
    for tenth in range(1, 6):
        assert app.uart_packets(tenth * 100_000) == told(0, STM32)
        assert app.uart_packets(tenth * 100_000 + 99_999) == []


def test_who_does_not_listen_is_not_told_more_and_more() -> None:
    app = App("esp32")
    for now_us in range(0, 5_000_000, 100_000):
        app.uart_bytes("UART2", now_us)  # no credit comes
    assert app.to_spi.fill == 1  # "start the application", from before
    assert app.to_uart.fill <= 1
    assert app.packets_dropped == 0


def test_nothing_of_an_old_connection_reaches_the_next() -> None:
    app = esp32()
    give_all(app, stock_frame(324, 244))
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"old"))
    app.transmit("TCP", 0, size=3)  # inside a packet
    app.receive("TCP", link(cpx(HOST, STM32, TEST, b"\x01half"))[:7], 0)
    app.receive("NETWORK", CLIENT_GONE, 0)
    assert app.transmit("TCP", 0) == b""
    assert app.packets_unsent == 1 + 79
    app.receive("NETWORK", CLIENT, 0)
    assert app.transmit("TCP", 0) == b""
    assert app.receive("TCP", link(cpx(HOST, STM32, TEST, b"\x00new")), 0) == 8
    assert app.uart_packets(0)[-1] == cpx(HOST, STM32, TEST, b"\x00new")
    assert app.tcp_rx.skipped_bytes == 0
    frame = stock_frame(20, 20, 5)
    give_all(app, frame)
    assert from_tcp(app) == frame


def test_an_image_packet_cut_by_the_end_of_a_connection_is_forgotten() -> None:
    app = esp32()
    give_all(app, stock_frame(324, 244))
    app.transmit("TCP", 0, size=500)
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    app.uart_packets(0)
    frame = stock_frame(20, 20, 5)
    give_all(app, frame)
    assert from_tcp(app) == frame


def test_a_queued_packet_cut_by_the_end_of_a_connection_is_forgotten() -> None:
    app = esp32()
    give(app, "UART2", cpx(STM32, HOST, CRTP, b"old"))
    app.transmit("TCP", 0, size=3)
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    packet = cpx(STM32, HOST, CRTP, b"new")
    give(app, "UART2", packet)
    assert from_tcp(app) == [packet]


def test_an_answer_that_waited_for_the_old_client_is_not_given_to_the_next() -> None:
    app = esp32()
    for n in range(16):
        give(app, "UART2", cpx(STM32, HOST, CRTP, bytes([n])))
    give(app, "TCP", cpx(HOST, ESP32, TEST, b"\x01old"))  # no room for the answer
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    app.uart_packets(0)
    assert from_tcp(app) == []
    assert app.packets_dropped == 1


@pytest.mark.parametrize("source", [STM32, GAP8, HOST])
def test_echo_answers_whoever_asked_and_sink_nobody(source: int) -> None:
    app = esp32()
    port = PORT_OF[source]
    give(app, port, cpx(source, ESP32, TEST, b"\x01echo"))
    give(app, port, cpx(source, ESP32, TEST, b"\x00sink"))
    assert out(app, port) == [cpx(ESP32, source, TEST, b"\x01echo")]
    assert app.packets_unroutable == 0


@pytest.mark.parametrize("source", [STM32, HOST])
def test_the_gap8_can_be_reset(source: int) -> None:
    app = esp32()
    port = PORT_OF[source]
    give(app, port, cpx(source, ESP32, SYSTEM, b"\x10"))
    assert app.transmit("NETWORK", 0) == b"\x11"
    assert app.transmit("NETWORK", 0) == b""
    assert out(app, port) == [cpx(ESP32, source, SYSTEM, b"\x10")]
    assert app.gap8_resets == 1


@pytest.mark.parametrize(
    ("function", "data"),
    [
        (SYSTEM, b"\x11"),
        (CONSOLE, b"?"),
        (CRTP, b"?"),
        (BOOTLOADER, b"\0"),
        (TEST, b"\x02"),
        (APP, b"\x4e\x10\x02\0\0\0"),
    ],
)
def test_what_the_esp32_does_not_know_is_counted(function: int, data: bytes) -> None:
    app = esp32()
    give(app, "TCP", cpx(HOST, ESP32, function, data))
    assert app.packets_unroutable == 1
    assert from_tcp(app) == []
    assert app.transmit("NETWORK", 0) == b""


def wifi(app: App, *commands: bytes, source: int = STM32) -> bytes:
    for command in commands:
        give(app, PORT_OF[source], cpx(source, ESP32, WIFI_CTRL, command))
    return app.transmit("NETWORK", 0)


@pytest.mark.parametrize("source", [STM32, GAP8, HOST])
def test_wifi_is_started_as_told(source: int) -> None:
    assert wifi(esp32(), b"\x10my net", b"\x20\x01", source=source) == b"\x10\x01\x06my net\x00"
    assert (
        wifi(esp32(), b"\x10my net", b"\x11secret 12", b"\x20\x00", source=source) == b"\x10\x00\x06my net\x09secret 12"
    )


def test_a_shorter_name_leaves_nothing_of_the_longer_one() -> None:
    app = esp32()
    wifi(app, b"\x10" + b"n" * 32, b"\x11" + b"k" * 64, b"\x20\x01")
    assert wifi(app, b"\x10net", b"\x11", b"\x20\x01") == b"\x10\x01\x03net\x00"


def test_the_same_settings_do_not_start_the_network_anew() -> None:
    app = esp32()
    settings = (b"\x10net", b"\x1112345678", b"\x20\x01")
    assert wifi(app, *settings) != b""
    assert wifi(app, *settings) == b""
    app.receive("NETWORK", b"\x01\xc0\xa8\x04\x01\x00", 0)
    assert wifi(app, *settings) == b""
    assert wifi(app, b"\x20\x00") == b"\x10\x00\x03net\x0812345678"
    app.receive("NETWORK", NETWORK_DOWN, 0)
    assert wifi(app, b"\x20\x00") == b"\x10\x00\x03net\x0812345678"


@pytest.mark.parametrize(
    "command",
    [
        b"\x10",
        b"\x10" + b"n" * 33,
        b"\x11" + b"k",
        b"\x11" + b"k" * 7,
        b"\x11" + b"k" * 65,
        b"\x20",
        b"\x30",
        b"\x32\x01",
    ],
    ids=bytes.hex,
)
def test_settings_that_cannot_be_used_are_refused_and_change_nothing(command: bytes) -> None:
    app = esp32()
    assert wifi(app, b"\x10net", b"\x1112345678", b"\x20\x01") != b""
    assert wifi(app, command) == b""
    assert app.wifi_refused == 1
    assert wifi(app, b"\x20\x00") == b"\x10\x00\x03net\x0812345678"


def test_connecting_without_a_name_is_refused() -> None:
    app = esp32()
    assert wifi(app, b"\x20\x01") == b""
    assert app.wifi_refused == 1


def test_a_station_tells_its_address() -> None:
    app = esp32()
    app.receive("NETWORK", b"\x01\xc0\xa8\x01\x02\x01", 0)
    message = b"\x31\xc0\xa8\x01\x02"
    assert from_spi(app) == [cpx(ESP32, GAP8, WIFI_CTRL, message)]
    assert app.uart_packets(0) == [cpx(ESP32, STM32, WIFI_CTRL, message)]
    app.receive("NETWORK", b"\x01\xc0\xa8\x04\x01\x00", 0)  # an access point does not
    assert from_spi(app) + app.uart_packets(0) == []


def test_the_network_going_down_takes_its_client_along() -> None:
    app = esp32()
    app.receive("NETWORK", NETWORK_DOWN, 0)
    assert not app.client
    assert from_spi(app) + app.uart_packets(0) == told(0, GAP8, STM32)


def test_status_messages_come_each_second_while_asked_for() -> None:
    app = esp32()
    app.receive("UART2", b"noise", 0)
    give(app, "SPI", cpx(GAP8, 0, TEST, b"\x01"))
    ask(app, 0, ESP32)
    messages = {}
    for up_us in range(0, 2_500_000, 100_000):
        app.uart_bytes("UART2", up_us)
        for packet in from_tcp(app):
            messages[up_us] = packet
    assert list(messages) == [0, 1_000_000, 2_000_000]
    assert messages[2_000_000][:2] == cpx(ESP32, HOST, APP, b"")
    fields = struct.unpack("<BBHQ12I", messages[2_000_000][2:-4])
    assert messages[2_000_000][2:] == sealed(messages[2_000_000][2:-4])
    assert fields[:4] == (0x4E, 4, 0, 2_000_000)
    assert fields[4:] == (0, 0, 0, 0, 0, 1, 0, 0, 5, 0, 0, 0)
    give(app, "TCP", cpx(HOST, ESP32, APP, b"\x4e\x10\x00\x00\x00\x00"))
    app.uart_bytes("UART2", 9_000_000)
    assert from_tcp(app) == []


def test_status_messages_end_with_the_client() -> None:
    app = esp32()
    ask(app, 0, ESP32)
    app.receive("NETWORK", CLIENT_GONE, 0)
    app.receive("NETWORK", CLIENT, 0)
    app.uart_packets(5_000_000)
    assert from_tcp(app) == []


def test_a_packet_that_stops_half_way_is_given_up_and_what_is_behind_it_is_found() -> None:
    """Garbage that looks like the header of a long packet."""
    app = esp32()
    request = link(cpx(HOST, ESP32, APP, NATIVE_REQUEST + b"\0\0"))
    assert app.receive("TCP", b"\xfe\x03\x19\x01" + request, 0) == 4 + len(request)
    assert not app.native
    assert app.deadline() == 100_000  # to tell its neighbours
    app.uart_bytes("UART2", 499_999)
    assert not app.native
    app.uart_bytes("UART2", 500_000)
    assert app.native
    assert app.tcp_rx.skipped_bytes == 4


def test_nothing_stays_of_a_packet_that_is_given_up() -> None:
    app = esp32()
    app.receive("TCP", b"\xfe\x03\x19\x01" * 3, 0)
    app.uart_bytes("UART2", 500_000)
    assert app.tcp_rx.skipped_bytes == 12
    app.receive("TCP", link(cpx(HOST, ESP32, APP, NATIVE_REQUEST + b"\0\0")), 600_000)
    assert app.native
