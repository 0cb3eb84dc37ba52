"""A host on UART2 in the STM32's place; and that no input drives the ESP32 out of its bounds."""

import random
from typing import Any

import pytest
from board import (
    APP,
    CONSOLE,
    CREDIT,
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
    NO_MESSAGE,
    ask,
    esp32,
    from_spi,
    give,
    give_all,
    native_frame,
    stock_frame,
    told,
)


def on_uart() -> App:
    app = App("esp32", host_on_uart=1)
    from_spi(app)
    return app


def test_a_host_on_uart2_is_there_when_it_is_heard() -> None:
    app = on_uart()
    give(app, "SPI", cpx(GAP8, HOST, CONSOLE, b"?"))
    assert app.packets_unsent == 1
    app.receive("UART2", CREDIT, 0)
    assert from_spi(app) == told(1, GAP8)
    packet = cpx(GAP8, HOST, CONSOLE, b"hello\0")
    give(app, "SPI", packet)
    assert app.uart_packets(0) == [packet]
    assert app.transmit("TCP", 0) == b""


def test_images_go_to_a_host_on_uart2_in_pieces_that_can_be_joined() -> None:
    app = on_uart()
    give(app, "UART2", cpx(HOST, GAP8, APP, NATIVE_REQUEST + b"\0\0"))
    from_spi(app)
    app.uart_bytes("UART2", 0)  # the credit for it
    frames = [*stock_frame(324, 24, 1), *native_frame(1000, 2, 50)]
    give_all(app, frames)
    joined, part = [], b""
    for piece in app.uart_packets(0):
        assert len(piece) <= 100
        part = part + piece[2:] if part else piece
        if piece[0] & 0x40:
            joined.append(bytes([part[0] | 0x40]) + part[1:])
            part = b""
    assert joined == frames
    assert app.frames_forwarded == 2


def test_queued_packets_overtake_images_on_uart2_at_the_border_of_a_packet() -> None:
    app = on_uart()
    app.receive("UART2", CREDIT, 0)
    frame = stock_frame(324, 24)
    give_all(app, frame)
    app.uart_bytes("UART2", 0)  # the header
    app.receive("UART2", CREDIT, 0)
    app.uart_bytes("UART2", 0)  # first piece of the body
    console = cpx(GAP8, HOST, CONSOLE, b"x" * 300)
    give(app, "SPI", console)
    packets = app.uart_packets(0)
    rest_of_first = -(-1020 // 98) - 1
    assert [packet[1] for packet in packets[: rest_of_first + 5]] == [APP] * rest_of_first + [CONSOLE] * 4 + [APP]


@pytest.mark.parametrize("destination", [STM32, HOST])
def test_with_a_host_on_uart2_there_is_no_stm32(destination: int) -> None:
    app = on_uart()
    give(app, "UART2", cpx(HOST, destination, TEST, b"\x01"))
    assert app.packets_unroutable == 1
    from_spi(app)
    give(app, "SPI", cpx(GAP8, STM32, TEST, b"\x01"))
    assert app.packets_unroutable == 2


def test_a_host_on_uart2_gets_answers_and_no_wifi() -> None:
    app = on_uart()
    for function, data in ((TEST, b"\x01echo"), (WIFI_CTRL, b"\x10net"), (WIFI_CTRL, b"\x20\x01")):
        give(app, "UART2", cpx(HOST, ESP32, function, data))
    assert app.uart_packets(0) == [cpx(ESP32, HOST, TEST, b"\x01echo")]
    assert app.transmit("NETWORK", 0) == b""
    assert app.wifi_refused == 1


def test_a_configuration_out_of_range_is_refused() -> None:
    with pytest.raises(ValueError, match="-5"):
        App("esp32", host_on_uart=2)


SOME_FRAMES = [stock_frame(99, 50), native_frame(1024, 1, 9)]


def random_input(rng: random.Random) -> tuple[str, bytes]:
    source, destination = rng.randrange(8), rng.randrange(8)
    function = rng.choice([SYSTEM, WIFI_CTRL, APP, TEST, rng.randrange(64)])
    data = rng.choice(
        [b"", b"\x01", b"\x10abc", b"\x20\x01", NATIVE_REQUEST + b"\0\0", rng.randbytes(rng.randrange(90))]
    )
    packet = cpx(source, destination, function, data, version=rng.choice([0] * 9 + [1]))
    match rng.randrange(6):
        case 0:
            return "UART2", rng.choice([CREDIT, rng.randbytes(rng.randrange(5)), uart(packet), uart(packet)])
        case 1:
            return "TCP", rng.choice([link(packet), link(packet)[: rng.randrange(9)], rng.randbytes(3)])
        case 2:
            return "NETWORK", rng.choice([CLIENT, CLIENT, CLIENT_GONE, NETWORK_DOWN, b"\x01\1\2\3\4\1", b"", b"?"])
        case 3:
            return "SPI", rng.choice([link(packet), bytes(8), rng.randbytes(8)])
        case _:
            return "SPI", link(rng.choice(rng.choice(SOME_FRAMES)))


@pytest.mark.parametrize("host_on_uart", [0, 1])
@pytest.mark.parametrize("seed", range(15))
def test_under_random_traffic_every_queue_keeps_its_bounds(seed: int, host_on_uart: int) -> None:
    rng = random.Random(seed)
    app = App("esp32", host_on_uart=host_on_uart)
    for step in range(3000):
        now_us = step * 700
        port, data = random_input(rng)
        app.receive(port, data, now_us)
        for _ in range(rng.randrange(4)):
            app.transmit(rng.choice(["UART2", "SPI", "TCP", "NETWORK"]), now_us, size=1024)
        fills = [(queue.fill, queue.capacity) for queue in (app.to_uart, app.to_spi, app.to_tcp)]
        assert all(fill <= capacity for fill, capacity in fills), f"seed {seed}, step {step}: {fills}"
        assert app.image_fill <= 114688, f"seed {seed}, step {step}"
    later = 100_000_000
    app.uart_bytes("UART2", later)  # what is held is given up
    if not host_on_uart:
        app.receive("NETWORK", CLIENT, later)
        give(app, "TCP", cpx(HOST, GAP8, TEST, b"\x01alive"), later)
    else:
        give(app, "UART2", cpx(HOST, GAP8, TEST, b"\x01alive"), later)
    assert cpx(HOST, GAP8, TEST, b"\x01alive") in from_spi(app), f"seed {seed}"


def idle(app: App, now_us: int) -> Any:
    return [app.transmit(port, now_us, size=size) for port, size in (("UART2", 1), ("SPI", 1024), ("TCP", 99))]


def test_a_deadline_that_has_come_is_served() -> None:
    app = esp32()
    ask(app, 0, ESP32)
    for up_us in range(0, 5_000_000, 50_000):
        for _ in range(200):
            if idle(app, up_us) == [b"", NO_MESSAGE, b""]:
                break
        assert app.deadline() > up_us
