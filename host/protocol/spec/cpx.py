"""CPX: the route, and who and what it can name."""

from typing import Any

from construct import BitsInteger, BitStruct, Flag

from .values import Value

LIMITS = (
    Value(100, "CPX_MTU_UART", "route and data on UART2"),
    Value(1022, "CPX_MTU", "route and data on every other link"),
    Value(98, "CPX_DATA_UART_MAX", "data on UART2"),
    Value(1020, "CPX_DATA_MAX", "data on every other link"),
)

TARGETS = (
    Value(1, "CPX_STM32", "flight controller"),
    Value(2, "CPX_ESP32", "Wi-Fi processor and router"),
    Value(3, "CPX_HOST", "the client of the TCP server"),
    Value(4, "CPX_GAP8", "camera processor"),
)

FUNCTIONS = (
    Value(1, "CPX_SYSTEM", "see SYSTEM"),
    Value(2, "CPX_CONSOLE", "text, with its final NUL in stock firmware; a line may take several packets"),
    Value(3, "CPX_CRTP", "a CRTP packet: header byte, 0 to 30 bytes"),
    Value(4, "CPX_WIFI_CTRL", "see WIFI_CTRL"),
    Value(5, "CPX_APP", "free; here the image stream, stock and native"),
    Value(6, "CPX_STREAMER", "NanoCockpit firmware only"),
    Value(14, "CPX_TEST", "first data byte 0: discard, 1: send back"),
    Value(15, "CPX_BOOTLOADER", "to the GAP8's bootloader; command 6 starts the application"),
)

VERSION = 0

ROUTE = BitStruct(
    "reserved" / Flag * "0 in stock firmware; 1 announces native (see Image stream)",
    "last_packet" / Flag * "set or clear without meaning in existing firmware: never rely on it",
    "source" / BitsInteger(3) * "target that sends",
    "destination" / BitsInteger(3) * "target to reach",
    "version" / BitsInteger(2) * "0",
    "function" / BitsInteger(6) * "what the packet is about",
)


def forwardable(route: Any) -> bool:
    """What a router may pass on: known ends, known version."""
    ends = {target.number for target in TARGETS}
    return route.source in ends and route.destination in ends and route.version == VERSION
